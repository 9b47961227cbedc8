"""Where cloth passes through itself: pairs of its triangles that cross.

Two triangles without a common vertex cross where an edge of one passes from one side of
the other to the other side, within it (Moeller 1997 states the same by intervals).
Touching is not crossing: a corner or an edge that only reaches the other triangle's plane,
and triangles that overlap within one plane, do not count. Predicates are signs of float64
determinants; coordinates are taken relative to the mesh, so that they hold far from the origin.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import MeshError
from drape.geometry import meshes

CHUNK_PAIRS = 1_000_000  # candidates looked at together: bounds the memory
SMALLEST_CELL = 1e-5  # of the mesh's extent: bounds the cell numbers
LARGEST_FACE_CELLS = 32  # along an axis, for the largest face


def intersection_count(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Number (...,) of ``intersecting_pairs`` of every frame of ``vertices`` [m] (..., V, 3), int64."""
    vertices = np.asarray(vertices)
    frames = vertices.reshape(-1, *vertices.shape[-2:])
    counts = [len(intersecting_pairs(frame, faces)) for frame in frames]
    return np.array(counts, dtype=np.int64).reshape(vertices.shape[:-2])


def intersecting_pairs(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs (n, 2) of faces, i < j in lexicographic order, that share no vertex and cross.

    ``vertices`` [m] (V, 3) finite, ``faces`` (F, 3). Vertices count as shared by their index: a seam whose
    two sides are separate vertices at one place only touches, which does not count either.
    Raises ``MeshError`` for other shapes, indices out of range, NaN or infinity.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", vertices, (None, 3), error=MeshError)
    check_finite("vertices", vertices, error=MeshError)
    faces = meshes.check_faces(faces, len(vertices))
    if len(faces) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    corners = vertices[faces]
    corners = corners - corners.reshape(-1, 3).mean(axis=0)
    found = []
    for first, second in _near_pairs(corners.min(axis=1), corners.max(axis=1)):
        apart = ~(faces[first][:, :, None] == faces[second][:, None, :]).any(axis=(1, 2))
        first, second = first[apart], second[apart]
        crossing = _cross(corners[first], corners[second])
        found.append(np.stack([first[crossing], second[crossing]], axis=1))
    pairs = np.sort(np.concatenate(found), axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _near_pairs(low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each pair of boxes ``low`` to ``high`` (F, 3) that overlap, once; at least one chunk. By a uniform grid."""
    origin, extent = low.min(axis=0), (high - low).max(axis=1)
    span = float((high.max(axis=0) - origin).max())
    cell = max(
        float(np.median(extent)), float(extent.max()) / LARGEST_FACE_CELLS, SMALLEST_CELL * span, np.finfo(float).tiny
    )
    begin = np.floor((low - origin) / cell).astype(np.int64)
    sides = np.floor((high - origin) / cell).astype(np.int64) - begin + 1
    counts = sides.prod(axis=1)
    owner = np.repeat(np.arange(len(low)), counts)
    place = _ranges(counts)
    depth, rest = sides[owner, 2], place // sides[owner, 2]
    inside = np.stack([rest // sides[owner, 1], rest % sides[owner, 1], place % depth], axis=1)
    shape = (begin + sides).max(axis=0)
    keys = _cell_number(begin[owner] + inside, shape)
    order = np.argsort(keys, kind="stable")
    keys, owner = keys[order], owner[order]
    # Behind entry i of a cell stand the entries that it is paired with.
    partners = np.searchsorted(keys, keys, side="right") - np.arange(len(keys)) - 1
    bounds = np.concatenate([[0], np.cumsum(partners)])
    start = 0
    while start < len(keys):
        end = max(start + 1, int(np.searchsorted(bounds, bounds[start] + CHUNK_PAIRS, side="right")) - 1)
        own = np.repeat(np.arange(start, end), partners[start:end])
        other = own + 1 + _ranges(partners[start:end])
        first, second = owner[own], owner[other]
        corner = np.maximum(low[first], low[second])
        overlap = (corner <= np.minimum(high[first], high[second])).all(axis=1)
        # Of all cells that hold both, the one with the lowest corner of their overlap speaks for the pair.
        home = _cell_number(np.floor((corner[overlap] - origin) / cell).astype(np.int64), shape)
        once = home == keys[own[overlap]]
        yield first[overlap][once], second[overlap][once]
        start = end


def _ranges(counts: np.ndarray) -> np.ndarray:
    """0 .. n-1 for every n of ``counts``, one after the other."""
    total = int(counts.sum())
    return np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)


def _cell_number(cells: np.ndarray, shape: np.ndarray) -> np.ndarray:
    return (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether triangles ``first`` and ``second`` (n, 3, 3) cross, boolean (n,)."""
    sides = [_sides(a, b) for a, b in ((first, second), (second, first))]
    # Most pairs of boxes overlap with all corners of one triangle on one side of the other.
    straddle = np.flatnonzero(np.logical_and(*((s.min(axis=1) < 0) & (s.max(axis=1) > 0) for s in sides)))
    crossing = np.zeros(len(first), dtype=bool)
    if len(straddle):
        a, b = first[straddle], second[straddle]
        crossing[straddle] = _edge_passes(a, b, sides[1][straddle]) | _edge_passes(b, a, sides[0][straddle])
    return crossing


def _sides(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Side (n, 3) of the triangle ``plane`` on which each of ``points`` (n, 3, 3) lies: -1, 0 or 1."""
    normal = np.cross(plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0])
    return np.sign(((points - plane[:, :1]) @ normal[..., None])[..., 0]).astype(np.int8)


def _edge_passes(triangle: np.ndarray, other: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Whether an edge of ``triangle`` passes through ``other``; ``sides`` (n, 3) of its corners to ``other``."""
    passes = np.zeros(len(triangle), dtype=bool)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        rows = np.flatnonzero(sides[:, start] * sides[:, end] < 0)
        origin = triangle[rows, start]
        along = triangle[rows, end] - origin
        spokes = other[rows] - origin[:, None]
        # The line passes within the triangle where it turns the same way round all three edges.
        turns = [np.sum(along * np.cross(spokes[:, k], spokes[:, (k + 1) % 3]), axis=1) for k in range(3)]
        within = (np.minimum.reduce(turns) >= 0.0) | (np.maximum.reduce(turns) <= 0.0)
        passes[rows] |= within
    return passes
