"""Sweeps of vertex block descent over a ``Sheet``, compiled, a block at a time.

A block's vertices are the lanes of rows (``drape.kernels.lanes``), so that one formula says what all of them do. Only
what few vertices have, and is added lane by lane, goes through a flat scratch of rows.
"""

from __future__ import annotations

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, angle_gradient, at, dot, fold, fold_gradient, mix, outer, scaled, solved, sub
from drape.kernels.lanes import most, points_at, points_in, put3, put_points, root, row_at, rows3_at, where_above
from drape.live.sheet import LANES

GRADIENT, HESSIAN, SCRATCH = 0, 3 * LANES, 9 * LANES  # rows of the scratch
# Per block: point and normal, of the own part of the body and of another one; how stiff and with how much slack the
# network's place holds; where the skin has taken the vertex, and friction times contact's stiffness.
PLANES = 18 * LANES
HELD_ROW, SLACK_ROW, CARRIED, FRICTION_ROW = 12 * LANES, 13 * LANES, 14 * LANES, 17 * LANES
SLIP_M = 1e-3  # friction is a spring up to here, and slips farther with the force it has then
HOLD = 0.4  # of contact's stiffness: what steps of the whole know of leash and friction, and take of them at most


@kernel
def _lane3(s, start, lane):
    """The vector that one lane has in three rows from ``start`` on."""
    return s[start + lane], s[start + LANES + lane], s[start + 2 * LANES + lane]


@part
def _put_lane3(s, start, lane, a):
    s[start + lane], s[start + LANES + lane], s[start + 2 * LANES + lane] = a[0], a[1], a[2]


@kernel
def descend(x, sheet, planes, band, scratch):
    """One sweep over ``x`` [m] (P, 3), in place: every vertex to the minimum of its own quadratic model.

    ``planes`` flat, eighteen rows a block: points [m] and normals of two tangent planes of the body at each place, the
    stiffness [N/m] and slack [m] with which it is held at ``band`` [m] (P, 3), and of ``stick``.
    """
    k = sheet.constants
    for block in range(len(sheet.fan_start) - 1):
        gradient, hessian = _model(x, block, sheet, planes, band, scratch, True)
        step = solved(hessian, gradient)
        share = k.reach / root(most(dot(step, step), k.reach * k.reach))
        put_points(x, LANES * block, sub(points_in(x, LANES * block), scaled(share, step)))


@kernel
def gradient_at(x, sheet, planes, band, scratch, gradient):
    """The energy's gradient [N] at ``x`` in ``gradient`` (P, 3), as a step of the whole takes it: leash and friction
    together are no stiffer than the rest's leash and ``HOLD`` of contact, two planes no stiffer than one. Stiffer than
    its matrix knows, they would throw whole parts of a garment to and fro from step to step.
    """
    for block in range(len(sheet.fan_start) - 1):
        put_points(gradient, LANES * block, _model(x, block, sheet, planes, band, scratch, False)[0])


@kernel
def leash(sheet, planes):
    """Writes stiffness and slack of what holds each place: the waistband's and the leash's."""
    for block in range(len(sheet.fan_start) - 1):
        for lane in range(LANES):
            planes[PLANES * block + HELD_ROW + lane] = sheet.own[4 * LANES * block + 3 * LANES + lane]
            planes[PLANES * block + SLACK_ROW + lane] = sheet.constants.slack


@kernel
def stick(sheet, carried, friction, planes):
    """Writes where the skin has ``carried`` [m] (P, 3) each place, and its ``friction`` with it."""
    for block in range(len(sheet.fan_start) - 1):
        for lane in range(LANES):
            for axis in range(3):
                planes[PLANES * block + CARRIED + LANES * axis + lane] = carried[LANES * block + lane, axis]
            contact = sheet.own[4 * LANES * block + 2 * LANES + lane]
            planes[PLANES * block + FRICTION_ROW + lane] = friction * contact


@part
def _model(x, block, sheet, planes, band, scratch, curvature):
    """Gradient of the block's vertices, where ``curvature`` their Hessian too, else what is no matter.

    A literal: what is not asked for is not in the compiled loop.
    """
    own = points_in(x, LANES * block)
    gradient, hessian = _outside(own, block, sheet, planes, band, curvature)
    for row in range(sheet.fan_start[block], sheet.fan_start[block + 1]):
        first = sub(points_at(x, sheet.fan_other, 2 * LANES * row), own)
        second = sub(points_at(x, sheet.fan_other, 2 * LANES * row + LANES), own)
        gradient, hessian = _triangle(first, second, row, sheet, gradient, hessian, curvature)
    for row in range(sheet.bend_start[block], sheet.bend_start[block + 1]):
        # The quadratic bending, a constant matrix whose rows sum to zero.
        way = sub(points_at(x, sheet.bend_other, LANES * row), own)
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
def _outside(x, block, sheet, planes, band, curvature):
    """Weight, the body's planes and the waistband, as in ``drape.kernels.elements.outside``, friction, and bending's
    diagonal, of the points ``x``: their gradient and Hessian."""
    k, own, place = sheet.constants, 4 * LANES * block, PLANES * block
    least = sheet.own.dtype.type(SLIP_M * SLIP_M)
    contact, leash = row_at(sheet.own, own + 2 * LANES), row_at(sheet.own, own + 3 * LANES)
    normal, other = rows3_at(planes, place + 3 * LANES), rows3_at(planes, place + 9 * LANES)
    depth = k.gap - dot(sub(x, rows3_at(planes, place)), normal)
    stiffness = where_above(depth, k.zero, contact, k.zero)
    deep = k.gap - dot(sub(x, rows3_at(planes, place + 6 * LANES)), other)
    stiff = where_above(deep, k.zero, contact, k.zero)
    way = sub(x, points_in(band, LANES * block))
    held, slack = row_at(planes, place + HELD_ROW), row_at(planes, place + SLACK_ROW)
    length = root(most(dot(way, way), slack * slack))
    pull = held * (k.one - slack / length)  # stiffness times the way past the slack, per way
    slip = sub(x, rows3_at(planes, place + CARRIED))
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
    """``gradient`` and Hessian ``h`` with one triangle of each vertex, of edges ``first`` and ``second``: Gauss-Newton
    of Green's strain, and its stress where it pulls."""
    k, entry = sheet.constants, 5 * LANES * row
    twice = k.one + k.one
    p1, t1 = row_at(sheet.fan_slope, entry), row_at(sheet.fan_slope, entry + LANES)
    p2, t2 = row_at(sheet.fan_slope, entry + 2 * LANES), row_at(sheet.fan_slope, entry + 3 * LANES)
    area = row_at(sheet.fan_slope, entry + 4 * LANES)
    p, t = mix(p1, first, p2, second), mix(t1, first, t2, second)
    pp, tt, pt = dot(p, p) - k.one, dot(t, t) - k.one, dot(p, t)
    spp, stt, spt = area * (k.warp * pp + k.cross * tt), area * (k.cross * pp + k.weft * tt), area * k.shear * pt
    mp, mt = -p1 - p2, -t1 - t2  # slopes of the own corner
    cp, ct = mp * spp + mt * spt, mp * spt + mt * stt
    gradient = add(gradient, mix(cp, p, ct, t))
    if curvature:
        kpp = area * (twice * k.warp * mp * mp + k.shear * mt * mt)
        ktt = area * (twice * k.weft * mt * mt + k.shear * mp * mp)
        kpt = area * (twice * k.cross + k.shear) * mp * mt
        pull = most(cp * mp + ct * mt, k.zero)
        by_p, by_t = mix(kpp, p, kpt, t), mix(kpt, p, ktt, t)
        h = (
            h[0] + by_p[0] * p[0] + by_t[0] * t[0] + pull,
            h[1] + by_p[0] * p[1] + by_t[0] * t[1],
            h[2] + by_p[0] * p[2] + by_t[0] * t[2],
            h[3] + by_p[1] * p[1] + by_t[1] * t[1] + pull,
            h[4] + by_p[1] * p[2] + by_t[1] * t[2],
            h[5] + by_p[2] * p[2] + by_t[2] * t[2] + pull,
        )
    return gradient, h


@part
def _crease(x, sheet, entry, scratch, curvature):
    """Adds one hinge of one vertex that is not flat at rest, as ``benchmarks.judge.descent`` does."""
    k, creases = sheet.constants, sheet.creases
    lane, h, place = sheet.crease_lane[entry], sheet.crease_member[entry] // 4, sheet.crease_member[entry] % 4
    corner, cosine, sine, stiffness = creases.corner[h], creases.cosine[h], creases.sine[h], creases.stiffness[h]
    points = (at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3]))
    _, vectors, scalars = fold(points, cosine, sine, k)
    force, turn = fold_gradient(vectors, scalars, cosine, sine, k)[place], angle_gradient(vectors, k)[place]
    _put_lane3(scratch, GRADIENT, lane, mix(k.one, _lane3(scratch, GRADIENT, lane), stiffness, force))
    if curvature:
        a, b = _lane3(scratch, HESSIAN, lane), _lane3(scratch, HESSIAN + 3 * LANES, lane)
        a, b = outer(a + b, stiffness, turn)[:3], outer(a + b, stiffness, turn)[3:]
        _put_lane3(scratch, HESSIAN, lane, a)
        _put_lane3(scratch, HESSIAN + 3 * LANES, lane, b)
