"""Draped discs as they lie on the drapemeter, in perspective, under a low light that casts shadows.

A small ray of software: z-buffers for the eye and for the light, Lambert and Blinn-Phong with a fabric's own gloss, and
a weave or knit as a shallow relief of the normal in the cloth's rest coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter

from benchmarks.cloth.fabric_tests import DISC_RADIUS_M, PEDESTAL_RADIUS_M, Drape

TILE, SAMPLES = 270, 2  # pixels of a disc's picture, and samples of a pixel along each side
EYE_M, AIM_M, FOCAL = np.array([0.0, 0.36, 0.66]), np.array([0.0, -0.030, 0.0]), 3.9
LIGHT = np.array([-0.80, 0.42, 0.32]) / np.linalg.norm([-0.80, 0.42, 0.32])
FLOOR_M = -0.075
LIGHT_CELL_M = 0.0012
GROUND = np.array([0.86, 0.85, 0.83])
SKY, KEY, FILL = 0.34, 0.62, 0.14


@dataclass(frozen=True)
class Look:
    """Colour, strength and width of the gloss, and a relief: its kind, spacing [m] and slope."""

    colour: tuple[float, float, float]
    gloss: float = 0.05
    sharpness: float = 8.0
    relief: str = "plain"
    spacing_m: float = 0.0015
    slope: float = 0.10
    sheer: float = 0.0


LOOKS = {
    "jersey": Look((0.62, 0.63, 0.66), relief="rib", spacing_m=0.0030, slope=0.07),
    "rib": Look((0.88, 0.84, 0.74), relief="rib", spacing_m=0.0060, slope=0.30),
    "ponte": Look((0.67, 0.52, 0.36), relief="rib", spacing_m=0.0030, slope=0.04),
    "sweat": Look((0.20, 0.25, 0.42), relief="plain", spacing_m=0.0040, slope=0.08),
    "denim": Look((0.18, 0.26, 0.42), relief="twill", spacing_m=0.0055, slope=0.12),
    "twill": Look((0.62, 0.56, 0.42), relief="twill", spacing_m=0.0055, slope=0.06),
    "poplin": Look((0.80, 0.86, 0.92), relief="plain", spacing_m=0.0030, slope=0.02),
    "satin": Look((0.55, 0.16, 0.22), gloss=0.55, sharpness=26.0, slope=0.0),
    "chiffon": Look((0.88, 0.66, 0.66), gloss=0.10, sharpness=12.0, slope=0.03, sheer=0.35),
    "swim": Look((0.10, 0.38, 0.42), gloss=0.22, sharpness=16.0, relief="rib", spacing_m=0.0030, slope=0.02),
}


def draw(path: Path, drapes: dict[str, Drape]) -> None:
    """Writes the discs, five a row, with name, drape coefficient and nodes."""
    tiles = [tile(name, drape) for name, drape in drapes.items()]
    columns = min(5, len(tiles))
    tiles += [np.ones_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    image = Image.fromarray((255.0 * np.concatenate(rows, axis=0)).astype(np.uint8))
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=15)
    for i, (name, drape) in enumerate(drapes.items()):
        at = (i % columns * TILE + 10, i // columns * TILE + 6)
        pen.text(at, f"{name}  {drape.coefficient_pct:.0f} %, {drape.nodes} nodes", fill=(40, 40, 40), font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, optimize=True)


def tile(name: str, drape: Drape) -> np.ndarray:
    """One disc (``TILE``, ``TILE``, 3) in [0, 1]."""
    look = LOOKS.get(name, Look((0.6, 0.6, 0.6)))
    points, faces, rest = _finer(*_whole(drape))
    size = TILE * SAMPLES
    right, up, back = _camera()
    seen = (points - EYE_M) @ np.stack([right, up, back]).T
    screen = size * (0.5 + 0.5 * FOCAL * seen[:, :2] / -seen[:, 2:] * [1.0, -1.0])
    buffer = _Buffer(screen, 1.0 / seen[:, 2], faces, (size, size))
    normal = _vertex_normals(points, faces)
    sunlit = _Sun(points, faces)
    image = _ground(size, sunlit, points)
    hit = buffer.face >= 0
    position, n, uv = (buffer.mixed(values, seen[:, 2]) for values in (points, normal, rest))
    view = EYE_M - position
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    inside = (n * view).sum(axis=1) < 0.0
    n = np.where(inside[:, None], -n, n)
    n = _embossed(n, uv, look)
    key = np.clip((n @ LIGHT + 0.08) / 1.08, 0.0, 1.0) * sunlit.share(position, 0.0022)
    half = LIGHT + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    shine = look.gloss * np.clip((n * half).sum(axis=1), 0.0, 1.0) ** look.sharpness * sunlit.share(position, 0.0022)
    # The open sky seen from below the plate's height is smaller, and folds stand before each other.
    open_sky = np.clip(1.0 + 3.2 * position[:, 1], 0.72, 1.0) * (0.55 + 0.45 * n[:, 1]) * np.where(inside, 0.6, 1.0)
    # Light from behind the eye keeps folds readable that face away from the sun.
    fill = FILL * np.clip((n * view).sum(axis=1), 0.0, 1.0)
    colour = np.asarray(look.colour) * (SKY * open_sky + KEY * key + fill)[:, None] + shine[:, None]
    image[hit] = look.sheer * image[hit] * (0.55 + 0.45 * np.asarray(look.colour)) + (1.0 - look.sheer) * colour
    image = np.clip(image, 0.0, 1.0) ** (1.0 / 1.15)
    return image.reshape(TILE, SAMPLES, TILE, SAMPLES, 3).mean(axis=(1, 3))


# --- geometry --------------------------------------------------------------------------------------------------------


def _camera() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    back = (EYE_M - AIM_M) / np.linalg.norm(EYE_M - AIM_M)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    return right, np.cross(back, right), back


def _whole(drape: Drape) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and rest coordinates with the part on the plate that the mesh leaves out."""
    held = drape.mesh.held
    radius = np.linalg.norm(drape.mesh.points[held], axis=1)
    inner = held[radius < PEDESTAL_RADIUS_M]
    inner = inner[np.argsort(np.arctan2(drape.mesh.points[inner, 1], drape.mesh.points[inner, 0]))]
    count = len(drape.vertices)
    fan = np.stack([inner, np.roll(inner, -1), np.full(len(inner), count)], axis=1)
    vertices = np.concatenate([drape.vertices, np.zeros((1, 3))])
    return vertices, np.concatenate([drape.mesh.faces, fan]), np.concatenate([drape.mesh.points, np.zeros((1, 2))])


def _finer(points: np.ndarray, faces: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One round of Loop's subdivision of the inside, so that silhouettes have no corners; borders keep their points."""
    count = len(points)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, place, shared = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    place = place.reshape(3, -1).T
    opposite = np.zeros((len(unique), 3))
    for k, corner in enumerate((2, 0, 1)):
        np.add.at(opposite, place[:, k], points[faces[:, corner]])
    middle = 0.5 * points[unique].sum(axis=1)
    middle = np.where(shared[:, None] == 2, 0.75 * middle + 0.125 * opposite, middle)
    border = np.zeros(count, dtype=bool)
    border[unique[shared == 1]] = True
    valence, total = np.bincount(unique.reshape(-1), minlength=count), np.zeros((count, 3))
    np.add.at(total, unique[:, 0], points[unique[:, 1]])
    np.add.at(total, unique[:, 1], points[unique[:, 0]])
    share = (5.0 / 8.0 - (3.0 / 8.0 + 0.25 * np.cos(2.0 * np.pi / valence)) ** 2)[:, None]
    even = np.where(border[:, None], points, (1.0 - share) * points + share * total / valence[:, None])
    a, b, c = faces.T
    ab, bc, ca = (count + place).T
    finer = np.concatenate(
        [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    return np.concatenate([even, middle]), finer, np.concatenate([rest, 0.5 * rest[unique].sum(axis=1)])


def _vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = points[faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros_like(points)
    for k in range(3):
        np.add.at(normal, faces[:, k], face)
    return normal / (np.linalg.norm(normal, axis=1, keepdims=True) + 1e-15)


def _embossed(normal: np.ndarray, uv: np.ndarray, look: Look) -> np.ndarray:
    """Normals tilted by the relief of yarns; its direction on the surface need not be exact at this size."""
    if look.slope == 0.0:
        return normal
    turn = 2.0 * np.pi / look.spacing_m
    across, along = uv[:, 1] * turn, uv[:, 0] * turn
    tilt_across = {"rib": np.sin(across), "twill": np.sin(across + along), "plain": np.sin(across) * np.cos(along)}
    tilt_along = {"rib": 0.0 * along, "twill": np.sin(across + along), "plain": np.cos(across) * np.sin(along)}
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True) + 1e-9
    second = np.cross(normal, first)
    tilted = normal + look.slope * (
        tilt_across[look.relief][:, None] * second + tilt_along[look.relief][:, None] * first
    )
    return tilted / np.linalg.norm(tilted, axis=1, keepdims=True)


# --- buffers ---------------------------------------------------------------------------------------------------------


class _Buffer:
    """For every pixel the nearest triangle (-1: none) and where in it; the least ``depth``, linear there, wins."""

    def __init__(self, screen: np.ndarray, depth: np.ndarray, faces: np.ndarray, size: tuple[int, int]) -> None:
        height, width = size
        self.faces = faces
        self.face = np.full((height, width), -1)
        self.depth = np.full((height, width), np.inf)
        self.weights = np.zeros((height, width, 3))
        for index, face in enumerate(faces):
            a, b, c = screen[face]
            low = np.maximum(np.floor(np.minimum(np.minimum(a, b), c)).astype(int), 0)
            high = np.minimum(np.ceil(np.maximum(np.maximum(a, b), c)).astype(int), [width, height])
            area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
            if area == 0.0 or (low >= high).any():
                continue
            x, y = (np.arange(low[0], high[0]) + 0.5 - a[0])[None], (np.arange(low[1], high[1]) + 0.5 - a[1])[:, None]
            u, v = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / area, (y * (b[0] - a[0]) - x * (b[1] - a[1])) / area
            at = (1.0 - u - v) * depth[face[0]] + u * depth[face[1]] + v * depth[face[2]]
            box = np.s_[low[1] : high[1], low[0] : high[0]]
            nearer = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (at < self.depth[box])
            self.depth[box][nearer], self.face[box][nearer] = at[nearer], index
            self.weights[box][nearer] = np.stack([1.0 - u - v, u, v], axis=-1)[nearer]

    def mixed(self, values: np.ndarray, view_depth: np.ndarray) -> np.ndarray:
        """``values`` (V, C) of the vertices at the pixels that are hit, in perspective."""
        hit = self.face >= 0
        faces = self.faces[self.face[hit]]
        weights = self.weights[hit] / view_depth[faces]
        return np.einsum("nk,nkc->nc", weights / weights.sum(axis=1, keepdims=True), values[faces])


class _Sun:
    """A depth map seen from the light, and how much of it reaches a point."""

    def __init__(self, points: np.ndarray, faces: np.ndarray) -> None:
        side = np.cross(LIGHT, [0.0, 1.0, 0.0])
        self.axes = np.stack([side / np.linalg.norm(side), np.cross(side / np.linalg.norm(side), LIGHT)])
        self.size = round(2.6 * DISC_RADIUS_M / LIGHT_CELL_M)
        self.depth = _Buffer(self._cells(points), -(points @ LIGHT), faces, (self.size, self.size)).depth

    def _cells(self, points: np.ndarray) -> np.ndarray:
        return points @ self.axes.T / LIGHT_CELL_M + 0.5 * self.size

    def share(self, points: np.ndarray, bias_m: float, blur: int = 2) -> np.ndarray:
        """Share of lit cells (N,) in a square of 2 ``blur`` + 1 cells about each point."""
        cells, depth = self._cells(points), -(points @ LIGHT) - bias_m
        lit = np.zeros(len(points))
        for dx in range(-blur, blur + 1):
            for dy in range(-blur, blur + 1):
                x, y = (np.clip(np.floor(cells + np.array([dx, dy])).astype(int), 0, self.size - 1)).T
                lit += depth <= self.depth[y, x]
        return lit / (2 * blur + 1) ** 2


def _ground(size: int, sunlit: _Sun, points: np.ndarray) -> np.ndarray:
    """The floor with the disc's shadow and the dark under it (``size``, ``size``, 3)."""
    right, up, back = _camera()
    x = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    ray = x[None, :, None] * right - x[:, None, None] * up - FOCAL * back
    at = EYE_M + ((FLOOR_M - EYE_M[1]) / ray[..., 1])[..., None] * ray
    lit = sunlit.share(at.reshape(-1, 3), 0.0, blur=4).reshape(size, size)
    radius = np.linalg.norm(points[:, [0, 2]], axis=1).max()
    near = np.hypot(at[..., 0], at[..., 2])
    dark = 1.0 - 0.45 * np.exp(-(np.clip(near / radius - 0.75, 0.0, None) ** 2) / 0.06)
    image = GROUND * ((0.58 * dark + 0.42 * gaussian_filter(lit, 2.0 * SAMPLES))[..., None])
    return image * (1.0 - 0.10 * np.clip(near / 0.5, 0.0, 1.0))[..., None]
