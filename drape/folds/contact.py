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
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.folds.sheet import LANES
from drape.folds.sweeps import PLANES
from drape.push.samples import FACING, Samples
from drape.solver.compiled import kernel
from drape.solver.elements import at, dot, mix, scaled, sub

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


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    for v in range(len(network)):
        touched.own[v] = _nearest(at(network, v), skin, graph, touched.own[v], len(skin))


@kernel
def touch(x, skin, graph, sheet, touched, turn, planes):
    """Moves ``touched.other`` on to what is near ``x`` [m] (P, 3), and writes the ``planes``.

    ``skin`` (S, 8): rows of ``drape.push.samples.sample_table``. Other parts are looked up for vertices whose number is
    ``turn`` modulo ``TURNS``, for all where it is negative. ``planes`` flat, the first twelve rows of each block: the
    foot of x and the normal of the own part, and of the other one, with a normal of zero where none is near.
    """
    k = sheet.constants
    cells = cells_of(skin, PER_CELL)
    for v in range(len(x)):
        own = _nearest(at(x, v), skin, graph, touched.own[v], STEPS)
        place = PLANES * (v // LANES) + v % LANES
        _put_plane(at(x, v), skin, graph, k, own, planes, place)
        other = touched.other[v]
        if turn < 0 or sheet.vertex[v] % TURNS == turn:
            other = _other(at(x, v), skin, graph, own, cells)
        elif other >= 0:
            other = _nearest(at(x, v), skin, graph, other, STEPS)
            if _square(at(x, v), skin, other) >= REACH_M * REACH_M or not _is_other(skin, graph, own, other):
                other = np.int32(-1)
        touched.other[v] = other
        if other >= 0:
            _put_plane(at(x, v), skin, graph, k, other, planes, place + 6 * LANES)
        else:
            for row in range(6, 12):
                planes[place + row * LANES] = k.zero


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
def _put_plane(point, skin, graph, k, own, planes, place):
    """The plane below ``point`` [m] of the sample ``own`` and its neighbours, in six rows from ``place`` on."""
    nearest = _square(point, skin, own)
    # Sums over sample and neighbours: weights, points, normals, and normals times points.
    total, across = k.one, skin[own, 7]
    where, normal = at(skin, own), (skin[own, 4], skin[own, 5], skin[own, 6])
    for n in range(NEIGHBOURS):
        j = graph.neighbour[own, n]
        share = k.one - (_square(point, skin, j) - nearest) / graph.reach_m2[own]
        if share > k.zero and j != own:
            w = min(share, k.one) * min(share, k.one)
            total += w
            across += w * skin[j, 7]
            where = mix(k.one, where, w, at(skin, j))
            normal = mix(k.one, normal, w, (skin[j, 4], skin[j, 5], skin[j, 6]))
    by_samples = (dot(point, normal) - across) / total
    length = np.sqrt(dot(normal, normal))
    unit = scaled(k.one / length, normal) if length > k.zero else normal
    by_blend = dot(unit, sub(point, scaled(k.one / total, where)))
    foot = sub(point, scaled(k.half * (by_samples + by_blend), unit))
    for axis in range(3):
        planes[place + LANES * axis] = foot[axis]
        planes[place + LANES * (3 + axis)] = unit[axis]
