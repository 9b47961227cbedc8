"""A polo's placket and collar, put on the drape of a T-shirt: what no base of the recovery has."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from drape.geometry import meshes
from recovery.fit.contours import Contour, open_contours

SLIT_M, SLIT_WIDTH_M = 0.12, 0.024  # down the front from the neckline; its width at the top
STAND_M, FALL_M, OUT_M = 0.03, 0.04, 0.035  # of the collar: up, then over a fold and down, and out


def with_collar(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The top of ``vertices`` [m] (V, 3) and ``faces`` (F, 3) with a slit down its front and a collar that falls over.

    The neckline is its highest opening. The collar leaves the slit open.
    """
    neck = neckline(vertices, faces)
    front = neck.points[neck.points[:, 2].argmax()]
    vertices, faces = slit(vertices, faces, front, neck.centre)
    loop = neckline(vertices, faces).loop
    at = vertices[loop]
    beside = (np.abs(at[:, 0] - front[0]) < 0.016) & (at[:, 2] > neck.centre[2]) & (at[:, 1] < front[1] + 0.004)
    first = int(np.flatnonzero(beside & ~np.roll(beside, -1))[0]) + 1
    edge = np.roll(loop, -first)[~np.roll(beside, -first)]
    out = vertices[edge] - neck.centre
    out[:, 1] = 0.0
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    rings = [vertices[edge] + way * out + [0.0, rise, 0.0] for way, rise in profile()]
    rows = [edge, *(len(vertices) + len(edge) * number + np.arange(len(edge)) for number in range(len(rings)))]
    strips = [_strip(low, high) for low, high in pairwise(rows)]
    added = np.concatenate(strips)
    # Where the first strip runs along the neckline as the cloth does, the collar would be inside out.
    own = {(int(a), int(b)) for a, b, _ in meshes.half_edges(faces[np.isin(faces, edge).any(axis=1)])}
    if (int(added[0, 0]), int(added[0, 1])) in own:
        added = added[:, ::-1]
    return np.concatenate([vertices, *rings]), np.concatenate([faces, added])


def neckline(vertices: np.ndarray, faces: np.ndarray) -> Contour:
    """The highest open contour."""
    return max(open_contours(vertices, faces), key=lambda one: float(one.centre[1]))


def slit(vertices: np.ndarray, faces: np.ndarray, top: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without a wedge down its front from ``top`` [m] (3,), a point of the neckline about ``centre`` (3,)."""
    middle = vertices[faces].mean(axis=1)
    depth = (top[1] - middle[:, 1]) / SLIT_M
    narrow = np.abs(middle[:, 0] - top[0]) < 0.5 * SLIT_WIDTH_M * (1.0 - depth) + 0.0008
    return used(vertices, faces[~(narrow & (depth < 1.0) & (middle[:, 2] > centre[2]))])


def profile() -> list[tuple[float, float]]:
    """How far out and how far up [m] the rows of the collar lie from the neckline: it stands, turns over and falls."""
    stand = [(0.001 * share, STAND_M * share) for share in np.linspace(0.0, 1.0, 9)[1:]]
    fold = [
        (0.001 + 0.01 * np.sin(angle), STAND_M + 0.006 * np.sin(angle) ** 2)
        for angle in np.linspace(0.0, 0.5 * np.pi, 4)[1:]
    ]
    out, up = fold[-1]
    fall = [(out + OUT_M * s, up - FALL_M * (0.7 * s + 0.3 * s * s)) for s in np.linspace(0.0, 1.0, 14)[1:]]
    return [*stand, *fold, *fall]


def _strip(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Two triangles for every step along the rows ``low`` and ``high`` (n,) of vertices."""
    a, b, c, d = low[:-1], low[1:], high[:-1], high[1:]
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])


def used(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without the vertices that no face has."""
    kept, numbers = meshes.in_use(faces)
    return vertices[kept], numbers
