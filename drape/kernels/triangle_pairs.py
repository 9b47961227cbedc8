"""Pairs of a vertex and a triangle, of two edges, or of two triangles: which are near, how far apart, which cross.

The simulator's contact of cloth with itself, the judge's barrier and the count of crossings use them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, sub

PARALLEL = 1e-9  # of the squared lengths' product: two edges with less between them have no nearest points
TINY_M2 = 1e-30
CHUNK_PAIRS = 1_000_000  # pairs of triangles looked at together: bounds the memory


class Pairs(NamedTuple):
    """``corner`` (N, 4), vertices: one and a triangle's in the first ``triangles`` rows, then two edges'."""

    corner: np.ndarray
    triangles: int


def pairs_within(
    x: np.ndarray, faces: np.ndarray, edges: np.ndarray, reach_m: float
) -> tuple[Pairs, np.ndarray, np.ndarray]:
    """The pairs of ``x`` [m] (V, 3) nearer than ``reach_m`` that share no vertex, with the weights of their corners.

    ``faces`` (F, 3), ``edges`` (E, 2). The weights (N, 4) make the way (N, 3) [m] between the nearest points of a pair,
    the third result, of its corners.
    """
    points = np.arange(len(x), dtype=np.int32)[:, None]
    faces, edges = np.ascontiguousarray(faces, np.int32), np.ascontiguousarray(edges, np.int32)
    over, beside = near_boxes(x, points, faces, reach_m), near_boxes(x, edges, edges, reach_m)
    by_triangle = np.concatenate([points[over[:, 0]], faces[over[:, 1]]], axis=1)
    corner, count = np.concatenate([by_triangle, edges[beside].reshape(-1, 4)]), len(over)
    weight, way = ways(x, corner, count)
    near = np.linalg.norm(way, axis=1) < reach_m
    return Pairs(corner[near], int(near[:count].sum())), weight[near], way[near]


def near_boxes(x: np.ndarray, first: np.ndarray, second: np.ndarray, reach_m: float) -> np.ndarray:
    """Numbers (N, 2) of rows of ``first`` and ``second``, vertices of elements, that share none of them and whose boxes
    are at most ``reach_m`` apart along every axis; of one set of elements each pair once, the lower number first.
    """
    own, other = (np.stack([x[element].min(axis=1), x[element].max(axis=1)]) for element in (first, second))
    if not len(second):
        return np.zeros((0, 2), np.int32)
    axis = int(np.ptp(x, axis=0).argmax())
    order = np.argsort(other[0, :, axis], kind="stable")
    begin, longest = other[0, order, axis], (other[1] - other[0])[:, axis].max()
    start = np.searchsorted(begin, own[0, :, axis] - reach_m - longest)
    end = np.searchsorted(begin, own[1, :, axis] + reach_m, side="right")
    return _near_boxes((own, other), (first, second), order, (start, end), reach_m, first is second)


@kernel
def _near_boxes(boxes, elements, order, window, reach, same):
    (own, other), (first, second), (start, end) = boxes, elements, window
    found, filled = np.empty((16 * len(first) + 16, 2), np.int32), 0
    for e in range(len(first)):
        for place in range(start[e], end[e]):
            f = order[place]
            if same and f <= e:
                continue
            apart = False
            for i in range(3):
                apart |= other[0, f, i] > own[1, e, i] + reach or other[1, f, i] < own[0, e, i] - reach
            for n in range(first.shape[1]):
                for m in range(second.shape[1]):
                    apart |= first[e, n] == second[f, m]
            if apart:
                continue
            if filled == len(found):
                longer = np.empty((2 * len(found), 2), np.int32)
                longer[:filled] = found
                found = longer
            found[filled, 0], found[filled, 1] = e, f
            filled += 1
    return found[:filled]


# --- distances --------------------------------------------------------------------------------------------------------


@kernel
def ways(x, corner, triangles):
    """The weights (N, 4) of the corners in the way between the nearest points of each pair, and that way [m] (N, 3)."""
    weights, found = np.empty((len(corner), 4)), np.empty((len(corner), 3))
    for n in range(len(corner)):
        weight, way = way_between(x, corner[n], n < triangles)
        for c in range(4):
            weights[n, c] = weight[c]
        for i in range(3):
            found[n, i] = way[i]
    return weights, found


@kernel
def way_between(x, corner, by_triangle):
    """The same of one pair, as tuples."""
    a, b, c, d = at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3])
    if by_triangle:
        u, v, w = _weights_in_triangle(a, b, c, d)
        weight = (1.0, -u, -v, -w)
    else:
        t, u = _shares_of_edges(a, b, c, d)
        weight = (1.0 - t, t, u - 1.0, -u)
    way = (
        weight[0] * a[0] + weight[1] * b[0] + weight[2] * c[0] + weight[3] * d[0],
        weight[0] * a[1] + weight[1] * b[1] + weight[2] * c[1] + weight[3] * d[1],
        weight[0] * a[2] + weight[1] * b[2] + weight[2] * c[2] + weight[3] * d[2],
    )
    return weight, way


@kernel
def _clamped(a):
    return min(max(a, 0.0), 1.0)


@kernel
def _weights_in_triangle(p, a, b, c):
    """Barycentric coordinates of the point of the triangle a, b, c that is nearest to p (Ericson 2005, 5.1.5)."""
    ab, ac, ap = sub(b, a), sub(c, a), sub(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    bp = sub(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    cp = sub(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / (d4 - d3 + d5 - d6)
        return 0.0, 1.0 - t, t
    total = va + vb + vc
    return va / total, vb / total, vc / total


@kernel
def _shares_of_edges(p, q, r, s):
    """How far along the edges pq and rs the two points are that are nearest to each other (Ericson 2005, 5.1.9).

    Of parallel edges the middle of the first, where the second reaches so far.
    """
    first, second, between = sub(q, p), sub(s, r), sub(p, r)
    a, e, f = max(dot(first, first), TINY_M2), max(dot(second, second), TINY_M2), dot(second, between)
    b, c = dot(first, second), dot(first, between)
    denominator = a * e - b * b
    t = _clamped((b * f - c * e) / denominator) if denominator > PARALLEL * a * e else 0.5
    u = (b * t + f) / e
    if u < 0.0:
        return _clamped(-c / a), 0.0
    if u > 1.0:
        return _clamped((b - c) / a), 1.0
    return t, u


# --- crossings --------------------------------------------------------------------------------------------------------


def crossing_pairs(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs (N, 2) of ``faces`` (F, 3) that share no vertex and cross at ``x`` [m] (V, 3), i < j, sorted.

    Two triangles cross where an edge of one passes from one side of the other to the other side, within it (Moeller
    1997 states the same by intervals). Touching is not crossing: a corner or an edge that only reaches the other
    triangle's plane, and triangles that overlap within one plane, do not count. Predicates are signs of float64
    determinants; coordinates are taken relative to the mesh, so that they hold far from the origin.
    """
    corners = x[faces] - x[faces].reshape(-1, 3).mean(axis=0)
    small = np.ascontiguousarray(faces, np.int32)
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
