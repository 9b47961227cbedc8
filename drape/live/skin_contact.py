"""Contact with the posed skin: for every vertex a tangent plane of its own part of the body, and of another part.

*Own part.* The skin is a graph of samples. From the sample that a vertex had in the frame before it walks to the
nearest one, always on to the nearest neighbour. A frame moves a vertex by less than a few samples, so that the walk
stays on the part where the vertex was: a sleeve keeps to its arm where the arm touches the trunk. A vertex without a
past starts at the sample that is nearest at rest. The network's vertex takes this walk, and the folded one goes a few
steps from where it ends; a fold that once crossed an arm would otherwise stay on the far side.

*Another part.* A grid over the samples finds what else is near, the trunk near a sleeve or a thigh near a belly, for a
quarter of the vertices in each frame; in between the other ones walk. A sample counts where it is far from the own one
at rest. A nearer one counts where the skin is hollow between the two: it then lies above the tangent plane of the own
sample, as no sample of the same limb does.

*Planes.* One tangent plane for all that lies nearest to a sample would give limbs facets. The plane of a sample s is
blended with those of its neighbours n, with weights that end at the samples' spacing r,

    w_n = clip(1 - (|x - b_n|^2 - |x - b_s|^2) / r^2, 0, 1)^2,   d(x) = 1/2 sum w_n (n_n + n) . (x - b_n),

n the blended normal of unit length and sum w = 1. Over a sphere the tangent plane of one sample is off by what the
surface falls away from it. A chord is at right angles to the mean of the normals at its ends: along this mean the
distance has no ripple.

Walks and planes are computed for ``LANES`` vertices at a time; P is a multiple of that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.contact.samples import FACING, Samples
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, at, cross, dot, scaled, sub
from drape.kernels.grid import cells_within, column, grid_of
from drape.kernels.lane_masks import first_lane, lanes_above, lanes_before
from drape.kernels.lanes import (
    least,
    most,
    normals_at,
    number_at,
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
from drape.live.surface_frames import to_frame, to_world
from drape.live.sweeps import APART_ROW, HELD_ROW, OTHER_PLANE, PLANES, SLIP_M

NEIGHBOURS = 8
CANDIDATES = 24  # nearest samples, from which those that face another way are left out
STEPS = 3  # of a walk from the network's sample to the fold's: too few to reach the far side of an arm
REACH_M = 0.03  # how near another part must come: no vertex is deeper in one than that
PER_CELL = 1.0 / (2.0 * REACH_M)
TURNS = 4  # frames until every vertex has looked for other parts
HOLLOW_M, APART_M = 0.05, 0.12  # distance at rest from which skin may be hollow in between, and is another part


class SkinGraph(NamedTuple):
    """The samples of a skin: the ``neighbour`` samples (S, 8) of each, itself where there are fewer; ``reach_m2`` (S,),
    the square of its spacing; ``rest`` [m] (S, 3), its place at rest."""

    neighbour: np.ndarray
    reach_m2: np.ndarray
    rest: np.ndarray

    def of_type(self, dtype: type[np.floating]) -> SkinGraph:
        """The same with floats of ``dtype``."""
        return self._replace(reach_m2=self.reach_m2.astype(dtype), rest=self.rest.astype(dtype))


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


class TouchedSamples(NamedTuple):
    """The sample ``own`` (P,) that the network has each place at, and ``other`` (P,), one of another part near it or
    -1."""

    own: np.ndarray
    other: np.ndarray


class ParentSamples(NamedTuple):
    """The samples ``own`` (C,) of coarse places, and that one of these, ``parent`` (P,), which each place goes with."""

    own: np.ndarray
    parent: np.ndarray


# Rows of the scratch: which neighbour of each lane's sample is nearer than it, or a foot and the normal there.
NEARER, FOOT, UNIT, SCRATCH = 0, 0, 3 * LANES, 6 * LANES


class WalkLanes(NamedTuple):
    """``LANES`` walks at once: in each lane a place ``vertex`` and the ``sample`` (``LANES``,) that it is at, whose
    neighbours are ``near`` (8 ``LANES``,), a row each; ``scratch`` for rows of numbers."""

    vertex: np.ndarray
    sample: np.ndarray
    near: np.ndarray
    scratch: np.ndarray


@kernel
def _walk_lanes(skin):
    return WalkLanes(
        np.empty(LANES, np.int32),
        np.empty(LANES, np.int32),
        np.empty(NEIGHBOURS * LANES, np.int32),
        np.empty(SCRATCH, skin.dtype),
    )


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    lanes = _walk_lanes(skin)
    for block in range(len(network) // LANES):
        for lane in range(LANES):
            lanes.sample[lane] = touched.own[LANES * block + lane]
        _walk(points_in(network, LANES * block), lanes, skin, graph.neighbour, len(skin))
        for lane in range(LANES):
            touched.own[LANES * block + lane] = lanes.sample[lane]


@kernel
def stuck_places(grip, touched, skin, graph, stuck):
    """Writes where the posed ``skin`` has taken what sticks to it to ``stuck`` [m] (P, 3).

    ``grip`` [m] (P, 3) has the places in the frames of the samples ``touched.own``.
    """
    walk = _walk_lanes(skin)
    for block in range(len(grip) // LANES):
        place = LANES * block
        own, frame = _skin_frames(skin, graph, touched, place, walk)
        put_points(stuck, place, add(own, to_world(frame, points_in(grip, place))))


@kernel
def write_grip(x, stuck, touched, skin, graph, grip):
    """Writes the places that ``stuck`` [m] (P, 3) has after ``x`` [m] (P, 3) has moved to ``grip``, in the frames of
    the samples ``touched.own``. A place comes along below x, and is left behind by no more than ``SLIP_M``."""
    one, most_m, walk = x.dtype.type(1), x.dtype.type(SLIP_M), _walk_lanes(skin)
    for block in range(len(x) // LANES):
        place = LANES * block
        own, frame = _skin_frames(skin, graph, touched, place, walk)
        n, points = frame[0], points_in(x, place)
        slip = sub(points, points_in(stuck, place))
        slip = sub(slip, scaled(dot(slip, n), n))
        length = root(most(dot(slip, slip), most_m * most_m))
        off = sub(sub(points, scaled(where_above(length, most_m, most_m / length, one), slip)), own)
        put_points(grip, place, to_frame(frame, off))


@part
def _skin_frames(skin, graph, touched, place, lanes):
    """The samples of a block from ``place`` on, and their frames: the normal, the way to the first neighbour laid into
    the tangent plane, and the product of the two.

    A sample without neighbours has the normal only, and takes what lies on it along the normal alone.
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
    return own, (n, e, cross(n, e))


@kernel
def touch(x, skin, graph, sheet, touched, turn, planes):
    """Moves ``touched.other`` on to what is near ``x`` [m] (P, 3), and writes both tangent planes to ``planes``.

    ``skin`` (S, 8) is a ``drape.contact.samples.sample_table``. The grid is asked for the vertices whose number is
    ``turn`` modulo ``TURNS``, for all of them where ``turn`` is negative. A plane is the foot of x on it and its
    normal; where no other part is near the second normal is zero.
    """
    k = sheet.constants
    grid = grid_of(skin, PER_CELL)
    laid = _in_cells(skin, grid)
    # Few vertices are near another part: their planes wait until there are as many as lanes.
    lanes, late, waiting = _walk_lanes(skin), _walk_lanes(skin), 0
    own = lanes.sample
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            own[lane] = touched.own[LANES * block + lane]
        points = points_in(x, LANES * block)
        _walk(points, lanes, skin, graph.neighbour, STEPS)
        foot, unit = _plane(points, lanes, skin, graph)
        put3(planes, PLANES * block, foot)
        put3(planes, PLANES * block + 3 * LANES, unit)
        for entry in range(PLANES * block + OTHER_PLANE, PLANES * block + HELD_ROW):
            planes[entry] = k.zero
        for entry in range(PLANES * block + APART_ROW, PLANES * (block + 1)):
            planes[entry] = k.zero
        for lane in range(LANES):
            v = LANES * block + lane
            other = touched.other[v]
            if turn < 0 or sheet.vertex[v] % TURNS == turn:
                other = _other(at(x, v), skin, graph, own[lane], grid, laid)
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
def put_own_planes(x, skin, graph, touched, planes):
    """Writes the planes below ``x`` [m] (P, 3) of the samples ``touched.own`` (C,) of what each place has in
    ``touched.parent`` (P,), blended with their neighbours'."""
    lanes = _walk_lanes(skin)
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            lanes.sample[lane] = touched.own[touched.parent[LANES * block + lane]]
        foot, unit = _plane(points_in(x, LANES * block), lanes, skin, graph)
        put3(planes, PLANES * block, foot)
        put3(planes, PLANES * block + 3 * LANES, unit)


@part
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
                own[lane], moved = number_at(near, LANES * int(nearer[NEARER + lane]) + lane), True
        if not moved:
            break


@part
def _look_around(own, neighbour, near):
    """Writes the neighbours of the samples ``own`` (``LANES``,) to ``near``, a row each."""
    for lane in range(LANES):
        for n in range(NEIGHBOURS):
            near[LANES * n + lane] = number_at(neighbour, NEIGHBOURS * own[lane] + n)


@part
def _squares(points, skin, index, start):
    """Squares of the distances from ``points`` to the samples of a row."""
    x, y, z, _ = samples_at(skin, index, start)
    way = sub((x, y, z), points)
    return dot(way, way)


@part
def _is_other(skin, graph, own, sample):
    """Whether ``sample`` is of another part of the body than ``own``, or the skin is hollow in between."""
    apart = sub(at(graph.rest, sample), at(graph.rest, own))
    rest = dot(apart, apart)
    if rest > APART_M * APART_M:
        return True
    rise = dot((skin[own, 4], skin[own, 5], skin[own, 6]), sub(at(skin, sample), at(skin, own)))
    return rest > HOLLOW_M * HOLLOW_M and rise > 0.0


@part
def _square(point, skin, sample):
    way = sub(point, at(skin, sample))
    return dot(way, way)


@part
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
def _in_cells(skin, grid):
    """The points of the samples in the order of the ``grid``: three rows of all, each with room for ``LANES`` more."""
    size = len(skin) + LANES
    laid = np.zeros(3 * size, skin.dtype)
    for entry in range(len(grid.member) if len(grid.start) > 1 else 0):
        s = grid.member[entry]
        laid[entry], laid[size + entry], laid[2 * size + entry] = skin[s, 0], skin[s, 1], skin[s, 2]
    return laid


@part
def _other(point, skin, graph, own, grid, laid):
    """The sample nearest to ``point`` [m] that is of another part than ``own``, -1 where none is within reach; ``laid``
    are the samples in the order of the ``grid``."""
    found, nearest, size = np.int32(-1), REACH_M * REACH_M, len(laid) // 3
    reach = (REACH_M, REACH_M, REACH_M)
    first, last = cells_within(grid, sub(point, reach), add(point, reach))
    for i in range(first[0], last[0]):
        for j in range(first[1], last[1]):
            begin, end = column(grid, i, j, first, last)
            for entry in range(begin, end, LANES):
                x, y, z = row_at(laid, entry), row_at(laid, size + entry), row_at(laid, 2 * size + entry)
                way = sub((x, y, z), point)
                near = lanes_above(nearest, dot(way, way)) & lanes_before(end - entry)
                while near:
                    s, near = grid.member[entry + first_lane(near)], near & (near - 1)
                    square = _square(point, skin, s)
                    if square < nearest and _is_other(skin, graph, own, s):
                        found, nearest = s, square
    return found


@part
def _put_late(x, lanes, skin, graph, planes):
    """Writes the planes of other parts below the vertices of ``lanes``."""
    foot, unit = _plane(points_at(x, lanes.vertex, 0), lanes, skin, graph)
    put3(lanes.scratch, FOOT, foot)
    put3(lanes.scratch, UNIT, unit)
    for lane in range(LANES):
        v = lanes.vertex[lane]
        place = PLANES * (v // LANES) + OTHER_PLANE + v % LANES
        for row in range(6):
            planes[place + LANES * row] = lanes.scratch[FOOT + LANES * row + lane]


@part
def _plane(points, lanes, skin, graph):
    """Foot and normal of the planes below ``points``, of the samples of ``lanes`` and their neighbours."""
    own, near = lanes.sample, lanes.near
    _look_around(own, graph.neighbour, near)
    kind = skin.dtype.type
    zero, half, one = kind(0), kind(0.5), kind(1)
    for lane in range(LANES):
        lanes.scratch[lane] = number_at(graph.reach_m2, own[lane])
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
