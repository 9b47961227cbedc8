"""Clusters of ``LANES`` vertices side by side on the cloth, and boxes around them that tell which may come near.

Clusters follow from the cloth alone and are the same in every frame. Distances along the cloth are therefore stored by
pairs of clusters, and a frame compares two clusters in loops over lanes. A group is ``LANES``
clusters in a row; the boxes around groups rule out most clusters at once.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import dot, scaled
from drape.kernels.lane_masks import first_lane, lanes_above, lanes_before, lanes_from
from drape.kernels.lanes import most, put, root, rows3_at, sums
from drape.live.sheet import LANES

LANDMARKS = 6  # the ways along the cloth to so many vertices tell where on it a vertex is
TINY = 1e-30
POINT_ROWS, BOX_ROWS = 3 * LANES, 6 * LANES  # numbers of a cluster's points, and of the corners of ``LANES`` boxes


def clusters(graph: scipy.sparse.csr_array) -> np.ndarray:
    """The vertices (C, ``LANES``) int32 of each cluster; ``graph`` (V, V) has the lengths [m] of the cloth's edges.

    The cloth is halved again and again by the ways to landmarks. A cluster that is not full repeats a vertex.
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
    """The smaller one, ``b`` where one is NaN: one instruction."""
    return a if a < b else b


@part
def more(a, b):
    """The larger one, ``b`` where one is NaN."""
    return a if a > b else b


@part
def squared(x, y, z):
    """The square of a vector's length; with a call to ``dot`` loops would not be compiled to vector instructions."""
    return x * x + y * y + z * z


@kernel
def laid(points, member):
    """``points`` [m] (V, 3) in the order of the clusters ``member`` (C, ``LANES``): flat, three rows each."""
    rows = np.empty(POINT_ROWS * len(member), points.dtype)
    for c in range(len(member)):
        for lane in range(LANES):
            v = member[c, lane]
            for axis in range(3):
                rows[POINT_ROWS * c + LANES * axis + lane] = points[v, axis]
    return rows


@kernel
def boxes_around(rows, size, low, high):
    """The boxes [m] around clusters, which have ``size`` numbers of ``rows`` each, and those around groups of them.

    Three rows from ``low`` on have the least coordinates of a cluster's members, three from ``high`` on the most. Both
    results are flat, ``LANES`` boxes in six rows. Boxes that fill up the last rows are far from everything.
    """
    boxes = _no_boxes(len(rows) // size, rows.dtype)
    for c in range(len(rows) // size):
        _enclose(rows, size * c + low, size * c + high, boxes, c)
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
    """Writes box ``c`` around the three rows from ``lowest`` on and the three from ``highest`` on."""
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
def find_close(a, count, boxes, groups, reach, found):
    """How many of the clusters ``a`` to ``count`` - 1 have a box within the root of ``reach`` [m^2] of that of ``a``.

    They are written to ``found`` (C,).
    """
    own, filled = BOX_ROWS * (a // LANES) + a % LANES, 0
    low = (boxes[own], boxes[own + LANES], boxes[own + 2 * LANES])
    high = (boxes[own + 3 * LANES], boxes[own + 4 * LANES], boxes[own + 5 * LANES])
    for block in range(a // (LANES * LANES), len(groups) // BOX_ROWS):
        near = lanes_from(_hits(low, high, groups, block, reach), a // LANES - LANES * block)
        near &= lanes_before(len(boxes) // BOX_ROWS - LANES * block)
        while near:
            group, near = LANES * block + first_lane(near), near & (near - 1)
            hit = lanes_from(_hits(low, high, boxes, group, reach), a - LANES * group)
            hit &= lanes_before(count - LANES * group)
            while hit:
                found[filled] = LANES * group + first_lane(hit)
                hit &= hit - 1
                filled += 1
    return filled


@kernel
def write_cones(rows, size, first, angle, cones):
    """Writes the axis of each cluster's normals to ``cones`` (C, 4), and the cosine of the angle up to which the axes
    of two such clusters count as one (``in_one_cone``), above 1 where none does.

    Clusters have ``size`` numbers of ``rows`` each, the normals, of any length, in three rows from ``first`` on.
    ``angle`` [rad] is that of the cone, less than a right one.
    """
    kind = rows.dtype.type
    one, two, tiny = kind(1), kind(2), kind(TINY)
    least, double, across = kind(np.cos(angle)), kind(np.cos(2.0 * angle)), kind(np.sin(2.0 * angle))
    cosines = np.empty(LANES, rows.dtype)
    for c in range(len(cones)):
        n = rows3_at(rows, size * c + first)
        n = scaled(one / root(most(dot(n, n), tiny)), n)
        axis = sums(n[0], n[1], n[2])
        axis = scaled(one / max(np.sqrt(dot(axis, axis)), tiny), axis)
        put(cosines, 0, dot(axis, n))
        cosine = one
        for lane in range(LANES):
            cosine = less(cosines[lane], cosine)
        cones[c, 0], cones[c, 1], cones[c, 2] = axis
        # cos 2 (angle - a), a the largest angle of a normal to the axis
        sine = np.sqrt(max(one - cosine * cosine, kind(0)))
        limit = double * (two * cosine * cosine - one) + across * two * cosine * sine
        cones[c, 3] = limit if cosine > least else two


@part
def in_one_cone(cones, a, b):
    """Whether all normals of two clusters are within the cones' angle of the axis between theirs: with b the angle
    between their axes and a the larger one of a normal to its own, b / 2 + a is less (Volino and Magnenat-Thalmann
    1994, "Efficient self-collision detection on smoothly discretized surface animations using geometrical shape
    regularity", CGF 13(3))."""
    cosine = cones[a, 0] * cones[b, 0] + cones[a, 1] * cones[b, 1] + cones[a, 2] * cones[b, 2]
    return cosine > more(cones[a, 3], cones[b, 3])


@part
def _hits(low, high, boxes, block, reach):
    """The lanes of a block whose box is within the root of ``reach`` of that from ``low`` to ``high``.

    Rounding is monotone, so that two points are never nearer to each other than their boxes.
    """
    first = BOX_ROWS * block
    lowest, highest = rows3_at(boxes, first), rows3_at(boxes, first + 3 * LANES)
    x = most(most(lowest[0] - high[0], low[0] - highest[0]), 0.0)
    y = most(most(lowest[1] - high[1], low[1] - highest[1]), 0.0)
    z = most(most(lowest[2] - high[2], low[2] - highest[2]), 0.0)
    return lanes_above(reach, squared(x, y, z))
