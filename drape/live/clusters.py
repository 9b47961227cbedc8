"""Vertices in clusters of ``LANES`` that lie side by side on the cloth, in boxes that tell which may come near.

Clusters follow from the cloth alone and stay what they are in every frame. So what is known of pairs along the cloth is
a table of their clusters, and a frame compares all of one cluster with one of another in loops over lanes. Boxes around
``LANES`` clusters that follow each other, groups, leave most others out at once.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from drape.kernels.compiled import kernel, part
from drape.live.sheet import LANES

LANDMARKS = 6  # ways along the cloth to so many vertices tell where on it a vertex is
POINT_ROWS, BOX_ROWS = 3 * LANES, 6 * LANES  # of a cluster's vertices; of the lowest and highest corners of its box


def clusters(graph: scipy.sparse.csr_array) -> np.ndarray:
    """The vertices (C, ``LANES``) int32 of each cluster of a cloth whose edges are the ``graph`` (V, V) of lengths [m].

    Halves of the cloth, and of these again, by the ways to landmarks. What is left of the last one repeats a vertex.
    """
    count = len(graph.indptr) - 1
    ways, nearest, landmark = np.empty((count, LANDMARKS)), np.full(count, np.inf), 0
    for number in range(LANDMARKS):
        way = dijkstra(graph, indices=landmark)
        nearest = np.minimum(nearest, way)
        landmark = int(np.argmax(nearest))  # what none of them leads to comes first
        ways[:, number] = np.where(np.isfinite(way), way, 1.0 + 2.0 * way[np.isfinite(way)].max())
    found = _halved(np.arange(count), ways)
    return np.stack([np.pad(one, (0, LANES - len(one)), mode="edge") for one in found]).astype(np.int32)


def _halved(vertices: np.ndarray, ways: np.ndarray) -> list[np.ndarray]:
    if len(vertices) <= LANES:
        return [vertices]
    there = ways[vertices]
    order = vertices[np.argsort(there[:, np.argmax(np.ptp(there, axis=0))], kind="stable")]
    half = LANES * (-(-len(vertices) // LANES) // 2)
    return _halved(order[:half], ways) + _halved(order[half:], ways)


@part
def less(a, b):
    """The lesser one, b where one is none: one instruction."""
    return a if a < b else b


@part
def more(a, b):
    """The greater one, b where one is none."""
    return a if a > b else b


@part
def squared(x, y, z):
    """The square of a vector's length; a call, as that of ``dot``, would keep these loops from taking vectors."""
    return x * x + y * y + z * z


@kernel
def laid(points, member):
    """``points`` [m] (V, 3) as the clusters of ``member`` (C, ``LANES``) have them: flat, three rows each."""
    rows = np.empty(POINT_ROWS * len(member), points.dtype)
    for c in range(len(member)):
        for lane in range(LANES):
            v = member[c, lane]
            for axis in range(3):
                rows[POINT_ROWS * c + LANES * axis + lane] = points[v, axis]
    return rows


@kernel
def boxes_of(rows):
    """The boxes [m] around clusters of ``rows``, and those around groups of them; flat, ``LANES`` of them in six rows.

    Boxes that fill up the last rows are far from everything.
    """
    boxes = _no_boxes(len(rows) // POINT_ROWS, rows.dtype)
    for c in range(len(rows) // POINT_ROWS):
        _enclose(rows, POINT_ROWS * c, POINT_ROWS * c, boxes, c)
    groups = _no_boxes(len(boxes) // BOX_ROWS, rows.dtype)
    for g in range(len(boxes) // BOX_ROWS):
        _enclose(boxes, BOX_ROWS * g, BOX_ROWS * g + POINT_ROWS, groups, g)
    return boxes, groups


@kernel
def _no_boxes(count, dtype):
    boxes = np.full(BOX_ROWS * (-(-count // LANES)), np.inf).astype(dtype)
    for block in range(len(boxes) // BOX_ROWS):
        for entry in range(POINT_ROWS):
            boxes[BOX_ROWS * block + POINT_ROWS + entry] = -np.inf
    return boxes


@part
def _enclose(rows, lowest, highest, boxes, c):
    """Writes box c around all lanes of three rows from ``lowest`` on and three from ``highest`` on."""
    x, y, z = rows[lowest], rows[lowest + LANES], rows[lowest + 2 * LANES]
    u, v, w = rows[highest], rows[highest + LANES], rows[highest + 2 * LANES]
    for lane in range(1, LANES):
        x = less(rows[lowest + lane], x)
        y = less(rows[lowest + LANES + lane], y)
        z = less(rows[lowest + 2 * LANES + lane], z)
        u = more(rows[highest + lane], u)
        v = more(rows[highest + LANES + lane], v)
        w = more(rows[highest + 2 * LANES + lane], w)
    put = BOX_ROWS * (c // LANES) + c % LANES
    boxes[put], boxes[put + LANES], boxes[put + 2 * LANES] = x, y, z
    boxes[put + 3 * LANES], boxes[put + 4 * LANES], boxes[put + 5 * LANES] = u, v, w


@part
def find_close(a, count, boxes, groups, most, hit, found):
    """How many of ``count`` clusters, from ``a`` on, may have a vertex within the root of ``most`` [m^2] of one of its;
    which they are in ``found`` (C,). ``hit`` (2 ``LANES``,) is to be written in."""
    own, filled = BOX_ROWS * (a // LANES) + a % LANES, 0
    low = (boxes[own], boxes[own + LANES], boxes[own + 2 * LANES])
    high = (boxes[own + 3 * LANES], boxes[own + 4 * LANES], boxes[own + 5 * LANES])
    for block in range(a // (LANES * LANES), len(groups) // BOX_ROWS):
        if not _hits(low, high, groups, block, most, hit, 0):
            continue
        for i in range(LANES):
            group = LANES * block + i
            if not hit[i] or group < a // LANES or group >= len(boxes) // BOX_ROWS:
                continue
            if not _hits(low, high, boxes, group, most, hit, LANES):
                continue
            for j in range(LANES):
                c = LANES * group + j
                if hit[LANES + j] and a <= c < count:
                    found[filled] = c
                    filled += 1
    return filled


@part
def _hits(low, high, boxes, block, most, hit, level):
    """Whether one of a block's boxes is within the root of ``most`` of that from ``low`` to ``high``, in ``hit`` which.

    Rounding is monotone: two points are never nearer to each other than their boxes.
    """
    zero, some, first = boxes.dtype.type(0), 0, BOX_ROWS * block
    for lane in range(LANES):
        x = more(more(boxes[first + lane] - high[0], low[0] - boxes[first + 3 * LANES + lane]), zero)
        y = more(more(boxes[first + LANES + lane] - high[1], low[1] - boxes[first + 4 * LANES + lane]), zero)
        z = more(more(boxes[first + 2 * LANES + lane] - high[2], low[2] - boxes[first + 5 * LANES + lane]), zero)
        one = 1 if squared(x, y, z) < most else 0
        hit[level + lane] = one
        some |= one
    return some > 0
