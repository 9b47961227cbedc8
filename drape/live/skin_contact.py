"""Contact with the posed skin: for every vertex a tangent plane of its own part of the body, and of another part.

*Own part.* A walk (``skin_walks``) leads from the sample that the network's vertex had to the one that it has now, and
the folded vertex goes a few steps from there; a fold that once crossed an arm would otherwise stay on the far side.
About a heel or an armpit a walk ends where no neighbour is nearer though others are. When the grid shows a nearer
sample of the same part, the next walk starts there.

*Another part.* A grid over the samples finds what else is near, the trunk near a sleeve or a thigh near a belly, for a
quarter of the vertices in each frame; in between the other ones walk. A sample counts where it is far from the own one
at rest. A nearer one counts where the skin is hollow between the two: it then lies above the tangent plane of the own
sample, as no sample of the same limb does.

*Planes.* One tangent plane for all that lies nearest to a sample would give limbs facets. The plane of a sample s is
blended with those of its neighbours n, with weights that end at the samples' spacing r,

    w_n = clip(1 - (|x - b_n|^2 - |x - b_s|^2) / r^2, 0, 1)^2,   d(x) = 1/2 sum w_n (n_n + n) . (x - b_n),

n the blended normal of unit length and sum w = 1. Over a sphere the tangent plane of one sample is off by what the
surface falls away from it. A chord is at right angles to the mean of the normals at its ends: along this mean the
distance has no ripple. A plane ends at the side of its sample: beside a heel it would cut through free air. Where x is
more than ``BESIDE`` times r^2 to the side of s, the plane sinks below x.

Walks and planes are computed for ``LANES`` vertices at a time; P is a multiple of that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
    put3,
    put_points,
    root,
    row_at,
    samples_at,
    where_above,
    where_other,
)
from drape.live.sheet import LANES
from drape.live.skin_walks import NEIGHBOURS, look_around, square_to, squares, walk, walk_lanes, walked
from drape.live.surface_frames import to_frame, to_world
from drape.live.sweeps import APART_ROW, HELD_ROW, OTHER_PLANE, PLANES, SLIP_M

STEPS = 3  # of a walk from the network's sample to the fold's: too few to reach the far side of an arm
REACH_M = 0.03  # how near another part must come: no vertex is deeper in one than that
PER_CELL = 1.0 / (2.0 * REACH_M)
TURNS = 4  # frames until every vertex has looked for other parts
NEARER = 0.8  # of the squared distance to the own sample: one of the same part that is so near takes its place
# Squared ways to the side of the sample, times r^2, between which a plane ends. One vertex of a thousand that touch is
# more than 1.4 beside its nearest sample.
BESIDE, FREE = 1.5, 2.5
HOLLOW_M, APART_M = 0.05, 0.12  # distance at rest from which skin may be hollow in between, and is another part

# Rows of the scratch: a foot and the normal there.
FOOT, UNIT = 0, 3 * LANES


class ParentSamples(NamedTuple):
    """The samples ``own`` (C,) of coarse places, of their own part or another one, and that one of these, ``parent``
    (P,), which each place goes with."""

    own: np.ndarray
    parent: np.ndarray


@kernel
def stuck_places(grip, touched, skin, graph, stuck):
    """Writes where the posed ``skin`` has taken what sticks to it to ``stuck`` [m] (P, 3).

    ``grip`` [m] (P, 3) has the places in the frames of the samples ``touched.own``.
    """
    lanes = walk_lanes(skin)
    for block in range(len(grip) // LANES):
        place = LANES * block
        own, frame = _skin_frames(skin, graph, touched, place, lanes)
        put_points(stuck, place, add(own, to_world(frame, points_in(grip, place))))


@kernel
def write_grip(x, stuck, touched, skin, graph, grip):
    """Writes the places that ``stuck`` [m] (P, 3) has after ``x`` [m] (P, 3) has moved to ``grip``, in the frames of
    the samples ``touched.own``. A place comes along below x, and is left behind by no more than ``SLIP_M``."""
    one, most_m, lanes = x.dtype.type(1), x.dtype.type(SLIP_M), walk_lanes(skin)
    for block in range(len(x) // LANES):
        place = LANES * block
        own, frame = _skin_frames(skin, graph, touched, place, lanes)
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
    lanes, late, waiting = walk_lanes(skin), walk_lanes(skin), 0
    own = lanes.sample
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            own[lane] = touched.own[LANES * block + lane]
        points = points_in(x, LANES * block)
        walk(points, lanes, skin, graph.neighbour, STEPS)
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
                other, same = _near_samples(at(x, v), skin, graph, own[lane], grid, laid)
                if same != own[lane]:
                    touched.own[v] = same
            elif other >= 0:
                other = walked(at(x, v), skin, graph, other, STEPS)
                far = square_to(at(x, v), skin, other) >= REACH_M * REACH_M
                if far or not _is_other(skin, graph, own[lane], other):
                    other = np.int32(-1)
            touched.other[v] = other
            if other >= 0:
                late.vertex[waiting], late.sample[waiting] = v, other
                waiting += 1
            if waiting == LANES:
                _put_late(x, late, skin, graph, planes)
                waiting = 0
    _put_rest(x, late, waiting, skin, graph, planes)


@kernel
def put_own_planes(x, skin, graph, touched, planes):
    """Writes the planes below ``x`` [m] (P, 3), one step on from the samples ``touched.own`` (C,) of what each place
    has in ``touched.parent`` (P,)."""
    lanes = walk_lanes(skin)
    for block in range(len(x) // LANES):
        foot, unit = own_plane(points_in(x, LANES * block), LANES * block, touched, lanes, skin, graph)
        put3(planes, PLANES * block, foot)
        put3(planes, PLANES * block + 3 * LANES, unit)


@part
def own_plane(points, place, touched, lanes, skin, graph):
    """Foot and normal of the planes of ``put_own_planes`` below ``points``, a block from ``place`` on."""
    for lane in range(LANES):
        lanes.sample[lane] = touched.own[touched.parent[place + lane]]
    walk(points, lanes, skin, graph.neighbour, 1)
    return _plane(points, lanes, skin, graph)


@kernel
def put_other_planes(x, skin, graph, touched, planes):
    """Writes the planes below ``x`` [m] (P, 3) of other parts, as ``put_own_planes`` does; of a sample -1 none."""
    late, waiting = walk_lanes(skin), 0
    for v in range(len(x)):
        sample = touched.own[touched.parent[v]]
        if sample >= 0:
            late.vertex[waiting], late.sample[waiting] = v, sample
            waiting += 1
        if waiting == LANES:
            _put_late(x, late, skin, graph, planes)
            waiting = 0
    _put_rest(x, late, waiting, skin, graph, planes)


@part
def _is_other(skin, graph, own, sample):
    """Whether ``sample`` is of another part of the body than ``own``, or the skin is hollow in between."""
    apart = sub(at(graph.rest, sample), at(graph.rest, own))
    rest = dot(apart, apart)
    if rest > APART_M * APART_M:
        return True
    rise = dot((skin[own, 4], skin[own, 5], skin[own, 6]), sub(at(skin, sample), at(skin, own)))
    return rest > HOLLOW_M * HOLLOW_M and rise > 0.0


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
def _near_samples(point, skin, graph, own, grid, laid):
    """The sample nearest to ``point`` [m] that is of another part than ``own``, -1 where none is within reach, and the
    nearest one of the same part: ``own`` unless another is ``NEARER``. ``laid`` are the samples in the order of the
    ``grid``."""
    found, nearest, size = np.int32(-1), REACH_M * REACH_M, len(laid) // 3
    same, beside = own, min(NEARER * square_to(point, skin, own), REACH_M * REACH_M)
    reach = (REACH_M, REACH_M, REACH_M)
    first, last = cells_within(grid, sub(point, reach), add(point, reach))
    for i in range(first[0], last[0]):
        for j in range(first[1], last[1]):
            begin, end = column(grid, i, j, first, last)
            for entry in range(begin, end, LANES):
                x, y, z = row_at(laid, entry), row_at(laid, size + entry), row_at(laid, 2 * size + entry)
                way = sub((x, y, z), point)
                near = lanes_above(max(nearest, beside), dot(way, way)) & lanes_before(end - entry)
                while near:
                    s, near = grid.member[entry + first_lane(near)], near & (near - 1)
                    square = square_to(point, skin, s)
                    if not square < max(nearest, beside):
                        continue
                    if _is_other(skin, graph, own, s):
                        if square < nearest:
                            found, nearest = s, square
                    elif square < beside:
                        same, beside = s, square
    return found, same


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
def _put_rest(x, lanes, waiting, skin, graph, planes):
    """``_put_late`` of the first lanes, so many as are ``waiting``."""
    if waiting > 0:
        for lane in range(waiting, LANES):
            lanes.vertex[lane], lanes.sample[lane] = lanes.vertex[0], lanes.sample[0]
        _put_late(x, lanes, skin, graph, planes)


@part
def _plane(points, lanes, skin, graph):
    """Foot and normal of the planes below ``points``, of the samples of ``lanes`` and their neighbours."""
    own, near = lanes.sample, lanes.near
    look_around(own, graph.neighbour, near)
    kind = skin.dtype.type
    zero, half, one = kind(0), kind(0.5), kind(1)
    for lane in range(LANES):
        lanes.scratch[lane] = number_at(graph.reach_m2, own[lane])
    per_m2 = one / row_at(lanes.scratch, 0)
    x, y, z, _ = samples_at(skin, own, 0)
    a, b, c, product = normals_at(skin, own, 0)
    where, normal, total = (x, y, z), (a, b, c), zero * x + one
    own_square = squares(points, skin, own, 0)
    height = dot(normal, points) - product
    aside = (own_square - height * height) * per_m2
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
    beside = least(most((aside - kind(BESIDE)) * kind(1.0 / (FREE - BESIDE)), zero), one)
    distance = (one - beside) * half * (by_samples + by_blend) + beside * kind(REACH_M)
    return sub(points, scaled(distance, unit)), unit
