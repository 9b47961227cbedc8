"""Sweeps of vertex block descent over a ``Sheet``, compiled (Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4)).

Block by block every vertex goes to the minimum of its own quadratic model,

    x -= H^-1 g,   |H^-1 g| <= k.reach,

g the gradient of the energy by the vertex, H its Hessian without the terms that could make it indefinite. The energy is
that of triangles and creases (``drape.kernels.elements``) and of quadratic bending (``drape.kernels.problem``), and for
each vertex with weight w and contact's stiffness c

    w x_y + c/2 (gap - n.(x - p))+^2 for each of two planes + held/2 (|x - b| - slack)+^2 + friction.

The first plane (p, n) is the tangent plane of the vertex's own part of the body, the second that of another part or the
one that keeps cloth apart from cloth (``room``). b is where the network has the vertex. Friction pulls back to the
place where the skin has taken the vertex, with a force of mu times that of contact, and less than ``SLIP_M`` from there
with a share of it.

A block's vertices are the lanes of rows (``drape.kernels.lanes``): one formula computes all of them. Creases, which few
vertices have, are added lane by lane in a flat scratch of rows.
"""

from __future__ import annotations

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import (
    add,
    columns,
    corner_force,
    corner_stiffness,
    dot,
    hinge_corner,
    mix,
    outer,
    scaled,
    solved,
    squares,
    sub,
)
from drape.kernels.lanes import (
    most,
    points_in,
    put,
    put3,
    put_points,
    root,
    row3,
    row_at,
    rows3_at,
    spared_at,
    where_above,
)
from drape.live.sheet import LANES, PLANE_ROWS

GRADIENT, HESSIAN, SCRATCH = 0, 3 * LANES, 9 * LANES  # rows of the scratch
# The rows of a block in ``planes``: point p and normal n of the own part and of another one; the stiffness and slack
# that hold the vertex to the network's place; where the skin has taken it, and friction times contact's stiffness; 1
# where the second plane keeps cloth apart from cloth (``room``).
OTHER_PLANE, HELD_ROW, SLACK_ROW, STUCK, FRICTION_ROW = 6 * LANES, 12 * LANES, 13 * LANES, 14 * LANES, 17 * LANES
APART_ROW = 18 * LANES
PLANES = PLANE_ROWS * LANES
SLIP_M = 1e-3  # friction is a spring up to here, and slips with the force that it has then
HOLD = 0.4  # the share of contact's stiffness that steps of the whole cloth allow leash and friction


@kernel
def descend(x, sheet, planes, network, scratch):
    """One sweep over ``x`` [m] (P, 3), in place, held by ``planes`` and to the places of the ``network`` [m] (P, 3).

    ``x`` is ``with_spare``.
    """
    k = sheet.constants
    for block in range(len(sheet.fan_start) - 1):
        gradient, hessian = _model(x, block, sheet, planes, network, scratch, True)
        step = solved(hessian, gradient)
        share = k.reach / root(most(dot(step, step), k.reach * k.reach))
        put_points(x, LANES * block, sub(points_in(x, LANES * block), scaled(share, step)))


@kernel
def gradient_at(x, sheet, planes, network, scratch, gradient):
    """Writes the gradient [N] at ``x``, ``with_spare``, that a step of the whole starts from to ``gradient`` (P, 3).

    Stiffness that the matrix of those steps does not have would throw whole parts of a garment to and fro from step to
    step. So leash and friction together count no more than the leash at rest plus ``HOLD`` of contact, and two planes
    no more than one.
    """
    for block in range(len(sheet.fan_start) - 1):
        put_points(gradient, LANES * block, _model(x, block, sheet, planes, network, scratch, False)[0])


@kernel
def leash(sheet, planes):
    """Writes the stiffness and slack that hold each place: those of the waistband and of the leash. There is no plane
    yet, and nothing is held otherwise."""
    zero = sheet.constants.zero
    for block in range(len(sheet.fan_start) - 1):
        for row in range(PLANES * block, PLANES * (block + 1), LANES):
            put(planes, row, zero)
        put(planes, PLANES * block + HELD_ROW, row_at(sheet.own, 4 * LANES * block + 3 * LANES))
        put(planes, PLANES * block + SLACK_ROW, sheet.constants.slack)


@kernel
def stick(sheet, stuck, friction, planes):
    """Writes where the skin has taken each place, ``stuck`` [m] (P, 3), and ``friction`` times contact's stiffness."""
    for block in range(len(sheet.fan_start) - 1):
        put3(planes, PLANES * block + STUCK, points_in(stuck, LANES * block))
        put(planes, PLANES * block + FRICTION_ROW, friction * row_at(sheet.own, 4 * LANES * block + 2 * LANES))


@part
def _model(x, block, sheet, planes, network, scratch, curvature):
    """The gradient of the block's vertices, and where ``curvature`` is True their Hessian.

    ``curvature`` is a literal, so that a loop which needs no Hessian is compiled without it. The second result then has
    no meaning.
    """
    own = points_in(x, LANES * block)
    gradient, hessian = _outside(own, block, sheet, planes, network, curvature)
    for row in range(sheet.fan_start[block], sheet.fan_start[block + 1]):
        first = sub(spared_at(x, sheet.fan_other, 2 * LANES * row), own)
        second = sub(spared_at(x, sheet.fan_other, 2 * LANES * row + LANES), own)
        gradient, hessian = _triangle(first, second, row, sheet, gradient, hessian, curvature)
    for row in range(sheet.bend_start[block], sheet.bend_start[block + 1]):
        # The rows of the bending matrix sum to zero.
        way = sub(spared_at(x, sheet.bend_other, LANES * row), own)
        gradient = add(gradient, scaled(row_at(sheet.bend_value, LANES * row), way))
    begin, end = sheet.crease_start[block], sheet.crease_start[block + 1]
    if begin < end:
        put3(scratch, GRADIENT, gradient)
        if curvature:
            put3(scratch, HESSIAN, hessian[:3])
            put3(scratch, HESSIAN + 3 * LANES, hessian[3:])
        for entry in range(begin, end):
            _crease(x, sheet, entry, scratch, curvature)
        gradient = rows3_at(scratch, GRADIENT)
        if curvature:
            hessian = rows3_at(scratch, HESSIAN) + rows3_at(scratch, HESSIAN + 3 * LANES)
    return gradient, hessian


@part
def _outside(x, block, sheet, planes, network, curvature):
    """Gradient and Hessian of weight, planes, leash and friction at the points ``x``, with bending's diagonal."""
    k, own, place = sheet.constants, 4 * LANES * block, PLANES * block
    least = sheet.own.dtype.type(SLIP_M * SLIP_M)
    contact, leash = row_at(sheet.own, own + 2 * LANES), row_at(sheet.own, own + 3 * LANES)
    normal, other = rows3_at(planes, place + 3 * LANES), rows3_at(planes, place + OTHER_PLANE + 3 * LANES)
    depth = k.gap - dot(sub(x, rows3_at(planes, place)), normal)
    stiffness = where_above(depth, k.zero, contact, k.zero)
    deep = k.gap - dot(sub(x, rows3_at(planes, place + OTHER_PLANE)), other)
    stiff = where_above(deep, k.zero, contact, k.zero)
    way = sub(x, points_in(network, LANES * block))
    held, slack = row_at(planes, place + HELD_ROW), row_at(planes, place + SLACK_ROW)
    length = root(most(dot(way, way), slack * slack))
    pull = held * (k.one - slack / length)  # stiffness times the way past the slack, per way
    slip = sub(x, rows3_at(planes, place + STUCK))
    slip = sub(slip, scaled(dot(slip, normal), normal))
    grip = row_at(planes, place + FRICTION_ROW) * most(depth, k.zero)
    grip = grip / root(most(dot(slip, slip), least))
    if not curvature:
        known = leash + sheet.own.dtype.type(HOLD) * contact
        less = known / most(grip + where_above(length, slack, held, k.zero), known)
        pull, grip = less * pull, less * grip
        share = contact / most(stiffness + stiff * dot(other, other), contact)
        stiffness, stiff = share * stiffness, share * stiff
    force = add(mix(-stiffness * depth, normal, -stiff * deep, other), mix(pull, way, grip, slip))
    force = (force[0], force[1] + row_at(sheet.own, own), force[2])
    still = k.least + row_at(sheet.own, own + LANES) + pull + grip
    none = k.zero * still
    hessian = outer(outer((still, none, none, still, none, still), stiffness - grip, normal), stiff, other)
    lost = where_above(length, slack, held * slack / (length * length * length), k.zero)
    return force, outer(hessian, lost, way)


@part
def _triangle(first, second, row, sheet, gradient, h, curvature):
    """``gradient`` and Hessian ``h`` with those of one triangle of each vertex, whose edges are ``first``, ``second``.

    The Hessian is Gauss-Newton of Green's strain, and the stress where it pulls.
    """
    k, entry = sheet.constants, 5 * LANES * row
    p1, t1 = row_at(sheet.fan_slope, entry), row_at(sheet.fan_slope, entry + LANES)
    p2, t2 = row_at(sheet.fan_slope, entry + 2 * LANES), row_at(sheet.fan_slope, entry + 3 * LANES)
    area = row_at(sheet.fan_slope, entry + 4 * LANES)
    p, t = columns(first, second, p1, p2, t1, t2)
    mp, mt = -p1 - p2, -t1 - t2
    cp, ct = corner_force(p, t, mp, mt, area, k)
    gradient = add(gradient, mix(cp, p, ct, t))
    if curvature:
        kpp, ktt, kpt = corner_stiffness(mp, mt, area, k)
        h = squares(h, kpp, kpt, ktt, p, t, most(cp * mp + ct * mt, k.zero))
    return gradient, h


@part
def _crease(x, sheet, entry, scratch, curvature):
    """Adds a hinge that is not flat at rest to one of its vertices."""
    k, lane = sheet.constants, sheet.crease_lane[entry]
    stiffness, force, turn = hinge_corner(x, sheet.creases, sheet.crease_member[entry], k)
    _put_lane3(scratch, GRADIENT, lane, mix(k.one, row3(scratch, GRADIENT, lane), stiffness, force))
    if curvature:
        a, b = row3(scratch, HESSIAN, lane), row3(scratch, HESSIAN + 3 * LANES, lane)
        h = outer(a + b, stiffness, turn)
        _put_lane3(scratch, HESSIAN, lane, h[:3])
        _put_lane3(scratch, HESSIAN + 3 * LANES, lane, h[3:])


@part
def _put_lane3(s, start, lane, a):
    s[start + lane], s[start + LANES + lane], s[start + 2 * LANES + lane] = a[0], a[1], a[2]
