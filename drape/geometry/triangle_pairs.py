"""Pairs of a vertex and a triangle, of two edges, or of two triangles: which are near, how far apart, which cross.

The simulator's contact of cloth with itself, the judge's barrier and the count of crossings use them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.engine.calls import call, call_with_scratch

CHUNK_PAIRS = 1_000_000  # pairs of triangles looked at together: bounds the memory


class Pairs(NamedTuple):
    """N pairs of mesh elements by their vertices, ``corner`` (N, 4): in the first ``triangles`` rows a vertex and the
    three of a triangle, then the two of one edge and the two of another."""

    corner: np.ndarray
    triangles: int


def pairs_within(
    x: np.ndarray, faces: np.ndarray, edges: np.ndarray, reach_m: float
) -> tuple[Pairs, np.ndarray, np.ndarray]:
    """Returns the pairs of elements nearer to each other than ``reach_m`` that share no vertex, weights (N, 4) of their
    corners, and vectors [m] (N, 3) between the nearest points of each pair. A pair is a vertex and one of ``faces`` (F,
    3), or two of ``edges`` (E, 2), at ``x`` [m] (V, 3). Its vector is the sum of its four corners, each times its
    weight, so weights sum to zero."""
    x, points = np.ascontiguousarray(x, np.float64), np.arange(len(x), dtype=np.int32)[:, None]
    faces, edges = np.ascontiguousarray(faces, np.int32), np.ascontiguousarray(edges, np.int32)
    over, beside = near_boxes(x, points, faces, reach_m), near_boxes(x, edges, edges, reach_m)
    by_triangle = np.concatenate([points[over[:, 0]], faces[over[:, 1]]], axis=1)
    corner, count = np.concatenate([by_triangle, edges[beside].reshape(-1, 4)]), len(over)
    weight, way = ways(x, corner, count)
    near = np.linalg.norm(way, axis=1) < reach_m
    return Pairs(corner[near], int(near[:count].sum())), weight[near], way[near]


def near_boxes(x: np.ndarray, first: np.ndarray, second: np.ndarray, reach_m: float) -> np.ndarray:
    """Returns pairs (N, 2) int32 of rows of ``first`` and ``second`` whose axis-aligned boxes are at most ``reach_m``
    apart along every axis. A row holds the vertices, rows of ``x`` [m] (V, 3), of an element. Elements that share a
    vertex are no pair. If ``first`` is ``second``, each pair comes once, the lower row first."""
    if not len(second):
        return np.zeros((0, 2), np.int32)
    elements, count = (first, *first.shape, second, *second.shape, first is second), 16 * len(first)
    while True:
        found = np.empty((count, 2), np.int32)
        count = call_with_scratch("near_boxes", np.float64, x, len(x), *elements, float(reach_m), found, len(found))
        if count <= len(found):
            return found[:count]


def ways(x: np.ndarray, corner: np.ndarray, triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns weights (N, 4) of the corners of each pair, and the vectors [m] (N, 3) between its nearest points, which
    are the sums of the corners by these weights. ``corner`` (N, 4): rows of ``x`` [m] (V, 3). In the first
    ``triangles`` pairs they are a vertex and a triangle, in the others two edges."""
    weights, found = np.empty((len(corner), 4)), np.empty((len(corner), 3))
    call("ways", np.float64, x, corner, len(corner), triangles, weights, found)
    return weights, found


# --- crossings --------------------------------------------------------------------------------------------------------


def crossing_pairs(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the pairs (N, 2) of rows of ``faces`` (F, 3) that share no vertex and cross, with vertices at ``x`` [m]
    (V, 3). The lower row is first, and pairs are sorted.

    Two triangles cross where an edge of one passes from one side of the other to the other side, within it (Moeller
    1997 states the same by intervals). Touching is not crossing: a corner or an edge that only reaches the other
    triangle's plane, and triangles that overlap within one plane, do not count. Predicates are signs of float64
    determinants; coordinates are taken relative to the mesh, so that they hold far from the origin.
    """
    corners = x[faces] - x[faces].reshape(-1, 3).mean(axis=0)
    x, small = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(faces, np.int32)
    pairs = near_boxes(x, small, small, 0.0).astype(np.int64)
    chunks = range(0, len(pairs), CHUNK_PAIRS)
    crosses = [_cross(*(corners[side] for side in pairs[start : start + CHUNK_PAIRS].T)) for start in chunks]
    pairs = pairs[np.concatenate([np.zeros(0, dtype=bool), *crosses])]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


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
