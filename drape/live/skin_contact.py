"""Contact with the posed skin: for each vertex the nearest sample, walked to from the frame before, and the nearest one
of other parts of the body within reach; at both a plane blended from the sample and its neighbours.

A frame moves a vertex by less than a few samples, so a walk over their graph, always to the nearest neighbour, ends at
the nearest one of the part that the vertex was at: a sleeve stays with its arm where that touches the trunk. A vertex
without a past starts at the sample that is nearest at rest. It is the network's vertex that walks, and from its sample
the fold goes a few steps: a fold that crossed an arm would otherwise be kept on its far side for ever.

What else comes near (the trunk to that sleeve, a thigh to a belly) is looked up in a grid over the samples, for a
quarter of the vertices each frame, and walked to in between. It counts where it is another part, far away at rest, or
where the skin is hollow in between: the sample then lies above the tangent plane of the vertex's own one, as it never
does on a limb.

One tangent plane for all that lies nearest to a sample would give a limb facets. The planes of sample and neighbours
are therefore blended with weights that end at the spacing. Over a sphere a point is off the tangent plane of a sample
by what the surface falls away meanwhile, but a chord stands at right angles to the mean of the normals at its ends:
distances are measured along the mean of the sample's normal and the blended one, and have no ripple then.

Walks and planes are computed for ``LANES`` vertices at once, as sweeps are; P is a multiple of that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.contact.samples import FACING, Samples
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, at, cross, dot, scaled, sub
from drape.kernels.lanes import (
    least,
    most,
    normals_at,
    points_at,
    points_in,
    put,
    put3,
    put_points,
    root,
    row_at,
    samples_at,
    where_above,
    where_other,
)
from drape.live.sheet import LANES
from drape.live.sweeps import PLANES, SLIP_M

NEIGHBOURS = 8
CANDIDATES = 24  # of which those that face another way are left out
STEPS = 3  # of a walk from the network's sample to the fold's: less than to the far side of an arm
REACH_M = 0.03  # of what comes near: deeper than that a vertex is not in another part
PER_CELL = 1.0 / (2.0 * REACH_M)
TURNS = 4  # frames until every vertex has looked for other parts
HOLLOW_M, APART_M = 0.05, 0.12  # distance at rest from which skin may be hollow in between, and is another part


class SkinGraph(NamedTuple):
    """``neighbour`` (S, 8) of every sample, itself where there are fewer; ``reach_m2`` (S,): the spacing squared;
    ``rest`` [m] (S, 3): where it lies at rest."""

    neighbour: np.ndarray
    reach_m2: np.ndarray
    rest: np.ndarray


def skin_graph(skin: Samples) -> SkinGraph:
    """The graph of the samples of ``skin`` by their distance at rest."""
    _, near = KDTree(skin.point).query(skin.point, k=min(CANDIDATES, skin.count))
    facing = np.einsum("snc,sc->sn", skin.normal[near], skin.normal) > FACING
    own = np.arange(skin.count)[:, None]
    order = np.argsort(~facing | (near == own), axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = np.where(np.take_along_axis(facing, order, axis=1), np.take_along_axis(near, order, axis=1), own)
    return SkinGraph(np.ascontiguousarray(chosen, np.int32), skin.spacing_m**2, skin.point)


def nearest_at_rest(vertices: np.ndarray, skin: Samples) -> np.ndarray:
    """The sample (V,) int32 nearest to each of ``vertices`` [m] (V, 3), both at rest."""
    return np.asarray(KDTree(skin.point).query(vertices)[1], dtype=np.int32)


class Touched(NamedTuple):
    """The sample that the network has each place at, ``own`` (P,), and one of another part, ``other`` (P,), or -1."""

    own: np.ndarray
    other: np.ndarray


# Rows of the scratch: which neighbour of each lane's sample is nearer than it, or a foot and the normal there.
NEARER, FOOT, UNIT, SCRATCH = 0, 0, 3 * LANES, 6 * LANES


class Lanes(NamedTuple):
    """A place, ``vertex``, and a ``sample`` of the skin in each lane (``LANES``,), whose neighbours are ``near`` (8
    ``LANES``,), a row each; ``scratch`` for rows of numbers."""

    vertex: np.ndarray
    sample: np.ndarray
    near: np.ndarray
    scratch: np.ndarray


@kernel
def _lanes(skin):
    return Lanes(
        np.empty(LANES, np.int32),
        np.empty(LANES, np.int32),
        np.empty(NEIGHBOURS * LANES, np.int32),
        np.empty(SCRATCH, skin.dtype),
    )


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    lanes = _lanes(skin)
    for block in range(len(network) // LANES):
        for lane in range(LANES):
            lanes.sample[lane] = touched.own[LANES * block + lane]
        _walk(points_in(network, LANES * block), lanes, skin, graph.neighbour, len(skin))
        for lane in range(LANES):
            touched.own[LANES * block + lane] = lanes.sample[lane]


@kernel
def carried(grip, touched, skin, graph, found):
    """Where the posed ``skin`` has taken what lies ``grip`` [m] (P, 3) in the frames of the samples ``touched.own``:
    ``found`` [m] (P, 3)."""
    lanes = _lanes(skin)
    for block in range(len(grip) // LANES):
        place = LANES * block
        own, n, e, b = _skin_frames(skin, graph, touched, place, lanes)
        a = points_in(grip, place)
        put_points(found, place, add(own, add(add(scaled(a[0], n), scaled(a[1], e)), scaled(a[2], b))))


@kernel
def gripped(x, stuck, touched, skin, graph, grip):
    """Writes how what is ``stuck`` [m] (P, 3) to the posed ``skin`` lies in the frames of its samples ``touched.own``,
    having come along below ``x`` [m] (P, 3), that it is never farther from than ``SLIP_M``."""
    one, most_m, lanes = x.dtype.type(1), x.dtype.type(SLIP_M), _lanes(skin)
    for block in range(len(x) // LANES):
        place = LANES * block
        own, n, e, b = _skin_frames(skin, graph, touched, place, lanes)
        points = points_in(x, place)
        slip = sub(points, points_in(stuck, place))
        slip = sub(slip, scaled(dot(slip, n), n))
        length = root(most(dot(slip, slip), most_m * most_m))
        off = sub(sub(points, scaled(where_above(length, most_m, most_m / length, one), slip)), own)
        put_points(grip, place, (dot(off, n), dot(off, e), dot(off, b)))


@part
def _skin_frames(skin, graph, touched, place, lanes):
    """The samples of a block from ``place`` on, their normals, the way to the first neighbour of each laid into the
    plane, and the product of the two.

    A sample without neighbours has the normal only: what lies on it is carried along the normal alone.
    """
    zero, one = skin.dtype.type(0), skin.dtype.type(1)
    for lane in range(LANES):
        lanes.near[lane] = graph.neighbour[touched.own[place + lane], 0]
    x, y, z, _ = samples_at(skin, touched.own, place)
    a, b, c, _ = normals_at(skin, touched.own, place)
    own, n = (x, y, z), (a, b, c)
    x, y, z, _ = samples_at(skin, lanes.near, 0)
    way = sub((x, y, z), own)
    e = sub(way, scaled(dot(way, n), n))
    square = dot(e, e)
    e = scaled(one / root(where_above(square, zero, square, one)), e)
    return own, n, e, cross(n, e)


@kernel
def touch(x, skin, graph, sheet, touched, turn, planes):
    """Moves ``touched.other`` on to what is near ``x`` [m] (P, 3), and writes the ``planes``.

    ``skin`` (S, 8): a ``drape.contact.samples.sample_table``. Other parts are looked up for vertices whose number is
    ``turn`` modulo ``TURNS``, for all where it is negative. ``planes`` flat, the first twelve rows of each block: the
    foot of x and the normal of the own part, and of the other one, with a normal of zero where none is near.
    """
    k = sheet.constants
    cells = cells_of(skin, PER_CELL)
    # Few vertices are near another part: their planes wait until there are as many as lanes.
    lanes, late, waiting = _lanes(skin), _lanes(skin), 0
    own = lanes.sample
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            own[lane] = touched.own[LANES * block + lane]
        points = points_in(x, LANES * block)
        _walk(points, lanes, skin, graph.neighbour, STEPS)
        foot, unit = _plane(points, lanes, skin, graph)
        put3(planes, PLANES * block, foot)
        put3(planes, PLANES * block + 3 * LANES, unit)
        for entry in range(PLANES * block + 6 * LANES, PLANES * block + 12 * LANES):
            planes[entry] = k.zero
        for lane in range(LANES):
            v = LANES * block + lane
            other = touched.other[v]
            if turn < 0 or sheet.vertex[v] % TURNS == turn:
                other = _other(at(x, v), skin, graph, own[lane], cells)
            elif other >= 0:
                other = _nearest(at(x, v), skin, graph, other, STEPS)
                if _square(at(x, v), skin, other) >= REACH_M * REACH_M or not _is_other(skin, graph, own[lane], other):
                    other = np.int32(-1)
            touched.other[v] = other
            if other >= 0:
                late.vertex[waiting], late.sample[waiting] = v, other
                waiting += 1
            if waiting == LANES:
                _put_late(x, late, skin, graph, planes)
                waiting = 0
    if waiting > 0:
        for lane in range(waiting, LANES):
            late.vertex[lane], late.sample[lane] = late.vertex[0], late.sample[0]
        _put_late(x, late, skin, graph, planes)


@kernel
def _walk(points, lanes, skin, neighbour, steps):
    """``_nearest`` for a point in every lane, from ``lanes.sample``, moved in place."""
    own, near, nearer = lanes.sample, lanes.near, lanes.scratch
    square = _squares(points, skin, own, 0)
    for _ in range(steps):
        _look_around(own, neighbour, near)
        which = 0.0 * square - 1.0  # none
        for n in range(NEIGHBOURS):
            other = _squares(points, skin, near, LANES * n)
            which = where_above(square, other, float(n), which)
            square = where_above(square, other, other, square)
        put(nearer, NEARER, which)
        moved = False
        for lane in range(LANES):
            if nearer[NEARER + lane] >= 0.0:
                own[lane], moved = near[LANES * int(nearer[NEARER + lane]) + lane], True
        if not moved:
            break


@part
def _look_around(own, neighbour, near):
    """Writes the neighbours of the samples ``own`` (``LANES``,) to ``near``, a row each."""
    for lane in range(LANES):
        for n in range(NEIGHBOURS):
            near[LANES * n + lane] = neighbour[own[lane], n]


@part
def _squares(points, skin, index, start):
    """Squares of the distances from ``points`` to the samples of a row."""
    x, y, z, _ = samples_at(skin, index, start)
    way = sub((x, y, z), points)
    return dot(way, way)


@kernel
def _is_other(skin, graph, own, sample):
    """Whether ``sample`` is of another part of the body than ``own``, or the skin is hollow in between."""
    apart = sub(at(graph.rest, sample), at(graph.rest, own))
    rest = dot(apart, apart)
    if rest > APART_M * APART_M:
        return True
    rise = dot((skin[own, 4], skin[own, 5], skin[own, 6]), sub(at(skin, sample), at(skin, own)))
    return rest > HOLLOW_M * HOLLOW_M and rise > 0.0


@kernel
def _square(point, skin, sample):
    way = sub(point, at(skin, sample))
    return dot(way, way)


@kernel
def _nearest(point, skin, graph, own, steps):
    """Where a walk from the sample ``own`` ends, of ``steps`` at most."""
    nearest = _square(point, skin, own)
    for _ in range(steps):
        here = own
        for n in range(NEIGHBOURS):
            square = _square(point, skin, graph.neighbour[here, n])
            if square < nearest:
                nearest, own = square, graph.neighbour[here, n]
        if own == here:
            break
    return own


@kernel
def cells_of(points, per_cell):
    """The ``points`` [m] (N, 3 or more) in cells, ``per_cell`` a metre: ``member[start[c] : start[c + 1]]`` of cell c.

    With the lowest corner (3,) and how many cells there are along each axis (3,), which for points of numbers that are
    none, or larger than a house, is none.
    """
    low, size = np.empty(3), np.zeros(3, np.int64)
    for axis in range(3):
        low[axis], high = points[0, axis], points[0, axis]
        for s in range(len(points)):
            low[axis], high = min(low[axis], points[s, axis]), max(high, points[s, axis])
        extent = high - low[axis]
        size[axis] = int(extent * per_cell) + 1 if extent < 10.0 else 0
    start, member = np.zeros(size[0] * size[1] * size[2] + 1, np.int32), np.empty(len(points), np.int32)
    if len(start) > 1:
        cell = np.empty(len(points), np.int32)
        for s in range(len(points)):
            c = 0
            for axis in range(3):
                c = c * size[axis] + int((points[s, axis] - low[axis]) * per_cell)
            cell[s] = c
            start[c + 1] += 1
        for c in range(len(start) - 1):
            start[c + 1] += start[c]
        filled = start.copy()
        for s in range(len(points)):
            member[filled[cell[s]]] = s
            filled[cell[s]] += 1
    return start, member, low, size


@kernel
def _other(point, skin, graph, own, cells):
    """The sample nearest to ``point`` [m] that is of another part than ``own``, -1 where none is within reach."""
    start, member, low, size = cells
    found, nearest = np.int32(-1), REACH_M * REACH_M
    # The nearest of eight cells, a reach away at most, lie in this and the next one along every axis.
    x = int(np.floor((point[0] - low[0]) * PER_CELL - 0.5))
    y = int(np.floor((point[1] - low[1]) * PER_CELL - 0.5))
    z = int(np.floor((point[2] - low[2]) * PER_CELL - 0.5))
    for i in range(max(x, 0), min(x + 2, size[0])):
        for j in range(max(y, 0), min(y + 2, size[1])):
            row = (i * size[1] + j) * size[2]
            first, last = max(z, 0), min(z + 2, size[2])
            if first >= last:
                continue
            for entry in range(start[row + first], start[row + last]):
                s = member[entry]
                square = _square(point, skin, s)
                if square < nearest and _is_other(skin, graph, own, s):
                    found, nearest = s, square
    return found


@kernel
def _put_late(x, lanes, skin, graph, planes):
    """Writes the planes of other parts below the vertices of ``lanes``."""
    foot, unit = _plane(points_at(x, lanes.vertex, 0), lanes, skin, graph)
    put3(lanes.scratch, FOOT, foot)
    put3(lanes.scratch, UNIT, unit)
    for lane in range(LANES):
        v = lanes.vertex[lane]
        place = PLANES * (v // LANES) + 6 * LANES + v % LANES
        for row in range(6):
            planes[place + LANES * row] = lanes.scratch[FOOT + LANES * row + lane]


@kernel
def _plane(points, lanes, skin, graph):
    """Foot and normal of the planes below ``points``, of the samples of ``lanes`` and their neighbours."""
    own, near = lanes.sample, lanes.near
    _look_around(own, graph.neighbour, near)
    kind = skin.dtype.type
    zero, half, one = kind(0), kind(0.5), kind(1)
    for lane in range(LANES):
        lanes.scratch[lane] = graph.reach_m2[own[lane]]
    per_m2 = one / row_at(lanes.scratch, 0)
    x, y, z, _ = samples_at(skin, own, 0)
    a, b, c, product = normals_at(skin, own, 0)
    where, normal, total = (x, y, z), (a, b, c), zero * x + one
    own_square = _squares(points, skin, own, 0)
    for n in range(NEIGHBOURS):
        x, y, z, _ = samples_at(skin, near, LANES * n)
        a, b, c, across = normals_at(skin, near, LANES * n)
        way = sub((x, y, z), points)
        share = most(one - (dot(way, way) - own_square) * per_m2, zero)
        share = least(share, one)
        weight = where_other(near, LANES * n, own, 0, share * share)  # a sample may be its own neighbour
        total, product = total + weight, product + weight * across
        where, normal = add(where, scaled(weight, (x, y, z))), add(normal, scaled(weight, (a, b, c)))
    per, square = one / total, dot(normal, normal)
    unit = scaled(one / root(where_above(square, zero, square, one)), normal)
    by_samples = (dot(points, normal) - product) * per
    by_blend = dot(unit, sub(points, scaled(per, where)))
    return sub(points, scaled(half * (by_samples + by_blend), unit)), unit
