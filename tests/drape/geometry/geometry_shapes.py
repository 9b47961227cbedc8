"""Closed meshes with closed-form distances, shared by the geometry and cloth tests."""

from __future__ import annotations

import numpy as np

from drape.geometry.meshes import subdivide

BOX_FACES = np.array(
    [
        [1, 2, 0], [3, 2, 1], [6, 5, 4], [6, 7, 5], [4, 1, 0], [4, 5, 1],
        [3, 6, 2], [7, 6, 3], [2, 4, 0], [6, 4, 2], [5, 3, 1], [5, 7, 3],
    ]
)  # fmt: skip


def box(half_m: tuple[float, float, float] = (0.1, 0.2, 0.3)) -> tuple[np.ndarray, np.ndarray]:
    """A box about the origin with outward normals; corner ``4 x + 2 y + z`` has the signs of those bits."""
    bits = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
    return (2.0 * bits - 1.0) * half_m, BOX_FACES


def box_distance(points: np.ndarray, half_m) -> np.ndarray:
    """Signed distance to that box."""
    q = np.abs(points) - half_m
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def icosphere(levels: int, *, radius_m: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A sphere about the origin from an octahedron, outward normals, vertices on the sphere."""
    vertices = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(levels):
        vertices, faces, _ = subdivide(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return radius_m * vertices, faces
