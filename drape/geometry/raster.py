"""A small software rasteriser: shaded triangles, z-buffer, no display, no GPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drape.geometry import meshes
from drape.wanted import go_on

LIGHT = np.array([0.35, 0.55, 0.76])
SKIN = (0.80, 0.66, 0.56)
CLOTH = (0.25, 0.42, 0.85)
BACKGROUND = 1.0

Paint = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Of places in faces (n,) with shares (n, 3) of their corners: the colours (n, 3), and whether each is there (n,)."""


@dataclass(frozen=True)
class Surface:
    """A mesh to draw: ``vertices`` [m] (V, 3), ``faces`` (F, 3); its ``colour``, RGB in [0, 1] for all or for each face
    (F, 3), or a ``paint`` function instead. ``smooth``: it is shaded by vertex normals, not by face normals."""

    vertices: np.ndarray
    faces: np.ndarray
    colour: tuple[float, float, float] | np.ndarray = CLOTH
    smooth: bool = True
    paint: Paint | None = None


def view_matrix(azimuth_deg: float, elevation_deg: float = 8.0) -> np.ndarray:
    """Returns the rotation (3, 3) from the world to the camera: x right, y up, z towards the viewer. At azimuth 0 and
    elevation 0 the two are the same, and the camera sees the front; elevation lifts the camera."""
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    turn = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
    return tilt @ turn


def render(
    surfaces: list[Surface],
    *,
    size: tuple[int, int] = (320, 320),
    azimuth_deg: float = 0.0,
    elevation_deg: float = 8.0,
    centre: np.ndarray | None = None,
    extent_m: float | None = None,
    light: np.ndarray = LIGHT,
) -> np.ndarray:
    """Returns an orthographic picture of ``surfaces``, RGB (height, width, 3) in [0, 1] on white; ``size`` is (height,
    width) [pixels]. ``centre`` [m] (3,): the middle of the view, and ``extent_m``, its height; by default all surfaces
    fit. ``light`` (3,): the unit direction to the light in the camera's axes; from the side it shows folds."""
    height, width = size
    view = view_matrix(azimuth_deg, elevation_deg)
    everything = np.concatenate([s.vertices for s in surfaces])
    middle = 0.5 * (everything.min(0) + everything.max(0)) if centre is None else np.asarray(centre)
    extent_m = 1.08 * float(np.ptp((everything - middle) @ view.T, axis=0)[:2].max()) if extent_m is None else extent_m
    depth = np.full(height * width, -np.inf)
    image = np.full((height * width, 3), BACKGROUND)
    for surface in surfaces:
        camera, screen = _projected(surface.vertices, view, middle, size, extent_m)
        _raster(surface, camera, screen, size, light, depth, image)
    return image.reshape(height, width, 3)


@dataclass(frozen=True, eq=False)
class ZBuffer:
    """What an orthographic view sees in every pixel: ``depth`` [m] (height, width), along the axis towards the viewer
    from the view's centre, -inf in empty pixels; and ``face`` (height, width), the nearest face, -1 in empty pixels."""

    depth: np.ndarray
    face: np.ndarray


def z_buffer(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    size: tuple[int, int],
    azimuth_deg: float,
    centre: np.ndarray,
    extent_m: float,
) -> ZBuffer:
    """Returns what ``render`` would see of the mesh ``vertices`` [m] (V, 3), ``faces`` (F, 3), both sides of it, in
    every pixel of a view with these arguments."""
    camera, screen = _projected(vertices, view_matrix(azimuth_deg), centre, size, extent_m)
    depth = np.full(size[0] * size[1], -np.inf)
    nearest = np.full(len(depth), -1)
    for t, pixel, z, _ in _fragments(camera, screen, faces, size):
        t, pixel, z = (array[z > depth[pixel]] for array in (t, pixel, z))
        depth[pixel], nearest[pixel] = z, t
    return ZBuffer(depth.reshape(size), nearest.reshape(size))


def _projected(
    vertices: np.ndarray, view: np.ndarray, centre: np.ndarray, size: tuple[int, int], extent_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """``vertices`` in the camera's axes [m] (V, 3) and in pixels (V, 2)."""
    height, width = size
    camera = (vertices - centre) @ view.T
    scale = height / extent_m
    return camera, np.stack([width / 2 + camera[:, 0] * scale, height / 2 - camera[:, 1] * scale], axis=1)


def _fragments(
    camera: np.ndarray, screen: np.ndarray, faces: np.ndarray, size: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Pixels whose centres lie in triangles, in one pass for each offset in the triangles' boxes.

    A pass yields triangles (n,), pixels (n,), depths (n,) and weights of the corners (n, 3). Depths ascend: the last
    entry of a pixel is its nearest.
    """
    height, width = size
    p = screen[faces]
    low = np.floor(p.min(axis=1)).astype(int)
    high = np.ceil(p.max(axis=1)).astype(int)
    span = high - low + 1
    area = (p[:, 1, 0] - p[:, 0, 0]) * (p[:, 2, 1] - p[:, 0, 1]) - (p[:, 2, 0] - p[:, 0, 0]) * (p[:, 1, 1] - p[:, 0, 1])
    alive = np.abs(area) > 1e-9
    # One pass per pixel offset inside the triangles' boxes: triangles are small, so passes are few.
    for dy in range(int(span[alive, 1].max(initial=0))):
        go_on()
        for dx in range(int(span[alive, 0].max(initial=0))):
            t = np.flatnonzero(alive & (span[:, 0] > dx) & (span[:, 1] > dy))
            if not len(t):
                break
            x, y = low[t, 0] + dx, low[t, 1] + dy
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            t, x, y = t[inside], x[inside], y[inside]
            a, b, c = p[t, 0], p[t, 1], p[t, 2]
            w1 = ((x + 0.5 - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y + 0.5 - a[:, 1])) / area[t]
            w2 = ((b[:, 0] - a[:, 0]) * (y + 0.5 - a[:, 1]) - (x + 0.5 - a[:, 0]) * (b[:, 1] - a[:, 1])) / area[t]
            w0 = 1.0 - w1 - w2
            hit = (w0 >= -1e-6) & (w1 >= -1e-6) & (w2 >= -1e-6)
            t, x, y = t[hit], x[hit], y[hit]
            w = np.stack([w0, w1, w2], axis=1)[hit]
            z = np.sum(w * camera[faces[t], 2], axis=1)
            order = np.argsort(z, kind="stable")
            yield t[order], (y * width + x)[order], z[order], w[order]


def _raster(
    surface: Surface,
    camera: np.ndarray,
    screen: np.ndarray,
    size: tuple[int, int],
    light: np.ndarray,
    depth: np.ndarray,
    image: np.ndarray,
) -> None:
    faces = surface.faces
    vertex_normal, normal = meshes.vertex_normals(camera, faces), meshes.face_normals(camera, faces)
    colour = np.broadcast_to(np.asarray(surface.colour, dtype=float), (len(faces), 3))
    for t, pixel, z, w in _fragments(camera, screen, faces, size):
        nearer = z > depth[pixel]
        t, pixel, z, w = t[nearer], pixel[nearer], z[nearer], w[nearer]
        own = colour[t]
        if surface.paint is not None:
            own, there = surface.paint(t, w)
            t, pixel, z, w, own = t[there], pixel[there], z[there], w[there], own[there]
        n = np.einsum("nk,nkc->nc", w, vertex_normal[faces[t]]) if surface.smooth else normal[t]
        n = n / (np.linalg.norm(n, axis=1, keepdims=True) + 1e-12)
        n = np.where(n[:, 2:3] < 0, -n, n)
        shade = 0.28 + 0.72 * np.clip(n @ light, 0, 1)
        depth[pixel] = z
        image[pixel] = np.clip(own * shade[:, None], 0, 1)
