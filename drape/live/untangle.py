"""Untangling: cloth that passes through itself is moved a little towards where it does not (Volino and
Magnenat-Thalmann 2006, "Resolving surface collisions through intersection contour minimization", ACM TOG 25(3)).

Two sheets cross along a contour. Where an edge with the direction E passes through a triangle with the normal N, the
contour runs on both sides of the edge along R, the unit vectors in which the edge's own triangles cut that triangle.
Relative to the triangle the edge goes along

    G = sum R - 2 N (E . sum R) / (E . N),

by which the contour grows shorter fastest. The edge's ends go one way and the triangle's corners the other way, each by
the mean of its ways, no farther than the body moved (``farthest_way``). Both sheets stay as they are but for that:
there is neither an inside nor a side to remember. What crosses shallowly comes apart within a few frames; the memory of
folds keeps it so. Sheets that lie deep in each other have no short way out, and stay.

The pairs of triangles that cross are found once, by boxes around ``LANES`` triangles side by side and by cones around
their normals, and looked at again in each of ``STEPS`` steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.geometry import meshes
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, at, cross, dot, mix, scaled, sub
from drape.kernels.lane_masks import first_lane, lanes_above, lanes_from, other_lanes
from drape.kernels.lanes import least, most, points_at, put, put3, rows3_at
from drape.live.clusters import boxes_around, clusters, find_close, in_one_cone, less, more, write_cones
from drape.live.sheet import LANES

STEPS, LEAST_M, WAY_M = np.int64(4), 0.0003, 0.002  # each ``int`` would be a type of its own, and compiled
BORDER, OTHERS = -1, -2  # in ``Tangles.across``: nothing is across the edge; the edge is another triangle's
MOST_PAIRS = 8192  # pairs of a frame: bounds its time
OBLIQUE = 0.05  # the least cosine of edge and normal that counts
SOFT = 0.25  # a way of half this size, squared, is halved: contours that all but close leave hardly any way
TOUCH_M2 = 1e-12  # boxes that only touch may cross
# Cloth side by side whose normals differ from an axis by less does not cross itself; by a right angle would do but for
# cloth whose border crosses itself.
CONE_RAD = 0.45 * np.pi

# Rows of a cluster of triangles: three corners, the least and the most corner of the box, the normal, as long as twice
# the area, and the plane's height along it.
CORNERS, LOW, HIGH, NORMAL, HEIGHT = 0, 9 * LANES, 12 * LANES, 15 * LANES, 18 * LANES
ROWS = 19 * LANES


class Tangles(NamedTuple):
    """The triangles of a cloth in C clusters of ``LANES``.

    ``corner`` (3 C ``LANES``,): three rows a cluster, places of the corners; ``across``: as many rows, the place across
    each edge, the first being that from the first to the second corner, ``BORDER`` where there is none. Every edge
    counts for one of its triangles, and has ``OTHERS`` in the other one. Clusters that are not full repeat a triangle.
    ``beside[start[a] : start[a + 1]]`` are cluster a and those behind it that share a corner with it.
    """

    corner: np.ndarray
    across: np.ndarray
    start: np.ndarray
    beside: np.ndarray


def tangles_of(faces: np.ndarray, place: np.ndarray) -> Tangles:
    """Those of the triangles ``faces`` (F, 3), whose vertices are at ``place`` (V,)."""
    halves, first, second = meshes.edge_pairs(faces)  # half-edge 3 f + n begins at a corner of face f
    graph = scipy.sparse.coo_matrix(
        (np.ones(2 * len(first)), np.divmod(np.stack([[*first, *second], [*second, *first]]), 3)[0]),
        shape=(len(faces), len(faces)),
    ).tocsr()
    across = np.full(len(halves), BORDER)
    across[second] = OTHERS
    across[first] = place[halves[second, 2]]
    member = clusters(graph)
    flat = [each.reshape(-1, 3)[member].transpose(0, 2, 1).reshape(-1) for each in (place[halves[:, 0]], across)]
    touched = scipy.sparse.coo_matrix(
        (np.ones(3 * member.size), (np.arange(len(member)).repeat(3 * LANES), faces[member].reshape(-1))),
        shape=(len(member), len(place)),
    ).tocsr()
    beside = scipy.sparse.csr_matrix(scipy.sparse.triu(touched @ touched.T))
    return Tangles(*(np.ascontiguousarray(each, np.int32) for each in (*flat, beside.indptr, beside.indices)))


@kernel
def farthest_way(moved_m):
    """How far [m] a step of ``untangle`` goes at most where the network moved by ``moved_m`` [m].

    That is no farther, or cloth on a body that stands still would not come to rest; but for ``LEAST_M``, or cloth would
    crumple through itself there.
    """
    return min(WAY_M, max(moved_m, LEAST_M))


@kernel
def untangle(x, tangles, chosen, farthest, steps=STEPS):
    """Moves ``x`` [m] (P, 3) in place where triangles of the clusters ``chosen`` (n,), in rising order, cross, by
    ``farthest`` [m] at most in each of ``steps``.

    Returns how many ways each place (P,) had in the last step: more than none where cloth crossed.
    """
    pairs, count = crossing(x, tangles, chosen), np.zeros(len(x), x.dtype)
    if len(pairs):
        way = np.empty_like(x)
        for _ in range(steps):
            way[:], count[:] = 0, 0
            for n in range(2 * len(pairs)):
                _shorten(x, tangles, pairs[n // 2, n % 2], pairs[n // 2, 1 - n % 2], way, count)
            for v in range(len(x)):
                if count[v] > 0:
                    for i in range(3):
                        x[v, i] += farthest / count[v] * way[v, i]
    return count


@kernel
def crossing(x, tangles, chosen):
    """Pairs (N, 2) int32 of triangles, cluster times ``LANES`` plus lane, of the clusters ``chosen``, that share no
    corner and may cross: each has corners on both sides of the other one, and their boxes overlap. ``MOST_PAIRS`` at
    most."""
    corner, count = tangles.corner, len(chosen)
    pairs, filled = np.empty((MOST_PAIRS, 2), np.int32), 0
    if count == 0:
        return pairs[:0].copy()
    rows, number = np.empty(ROWS * count, x.dtype), np.full(len(tangles.start) - 1, -1, np.int32)
    for n in range(count):
        _lay(x, corner, chosen[n], rows, ROWS * n)
        number[chosen[n]] = n
    boxes, groups = boxes_around(rows, ROWS, LOW, HIGH)
    cones = np.empty((count, 4), x.dtype)
    write_cones(rows, ROWS, NORMAL, CONE_RAD, cones)
    joined = np.full(count, -1, np.int32)
    close = np.empty(count, np.int32)
    for a in range(count):
        for entry in range(tangles.start[chosen[a]], tangles.start[chosen[a] + 1]):
            if number[tangles.beside[entry]] >= 0:
                joined[number[tangles.beside[entry]]] = a
        for found in range(find_close(a, count, boxes, groups, x.dtype.type(TOUCH_M2), close)):
            b = close[found]
            if joined[b] == a and in_one_cone(cones, a, b):
                continue
            reach = _reach_box(rows, ROWS * a, boxes, b)
            while reach:
                i, reach = first_lane(reach), reach & (reach - 1)
                sides = _have_sides(rows, ROWS * a, i, ROWS * b)
                sides = lanes_from(sides, i + 1 if a == b else 0)
                while sides:
                    j, sides = first_lane(sides), sides & (sides - 1)
                    if (
                        filled < MOST_PAIRS
                        and not _joined(corner, 3 * LANES * chosen[a] + i, 3 * LANES * chosen[b] + j)
                        and _is_parted(rows, ROWS * a, i, ROWS * b, j)
                    ):
                        pairs[filled, 0], pairs[filled, 1] = LANES * chosen[a] + i, LANES * chosen[b] + j
                        filled += 1
    return pairs[:filled].copy()


@part
def _lay(x, corner, c, rows, first):
    """Writes the rows of cluster ``c`` from ``first`` on."""
    p, q = points_at(x, corner, 3 * LANES * c), points_at(x, corner, 3 * LANES * c + LANES)
    r = points_at(x, corner, 3 * LANES * c + 2 * LANES)
    put3(rows, first, p)
    put3(rows, first + 3 * LANES, q)
    put3(rows, first + 6 * LANES, r)
    n = cross(sub(q, p), sub(r, p))
    put3(rows, first + NORMAL, n)
    put(rows, first + HEIGHT, dot(n, p))
    for axis in range(3):
        put(rows, first + LOW + LANES * axis, least(least(p[axis], q[axis]), r[axis]))
        put(rows, first + HIGH + LANES * axis, most(most(p[axis], q[axis]), r[axis]))


@part
def _corner(rows, first, lane):
    return rows[first + lane], rows[first + LANES + lane], rows[first + 2 * LANES + lane]


@part
def _reach_box(rows, own, boxes, b):
    """The triangles of the cluster at ``own`` whose box reaches that of cluster ``b``."""
    box = 6 * LANES * (b // LANES) + b % LANES
    low, high = rows3_at(rows, own + LOW), rows3_at(rows, own + HIGH)
    x = most(low[0] - boxes[box + 3 * LANES], boxes[box] - high[0])
    y = most(low[1] - boxes[box + 4 * LANES], boxes[box + LANES] - high[1])
    z = most(low[2] - boxes[box + 5 * LANES], boxes[box + 2 * LANES] - high[2])
    return other_lanes(lanes_above(most(most(x, y), z), 0.0))


@part
def _have_sides(rows, own, i, other):
    """The triangles of the cluster at ``other`` that have corners on both sides of the plane of triangle ``i`` and
    whose box overlaps that one's."""
    n, height = _corner(rows, own + NORMAL, i), rows[own + HEIGHT + i]
    a, b = dot(n, rows3_at(rows, other)), dot(n, rows3_at(rows, other + 3 * LANES))
    c = dot(n, rows3_at(rows, other + 6 * LANES))
    apart = most(least(least(a, b), c) - height, height - most(most(a, b), c))
    low, high = _corner(rows, own + LOW, i), _corner(rows, own + HIGH, i)
    lower, higher = rows3_at(rows, other + LOW), rows3_at(rows, other + HIGH)
    x = most(lower[0] - high[0], low[0] - higher[0])
    y = most(lower[1] - high[1], low[1] - higher[1])
    z = most(lower[2] - high[2], low[2] - higher[2])
    return lanes_above(0.0, most(apart, most(most(x, y), z)))


@part
def _is_parted(rows, own, i, other, j):
    """Whether the plane of triangle ``j`` has corners of triangle ``i`` on both sides."""
    p, n = _corner(rows, other, j), _corner(rows, other + NORMAL, j)
    a = dot(n, sub(_corner(rows, own, i), p))
    b, c = dot(n, sub(_corner(rows, own + 3 * LANES, i), p)), dot(n, sub(_corner(rows, own + 6 * LANES, i), p))
    return less(less(a, b), c) < 0 and more(more(a, b), c) > 0


@part
def _joined(corner, first, second):
    """Whether the triangles whose corners are at ``first`` and ``second`` share one."""
    same = False
    for n in range(3):
        for m in range(3):
            same |= corner[first + LANES * n] == corner[second + LANES * m]
    return same


@part
def _shorten(x, tangles, edged, through, way, count):
    """Adds the ways of the edges of the triangle ``edged`` that pass through the triangle ``through``."""
    corner = _threes(tangles.corner, edged)
    across, other = _threes(tangles.across, edged), _threes(tangles.corner, through)
    a, b, c = at(x, other[0]), at(x, other[1]), at(x, other[2])
    normal = cross(sub(b, a), sub(c, a))
    length = np.sqrt(dot(normal, normal))
    if not length > 0:
        return
    normal = scaled(x.dtype.type(1) / length, normal)
    for n in range(3):
        if across[n] == OTHERS:
            continue
        p, q = at(x, corner[n]), at(x, corner[(n + 1) % 3])
        below, above = dot(normal, sub(p, a)), dot(normal, sub(q, a))
        if not below * above < 0:
            continue
        edge = sub(q, p)
        y = mix(x.dtype.type(1), p, below / (below - above), edge)
        if min(_turn(a, b, y, normal), _turn(b, c, y, normal), _turn(c, a, y, normal)) < 0:
            continue
        along = scaled(x.dtype.type(1) / np.sqrt(dot(edge, edge)), edge)
        run = _run(along, sub(at(x, corner[(n + 2) % 3]), p), normal)
        if across[n] != BORDER:
            run = add(run, _run(along, sub(at(x, across[n]), p), normal))
        steep = dot(along, normal)
        flattest = x.dtype.type(OBLIQUE)
        steep = max(steep, flattest) if steep > 0 else min(steep, -flattest)
        shortest = mix(x.dtype.type(1), run, x.dtype.type(-2) * dot(along, run) / steep, normal)
        shortest = scaled(x.dtype.type(1) / np.sqrt(dot(shortest, shortest) + x.dtype.type(SOFT)), shortest)
        for end in (corner[n], corner[(n + 1) % 3]):
            _go(way, count, end, x.dtype.type(1), shortest)
        for m in range(3):
            _go(way, count, other[m], x.dtype.type(-1), shortest)


@part
def _threes(table, triangle):
    """The three numbers of a ``triangle`` in a ``table`` of three rows a cluster."""
    first = 3 * LANES * (triangle // LANES) + triangle % LANES
    return table[first], table[first + LANES], table[first + 2 * LANES]


@part
def _turn(a, b, y, normal):
    return dot(cross(sub(b, a), sub(y, a)), normal)


@part
def _run(along, inward, normal):
    """The unit vector, in the triangle that lies ``inward`` of an edge, ``along`` the plane with the ``normal``; zero
    where both are parallel."""
    found = cross(normal, cross(along, inward))
    length = np.sqrt(dot(found, found))
    if not length > 0:
        return found
    into = sub(inward, scaled(dot(inward, along), along))
    length = length if dot(found, into) > 0 else -length
    return found[0] / length, found[1] / length, found[2] / length


@part
def _go(way, count, v, sign, a):
    for i in range(3):
        way[v, i] += sign * a[i]
    count[v] += 1
