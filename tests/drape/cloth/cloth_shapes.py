"""Small meshes with closed-form answers, shared by the cloth tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def grid(width: int = 5, height: int = 4, *, cell_m: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """A flat rectangle in the xy plane of right triangles, normals along +z."""
    x, y = np.meshgrid(np.arange(width + 1) * cell_m, np.arange(height + 1) * cell_m, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    corner = (np.arange(width)[:, None] * (height + 1) + np.arange(height)[None]).ravel()
    right, up = corner + height + 1, corner + 1
    faces = np.concatenate([np.stack([corner, right, right + 1], axis=1), np.stack([corner, right + 1, up], axis=1)])
    return vertices, faces


def equilateral(columns: int, rows: int, *, edge_m: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet of equilateral triangles in the xy plane, one family of edges along x, normals along +z."""
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij")
    vertices = np.stack([(i + 0.5 * (j % 2)).ravel(), (np.sqrt(0.75) * j).ravel(), np.zeros(i.size)], axis=1) * edge_m

    def at(a, b):
        return a * (rows + 1) + b

    faces = []
    for b in range(rows):
        for a in range(columns):
            if b % 2 == 0:
                faces += [[at(a, b), at(a + 1, b), at(a, b + 1)], [at(a + 1, b), at(a + 1, b + 1), at(a, b + 1)]]
            else:
                faces += [[at(a, b), at(a + 1, b + 1), at(a, b + 1)], [at(a, b), at(a + 1, b), at(a + 1, b + 1)]]
    return vertices, np.array(faces)


def tube(around: int = 12, along: int = 5, *, radius_m: float = 0.1, height_m: float = 0.3):
    """An open cylinder about the y axis, from y = 0 up, normals outwards."""
    return round_tube([radius_m] * (along + 1), np.linspace(0.0, height_m, along + 1), around)


def round_tube(radii: Sequence[float] | np.ndarray, heights: Sequence[float] | np.ndarray, around: int = 24):
    """Vertices [m] and faces of a tube about the y axis through rings of these radii and rising heights [m]."""
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = np.stack([np.sin(angle), np.zeros(around), np.cos(angle)], axis=1)
    rings = [r * ring + [0.0, y, 0.0] for r, y in zip(radii, heights, strict=True)]
    first = around * np.arange(len(rings) - 1)[:, None]
    a, b = (first + np.arange(around)).reshape(-1), (first + np.roll(np.arange(around), -1)).reshape(-1)
    faces = np.stack([a, b, b + around, a, b + around, a + around], axis=1)
    return np.concatenate(rings), faces.reshape(-1, 3)


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))
