"""Where cloth passes through itself: pairs of its triangles that cross, as ``drape.geometry.triangle_pairs`` has it."""

from __future__ import annotations

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import MeshError
from drape.geometry import meshes
from drape.geometry.triangle_pairs import crossing_pairs


def intersection_count(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the number (...,) int64 of ``intersecting_pairs`` in every drape of ``vertices`` [m] (..., V, 3)."""
    vertices = np.asarray(vertices)
    frames = vertices.reshape(-1, *vertices.shape[-2:])
    counts = [len(intersecting_pairs(frame, faces)) for frame in frames]
    return np.array(counts, dtype=np.int64).reshape(vertices.shape[:-2])


def intersecting_pairs(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the pairs (n, 2) of indices of faces, i < j in lexicographic order, that share no vertex and cross.

    ``vertices`` [m] (V, 3) finite, ``faces`` (F, 3). Vertices count as shared by their index: a seam whose
    two sides are separate vertices at one place only touches, which does not count either.
    Raises ``MeshError`` for other shapes, indices out of range, NaN or infinity.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", vertices, (None, 3), error=MeshError)
    check_finite("vertices", vertices, error=MeshError)
    faces = meshes.check_faces(faces, len(vertices))
    return crossing_pairs(vertices, faces) if len(faces) else np.zeros((0, 2), dtype=np.int64)
