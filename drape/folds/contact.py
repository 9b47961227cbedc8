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

Walks and planes are computed for ``LANES`` vertices at once, as sweeps are: what they need of the samples is gathered
into rows of a scratch, and loops over the lanes run along these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.folds.sheet import LANES
from drape.folds.sweeps import PLANES, SLIP_M, row3
from drape.push.samples import FACING, Samples
from drape.solver.compiled import kernel, part
from drape.solver.elements import at, cross, dot, scaled, sub

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


# Rows of the scratch, of ``LANES`` numbers each: a point, a sample or neighbour, its normal, normal times point, and
# whether it is one; the least square of a distance, which neighbour has a lesser one; sums over sample and neighbours
# of weights, points, normals and normals times points; one over the spacing squared.
POINT, SAMPLE, NORMAL, ACROSS, REAL = 0, 3 * LANES, 6 * LANES, 9 * LANES, 10 * LANES
SQUARE, NEARER, TOTAL, WHERE, SUM, PRODUCT, PER_M2 = (row * LANES for row in (11, 12, 13, 14, 17, 20, 21))
SCRATCH = 22 * LANES


class Lanes(NamedTuple):
    """A place, ``vertex``, and a ``sample`` of the skin in each lane (``LANES``,)."""

    vertex: np.ndarray
    sample: np.ndarray


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    vertex, own, scratch = np.empty(LANES, np.int32), np.empty(LANES, np.int32), np.empty(SCRATCH, skin.dtype)
    for block in range(len(network) // LANES):
        for lane in range(LANES):
            vertex[lane], own[lane] = LANES * block + lane, touched.own[LANES * block + lane]
        _walk(network, vertex, skin, graph.neighbour, own, len(skin), scratch)
        for lane in range(LANES):
            touched.own[vertex[lane]] = own[lane]


@kernel
def carried(grip, touched, skin, graph, found):
    """Where the posed ``skin`` has taken what lies ``grip`` [m] (P, 3) in the frames of the samples ``touched.own``:
    ``found`` [m] (P, 3)."""
    for v in range(len(grip)):
        own = touched.own[v]
        n, e, b = _skin_frame(skin, graph, own)
        found[v, 0] = skin[own, 0] + grip[v, 0] * n[0] + grip[v, 1] * e[0] + grip[v, 2] * b[0]
        found[v, 1] = skin[own, 1] + grip[v, 0] * n[1] + grip[v, 1] * e[1] + grip[v, 2] * b[1]
        found[v, 2] = skin[own, 2] + grip[v, 0] * n[2] + grip[v, 1] * e[2] + grip[v, 2] * b[2]


@kernel
def gripped(x, stuck, touched, skin, graph, grip):
    """Writes how what is ``stuck`` [m] (P, 3) to the posed ``skin`` lies in the frames of its samples ``touched.own``,
    having come along below ``x`` [m] (P, 3), that it is never farther from than ``SLIP_M``."""
    most = x.dtype.type(SLIP_M)
    for v in range(len(x)):
        own = touched.own[v]
        n, e, b = _skin_frame(skin, graph, own)
        slip = sub(at(x, v), at(stuck, v))
        slip = sub(slip, scaled(dot(slip, n), n))
        square = dot(slip, slip)
        share = most / np.sqrt(square) if square > most * most else x.dtype.type(1)
        off = sub(sub(at(x, v), scaled(share, slip)), at(skin, own))
        grip[v, 0], grip[v, 1], grip[v, 2] = dot(off, n), dot(off, e), dot(off, b)


@kernel
def _skin_frame(skin, graph, own):
    """The normal of a sample, the way to its first neighbour laid into the plane, and their product.

    A sample without neighbours has the normal only: what lies on it is carried along the normal alone.
    """
    n = (skin[own, 4], skin[own, 5], skin[own, 6])
    way = sub(at(skin, graph.neighbour[own, 0]), at(skin, own))
    e = sub(way, scaled(dot(way, n), n))
    square = dot(e, e)
    if square > 0.0:
        e = scaled(skin.dtype.type(1) / np.sqrt(square), e)
    return n, e, cross(n, e)


@kernel
def touch(x, skin, graph, sheet, touched, turn, planes):
    """Moves ``touched.other`` on to what is near ``x`` [m] (P, 3), and writes the ``planes``.

    ``skin`` (S, 8): rows of ``drape.push.samples.sample_table``. Other parts are looked up for vertices whose number is
    ``turn`` modulo ``TURNS``, for all where it is negative. ``planes`` flat, the first twelve rows of each block: the
    foot of x and the normal of the own part, and of the other one, with a normal of zero where none is near.
    """
    k = sheet.constants
    cells = cells_of(skin, PER_CELL)
    vertex, own, scratch = np.empty(LANES, np.int32), np.empty(LANES, np.int32), np.empty(SCRATCH, skin.dtype)
    # Few vertices are near another part: their planes wait until there are as many as lanes.
    late, late_other, waiting = np.empty(LANES, np.int32), np.empty(LANES, np.int32), 0
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            vertex[lane], own[lane] = LANES * block + lane, touched.own[LANES * block + lane]
        _walk(x, vertex, skin, graph.neighbour, own, STEPS, scratch)
        _put_planes(x, Lanes(vertex, own), skin, graph, scratch, planes, 0)
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
                late[waiting], late_other[waiting] = v, other
                waiting += 1
            if waiting == LANES:
                _put_planes(x, Lanes(late, late_other), skin, graph, scratch, planes, 6 * LANES)
                waiting = 0
    if waiting > 0:
        for lane in range(waiting, LANES):
            late[lane], late_other[lane] = late[0], late_other[0]
        _put_planes(x, Lanes(late, late_other), skin, graph, scratch, planes, 6 * LANES)


@kernel
def _walk(x, vertex, skin, neighbour, own, steps, s):
    """``_nearest`` for the ``vertex`` of every lane, with samples ``own`` moved in place."""
    kind = skin.dtype.type
    _gather(x, vertex, skin, own, s)
    for _ in range(steps):
        for lane in range(LANES):
            s[NEARER + lane] = kind(-1)
        for n in range(NEIGHBOURS):
            for lane in range(LANES):
                j = neighbour[own[lane], n]
                for axis in range(3):
                    s[SAMPLE + axis * LANES + lane] = skin[j, axis]
            for lane in range(LANES):
                way = sub(row3(s, SAMPLE, lane), row3(s, POINT, lane))
                square = dot(way, way)
                less = square < s[SQUARE + lane]
                s[SQUARE + lane] = square if less else s[SQUARE + lane]
                s[NEARER + lane] = kind(n) if less else s[NEARER + lane]
        moved = False
        for lane in range(LANES):
            if s[NEARER + lane] >= 0.0:
                own[lane], moved = neighbour[own[lane], int(s[NEARER + lane])], True
        if not moved:
            break


@part
def _gather(x, vertex, skin, own, s):
    """Writes points, samples and the squares of their distances into the scratch."""
    for lane in range(LANES):
        for axis in range(3):
            s[POINT + axis * LANES + lane] = x[vertex[lane], axis]
            s[SAMPLE + axis * LANES + lane] = skin[own[lane], axis]
    for lane in range(LANES):
        way = sub(row3(s, SAMPLE, lane), row3(s, POINT, lane))
        s[SQUARE + lane] = dot(way, way)


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
def _put_planes(x, lanes, skin, graph, s, planes, row):
    """The planes below the vertices of ``lanes``, of their samples and the neighbours, from ``row`` on."""
    vertex, own = lanes.vertex, lanes.sample
    zero, half, one = x.dtype.type(0), x.dtype.type(0.5), x.dtype.type(1)
    _gather(x, vertex, skin, own, s)
    for lane in range(LANES):
        s[PER_M2 + lane], s[TOTAL + lane], s[PRODUCT + lane] = (
            one / graph.reach_m2[own[lane]],
            one,
            skin[own[lane], 7],
        )
        for axis in range(3):
            s[WHERE + axis * LANES + lane] = skin[own[lane], axis]
            s[SUM + axis * LANES + lane] = skin[own[lane], 4 + axis]
    for n in range(NEIGHBOURS):
        for lane in range(LANES):
            j = graph.neighbour[own[lane], n]
            for axis in range(3):
                s[SAMPLE + axis * LANES + lane] = skin[j, axis]
                s[NORMAL + axis * LANES + lane] = skin[j, 4 + axis]
            s[ACROSS + lane] = skin[j, 7]
            s[REAL + lane] = one if j != own[lane] else zero
        for lane in range(LANES):
            way = sub(row3(s, SAMPLE, lane), row3(s, POINT, lane))
            share = one - (dot(way, way) - s[SQUARE + lane]) * s[PER_M2 + lane]
            share = share if share > zero else zero
            share = share if share < one else one
            w = share * share * s[REAL + lane]
            s[TOTAL + lane] += w
            s[PRODUCT + lane] += w * s[ACROSS + lane]
            for axis in range(3):
                s[WHERE + axis * LANES + lane] += w * s[SAMPLE + axis * LANES + lane]
                s[SUM + axis * LANES + lane] += w * s[NORMAL + axis * LANES + lane]
    for lane in range(LANES):
        point, normal, per = row3(s, POINT, lane), row3(s, SUM, lane), one / s[TOTAL + lane]
        square = dot(normal, normal)
        unit = scaled(one / np.sqrt(square) if square > zero else one, normal)
        by_samples = (dot(point, normal) - s[PRODUCT + lane]) * per
        by_blend = dot(unit, sub(point, scaled(per, row3(s, WHERE, lane))))
        foot = sub(point, scaled(half * (by_samples + by_blend), unit))
        place = PLANES * (vertex[lane] // LANES) + vertex[lane] % LANES + row
        for axis in range(3):
            planes[place + LANES * axis] = foot[axis]
            planes[place + LANES * (3 + axis)] = unit[axis]
