"""Sweeps of vertex block descent over a ``Sheet``, compiled; the sums of ``drape.solver.descent``, a block at a time.

What a block's vertices need is gathered into a flat scratch, rows of ``LANES`` numbers, and loops over the lanes run
along it: distances between rows are literals, so that the compiler knows that they do not overlap and takes vectors.
"""

from __future__ import annotations

import numpy as np

from drape.folds.sheet import LANES
from drape.solver.compiled import kernel, part
from drape.solver.elements import (
    add,
    angle_gradient,
    at,
    dot,
    fold,
    fold_gradient,
    mix,
    outer,
    scaled,
    solved,
    sub,
)

# Rows of the scratch: the vertex, its gradient, its Hessian, two other corners.
OWN, GRADIENT, HESSIAN, OTHERS = 0, 3 * LANES, 6 * LANES, 12 * LANES
SCRATCH = 18 * LANES
# Per block: point and normal, of the own part of the body and of another one; how stiff and with how much slack the
# network's place holds; where the skin has taken the vertex, and friction times contact's stiffness.
PLANES = 18 * LANES
HELD_ROW, SLACK_ROW, CARRIED, FRICTION_ROW = 12 * LANES, 13 * LANES, 14 * LANES, 17 * LANES
SLIP_M = 1e-3  # friction is a spring up to here, and slips farther with the force it has then
HOLD = 0.4  # of contact's stiffness: what steps of the whole know of leash and friction, and take of them at most


@kernel
def row3(s, start, lane):
    """The vector that stands in three rows from ``start`` on."""
    return s[start + lane], s[start + LANES + lane], s[start + 2 * LANES + lane]


@part
def _put3(s, start, lane, a):
    s[start + lane], s[start + LANES + lane], s[start + 2 * LANES + lane] = a[0], a[1], a[2]


@kernel
def _row6(s, start, lane):
    a, b = row3(s, start, lane), row3(s, start + 3 * LANES, lane)
    return a[0], a[1], a[2], b[0], b[1], b[2]


@part
def _put6(s, start, lane, h):
    _put3(s, start, lane, (h[0], h[1], h[2]))
    _put3(s, start + 3 * LANES, lane, (h[3], h[4], h[5]))


@kernel
def descend(x, sheet, planes, band, scratch):
    """One sweep over ``x`` [m] (P, 3), in place: every vertex to the minimum of its own quadratic model.

    ``planes`` flat, eighteen rows a block: points [m] and normals of two tangent planes of the body at each place, the
    stiffness [N/m] and slack [m] with which it is held at ``band`` [m] (P, 3), and of ``stick``.
    """
    k = sheet.constants
    for block in range(len(sheet.fan_start) - 1):
        _model(x, block, sheet, planes, band, scratch, True)
        for lane in range(LANES):
            step = scaled(-k.one, solved(_row6(scratch, HESSIAN, lane), row3(scratch, GRADIENT, lane)))
            share = k.reach / np.sqrt(max(dot(step, step), k.reach * k.reach))
            v = LANES * block + lane
            x[v, 0] += share * step[0]
            x[v, 1] += share * step[1]
            x[v, 2] += share * step[2]


@kernel
def gradient_at(x, sheet, planes, band, scratch, gradient):
    """The energy's gradient [N] at ``x`` in ``gradient`` (P, 3), as a step of the whole takes it: leash and friction
    together are no stiffer than the rest's leash and ``HOLD`` of contact, two planes no stiffer than one. Stiffer than
    its matrix knows, they would throw whole parts of a garment to and fro from step to step.
    """
    for block in range(len(sheet.fan_start) - 1):
        _model(x, block, sheet, planes, band, scratch, False)
        for lane in range(LANES):
            for axis in range(3):
                gradient[LANES * block + lane, axis] = scratch[GRADIENT + LANES * axis + lane]


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
    """Gradient of the block's vertices into the scratch, where ``curvature`` their Hessian too.

    A literal: what is not asked for is not in the compiled loop.
    """
    for lane in range(LANES):
        _put3(scratch, OWN, lane, at(x, LANES * block + lane))
    _outside(block, sheet, planes, band, scratch, curvature)
    for row in range(sheet.fan_start[block], sheet.fan_start[block + 1]):
        for lane in range(LANES):
            _put3(scratch, OTHERS, lane, at(x, sheet.fan_other[2 * LANES * row + lane]))
            _put3(scratch, OTHERS + 3 * LANES, lane, at(x, sheet.fan_other[2 * LANES * row + LANES + lane]))
        _triangle(row, sheet, scratch, curvature)
    _bending(x, block, sheet, scratch)
    for entry in range(sheet.crease_start[block], sheet.crease_start[block + 1]):
        _crease(x, sheet, entry, scratch, curvature)


@part
def _outside(block, sheet, planes, band, scratch, curvature):
    """Weight, the body's planes and the waistband, as in ``drape.solver.elements.outside``, friction, and bending's
    diagonal."""
    k, own = sheet.constants, sheet.own
    least = own.dtype.type(SLIP_M * SLIP_M)
    for lane in range(LANES):
        x = row3(scratch, OWN, lane)
        place = 4 * LANES * block + lane
        normal, other = row3(planes, PLANES * block + 3 * LANES, lane), row3(planes, PLANES * block + 9 * LANES, lane)
        depth = k.gap - dot(sub(x, row3(planes, PLANES * block, lane)), normal)
        stiffness = own[place + 2 * LANES] if depth > k.zero else k.zero
        deep = k.gap - dot(sub(x, row3(planes, PLANES * block + 6 * LANES, lane)), other)
        stiff = own[place + 2 * LANES] if deep > k.zero else k.zero
        way = sub(x, at(band, LANES * block + lane))
        held, slack = planes[PLANES * block + HELD_ROW + lane], planes[PLANES * block + SLACK_ROW + lane]
        length = np.sqrt(max(dot(way, way), slack * slack))
        pull = held * (k.one - slack / length)  # stiffness times the way past the slack, per way
        lost = held * slack / length**3 if length > slack else k.zero
        slip = sub(x, row3(planes, PLANES * block + CARRIED, lane))
        slip = sub(slip, scaled(dot(slip, normal), normal))
        grip = planes[PLANES * block + FRICTION_ROW + lane] * max(depth, k.zero)
        grip = grip / np.sqrt(max(dot(slip, slip), least))
        if not curvature:
            contact = own[place + 2 * LANES]
            known = own[place + 3 * LANES] + own.dtype.type(HOLD) * contact
            less = known / max(grip + (held if length > slack else k.zero), known)
            pull, grip = less * pull, less * grip
            share = contact / max(stiffness + stiff * dot(other, other), contact)
            stiffness, stiff = share * stiffness, share * stiff
        force = add(mix(-stiffness * depth, normal, -stiff * deep, other), mix(pull, way, grip, slip))
        _put3(scratch, GRADIENT, lane, (force[0], force[1] + own[place], force[2]))
        if not curvature:
            continue
        still = k.least + own[place + LANES] + pull + grip
        hessian = (still, k.zero, k.zero, still, k.zero, still)
        hessian = outer(outer(hessian, stiffness - grip, normal), stiff, other)
        _put6(scratch, HESSIAN, lane, outer(hessian, lost, way))


@part
def _triangle(row, sheet, scratch, curvature):
    """Adds one triangle of each vertex: Gauss-Newton of Green's strain, and its stress where it pulls."""
    k = sheet.constants
    twice = k.one + k.one
    for lane in range(LANES):
        own = row3(scratch, OWN, lane)
        first = sub(row3(scratch, OTHERS, lane), own)
        second = sub(row3(scratch, OTHERS + 3 * LANES, lane), own)
        entry = 5 * LANES * row + lane
        p1, t1 = sheet.fan_slope[entry], sheet.fan_slope[entry + LANES]
        p2, t2 = sheet.fan_slope[entry + 2 * LANES], sheet.fan_slope[entry + 3 * LANES]
        area = sheet.fan_slope[entry + 4 * LANES]
        p, t = mix(p1, first, p2, second), mix(t1, first, t2, second)
        pp, tt, pt = dot(p, p) - k.one, dot(t, t) - k.one, dot(p, t)
        spp, stt, spt = area * (k.warp * pp + k.cross * tt), area * (k.cross * pp + k.weft * tt), area * k.shear * pt
        mp, mt = -p1 - p2, -t1 - t2  # slopes of the own corner
        cp, ct = mp * spp + mt * spt, mp * spt + mt * stt
        before, force = row3(scratch, GRADIENT, lane), mix(cp, p, ct, t)
        _put3(scratch, GRADIENT, lane, (before[0] + force[0], before[1] + force[1], before[2] + force[2]))
        if not curvature:
            continue
        kpp = area * (twice * k.warp * mp * mp + k.shear * mt * mt)
        ktt = area * (twice * k.weft * mt * mt + k.shear * mp * mp)
        kpt = area * (twice * k.cross + k.shear) * mp * mt
        pull = max(cp * mp + ct * mt, k.zero)
        by_p, by_t = mix(kpp, p, kpt, t), mix(kpt, p, ktt, t)
        h = _row6(scratch, HESSIAN, lane)
        h = (
            h[0] + by_p[0] * p[0] + by_t[0] * t[0] + pull,
            h[1] + by_p[0] * p[1] + by_t[0] * t[1],
            h[2] + by_p[0] * p[2] + by_t[0] * t[2],
            h[3] + by_p[1] * p[1] + by_t[1] * t[1] + pull,
            h[4] + by_p[1] * p[2] + by_t[1] * t[2],
            h[5] + by_p[2] * p[2] + by_t[2] * t[2] + pull,
        )
        _put6(scratch, HESSIAN, lane, h)


@part
def _bending(x, block, sheet, scratch):
    """Adds the force of the quadratic bending, a constant matrix whose rows sum to zero."""
    k = sheet.constants
    for lane in range(LANES):
        own = row3(scratch, OWN, lane)
        a, b, c = k.zero, k.zero, k.zero
        for row in range(sheet.bend_start[block], sheet.bend_start[block + 1]):
            value, j = sheet.bend_value[LANES * row + lane], sheet.bend_other[LANES * row + lane]
            a += value * (x[j, 0] - own[0])
            b += value * (x[j, 1] - own[1])
            c += value * (x[j, 2] - own[2])
        before = row3(scratch, GRADIENT, lane)
        _put3(scratch, GRADIENT, lane, (before[0] + a, before[1] + b, before[2] + c))


@part
def _crease(x, sheet, entry, scratch, curvature):
    """Adds one hinge of one vertex that is not flat at rest, as ``drape.solver.descent`` does."""
    k, creases = sheet.constants, sheet.creases
    lane, h, place = sheet.crease_lane[entry], sheet.crease_member[entry] // 4, sheet.crease_member[entry] % 4
    corner, cosine, sine, stiffness = creases.corner[h], creases.cosine[h], creases.sine[h], creases.stiffness[h]
    points = (at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3]))
    _, vectors, scalars = fold(points, cosine, sine, k)
    force, turn = fold_gradient(vectors, scalars, cosine, sine, k)[place], angle_gradient(vectors, k)[place]
    before = row3(scratch, GRADIENT, lane)
    _put3(scratch, GRADIENT, lane, mix(k.one, before, stiffness, force))
    if curvature:
        _put6(scratch, HESSIAN, lane, outer(_row6(scratch, HESSIAN, lane), stiffness, turn))
