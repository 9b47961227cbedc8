"""The equations of a swing mesh, compiled.

*Falling back.* Every column of hanging cloth is a string. With T the weight below, s the way down and u how far the
nodes are from where still cloth would be,

    m (u - u') / h^2 + K u = 0,   u K u = sum of A T |du/ds|^2,

u' where inertia leads. The rows of K are ``pull`` of the mesh.

*Length.* Cloth does not stretch, and it keeps its area. With G Green's strain of a coarse triangle, G0 that of the
still cloth, and ( )+ and ( )- the parts of a matrix that have its positive and its negative principal values, the
energy per area is

    Y/2 |(G - G0+)+|^2 + q Y/2 |(G - G0-)-|^2,   q = ``COMPRESSED``.

Between still cloth, whose folds are finer than the mesh, and flat cloth a triangle is free (tension field theory).
Where it became shorter than it is in still cloth, folds would have to hide what it lacks, and they are too fine for
that. Y is the cloth's stiffness, but no more than a few sweeps can follow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, at, columns, dot, mix, outer, scaled, shifted, solved, sub

STIFFEST_N_PER_M = 300.0
CONTACT_J_M4 = 3.0e4  # a tenth of the folds': half a spacing of skin is behind a node
GAP_M = 0.004
TOUCH_M = 0.06  # a sample farther away says nothing of the skin below a node
REACH_M = 0.01  # a sweep moves no node farther
SOLVED, LEAST = 1e-20, 1e-30  # a residual's square is small enough as a share of the first one, or by itself [N m]
COMPRESSED = 0.2
LOOSE = 0.05  # a loose triangle resists a step with this share of the stiffness of one that pulls


@kernel
def fall_back(u, mesh, inertia, hold, rhs, rounds):
    """Moves ``u`` [m] (N, 3) towards the solution of (inertia + hold + K) u = ``rhs`` [N] over the nodes that may move.

    By ``rounds`` of conjugate gradients, in place; ``inertia``, ``hold`` [N/m] (N,).
    """
    zero = u.dtype.type(0)
    r, q, p = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    diagonal = np.zeros(len(u), u.dtype)
    for n in range(len(mesh.order)):
        i = mesh.order[n]
        diagonal[i] = inertia[i] + hold[i]
        for e in range(mesh.pull_start[i], mesh.pull_start[i + 1]):
            if mesh.pull_node[e] == i:
                diagonal[i] += mesh.pull[e]
    _pulled(u, mesh, inertia, hold, q)
    old = zero
    for n in range(len(mesh.order)):
        i = mesh.order[n]
        for axis in range(3):
            r[i, axis] = rhs[i, axis] - q[i, axis]
            p[i, axis] = r[i, axis] / diagonal[i]
            old += r[i, axis] * p[i, axis]
    if old != old:
        u[:] = old  # NaN, which the caller looks for
    # Beyond what floats can tell, squares of what is left would go under.
    end = max(u.dtype.type(SOLVED) * old, u.dtype.type(LEAST))
    for _ in range(rounds):
        if not old > end:
            return
        _pulled(p, mesh, inertia, hold, q)
        down = zero
        for n in range(len(mesh.order)):
            i = mesh.order[n]
            down += p[i, 0] * q[i, 0] + p[i, 1] * q[i, 1] + p[i, 2] * q[i, 2]
        a, new = old / down, zero
        for n in range(len(mesh.order)):
            i = mesh.order[n]
            for axis in range(3):
                u[i, axis] += a * p[i, axis]
                r[i, axis] -= a * q[i, axis]
                new += r[i, axis] * r[i, axis] / diagonal[i]
        b, old = new / old, new
        for n in range(len(mesh.order)):
            i = mesh.order[n]
            for axis in range(3):
                p[i, axis] = r[i, axis] / diagonal[i] + b * p[i, axis]


@kernel
def _pulled(u, mesh, inertia, hold, out):
    for n in range(len(mesh.order)):
        i = mesh.order[n]
        s = inertia[i] + hold[i]
        total = scaled(s, at(u, i))
        for e in range(mesh.pull_start[i], mesh.pull_start[i + 1]):
            total = add(total, scaled(mesh.pull[e], at(u, mesh.pull_node[e])))
        out[i, 0], out[i, 1], out[i, 2] = total[0], total[1], total[2]


@part
def _columns(c, own, mesh, e):
    """The columns of F of the coarse triangle ``e`` whose first corner is at ``own``."""
    first, second = sub(at(c, mesh.other[e, 0]), own), sub(at(c, mesh.other[e, 1]), own)
    return columns(first, second, mesh.slope[e, 0], mesh.slope[e, 1], mesh.slope[e, 2], mesh.slope[e, 3])


@part
def _strain(p, t, one, half):
    """Green's strain (pp, tt, pt) of a triangle with the columns ``p`` and ``t`` of F."""
    return half * (dot(p, p) - one), half * (dot(t, t) - one), half * dot(p, t)


@kernel
def write_bounds(c, mesh, bound):
    """Writes G+ and G- (pp, tt, pt each) of each coarse triangle at ``c`` [m] (N, 3) to ``bound`` (n, 6)."""
    zero, one, half = c.dtype.type(0), c.dtype.type(1), c.dtype.type(0.5)
    for i in range(len(mesh.start) - 1):
        own = at(c, i)
        for e in range(mesh.start[i], mesh.start[i + 1]):
            p, t = _columns(c, own, mesh, e)
            strain = _strain(p, t, one, half)
            pulled = _above(strain[0], strain[1], strain[2], zero, half)
            bound[e, 0], bound[e, 1], bound[e, 2] = pulled[0], pulled[1], pulled[2]
            for entry in range(3):
                bound[e, 3 + entry] = strain[entry] - bound[e, entry]


@kernel
def _above(pp, tt, pt, zero, half):
    """The part (pp, tt, pt) of a symmetric matrix that has its positive principal values, and how many these are."""
    mean, radius = half * (pp + tt), np.sqrt(half * half * (pp - tt) * (pp - tt) + pt * pt)
    if mean >= radius:
        return pp, tt, pt, 2
    if mean <= -radius:
        return zero, zero, zero, 0
    upp = half + half * half * (pp - tt) / radius
    high = mean + radius
    return high * upp, high * (half + half - upp), high * half * pt / radius, 1


@part
def _along(part, mp, mt, p, t):
    """How a corner with the slopes ``mp``, ``mt`` moves the principal axis u of a strain ``part``: (m . u) F u."""
    trace = part[0] + part[1]
    upp, utt, upt = part[0] / trace, part[1] / trace, part[2] / trace
    return mix(mp * upp + mt * upt, p, mp * upt + mt * utt, t)


@kernel
def length(c, i, mesh, young, bound):
    """Gradient [N] and Hessian [N/m] (00, 01, 02, 11, 12, 22) of the length's energy by node ``i`` of ``c`` [m]."""
    zero, one, half = c.dtype.type(0), c.dtype.type(1), c.dtype.type(0.5)
    two, loose, compressed = one + one, c.dtype.type(LOOSE), c.dtype.type(COMPRESSED)
    own = at(c, i)
    g, h = (zero, zero, zero), (zero, zero, zero, zero, zero, zero)
    for e in range(mesh.start[i], mesh.start[i + 1]):
        p, t = _columns(c, own, mesh, e)
        mp, mt = -mesh.slope[e, 0] - mesh.slope[e, 1], -mesh.slope[e, 2] - mesh.slope[e, 3]
        stiff = mesh.slope[e, 4] * young
        gpp, gtt, gpt = _strain(p, t, one, half)
        high = _above(gpp - bound[e, 0], gtt - bound[e, 1], gpt - bound[e, 2], zero, half)
        full = one if high[3] == 2 else loose
        if high[3] == 1 and high[0] + high[1] > zero:
            h = outer(h, stiff * (one - full), _along(high, mp, mt, p, t))
        cp, ct = stiff * (mp * high[0] + mt * high[2]), stiff * (mp * high[2] + mt * high[1])
        g = add(g, mix(cp, p, ct, t))
        share = full * stiff
        h = outer(h, share * (mp * mp + half * mt * mt), p)
        h = outer(h, share * (mt * mt + half * mp * mp), t)
        across = half * share * mp * mt
        h = (
            h[0] + two * across * p[0] * t[0],
            h[1] + across * (p[0] * t[1] + p[1] * t[0]),
            h[2] + across * (p[0] * t[2] + p[2] * t[0]),
            h[3] + two * across * p[1] * t[1],
            h[4] + across * (p[1] * t[2] + p[2] * t[1]),
            h[5] + two * across * p[2] * t[2],
        )
        h = shifted(h, max(cp * mp + ct * mt, zero))
        low = _above(bound[e, 3] - gpp, bound[e, 4] - gtt, bound[e, 5] - gpt, zero, half)
        if low[0] + low[1] > zero:
            s = compressed * stiff
            g = add(g, mix(-s * (mp * low[0] + mt * low[2]), p, -s * (mp * low[2] + mt * low[1]), t))
            h = outer(h, s, _along(low, mp, mt, p, t))
    return g, h


class Springs(NamedTuple):
    """``target`` [m] (N, 3) pulls at each node with ``n_per_m`` (N,)."""

    target: np.ndarray
    n_per_m: np.ndarray


class Ground(NamedTuple):
    """The samples ``skin`` (S, 8), and for each node (N,) the one below ``still`` cloth, the one ``touched`` now, and
    how ``deep`` [m] below the gap still cloth is; the ``planes`` (N, 2, 4) of ``drape.live.colliders.write_planes``."""

    skin: np.ndarray
    still: np.ndarray
    touched: np.ndarray
    deep: np.ndarray
    planes: np.ndarray


@kernel
def keep_length(c, mesh, young, bound, springs, ground, turns):
    """Moves the nodes ``c`` [m] (N, 3) in place by ``turns`` sweeps there and back, each to its own quadratic
    minimum."""
    skin, planes = ground.skin, ground.planes
    zero, gap, near = c.dtype.type(0), c.dtype.type(GAP_M), c.dtype.type(TOUCH_M)
    reach = c.dtype.type(REACH_M)
    count = len(mesh.order)
    for turn in range(2 * turns):
        for n in range(count):
            i = mesh.order[n] if turn % 2 == 0 else mesh.order[count - 1 - n]
            x = at(c, i)
            g, h = length(c, i, mesh, young, bound)
            s = springs.n_per_m[i]
            g = add(g, scaled(s, sub(x, at(springs.target, i))))
            h = (h[0] + s, h[1], h[2], h[3] + s, h[4], h[5] + s)  # another call here would change last bits
            j = ground.touched[i]
            normal, off = (skin[j, 4], skin[j, 5], skin[j, 6]), sub(x, at(skin, j))
            depth = gap - ground.deep[i] - dot(off, normal)
            if depth > zero and (j == ground.still[i] or dot(off, off) < near * near):
                stiff = c.dtype.type(2.0 * CONTACT_J_M4) * mesh.area_m2[i]
                g, h = add(g, scaled(-stiff * depth, normal)), outer(h, stiff, normal)
            for m in range(2):
                normal = at(planes[i], m)
                depth = gap + planes[i, m, 3] - dot(x, normal)
                if depth > zero and dot(normal, normal) > zero:
                    stiff = c.dtype.type(2.0 * CONTACT_J_M4) * mesh.area_m2[i]
                    g, h = add(g, scaled(-stiff * depth, normal)), outer(h, stiff, normal)
            step = solved(h, g)
            share = reach / np.sqrt(max(dot(step, step), reach * reach))
            c[i, 0] -= share * step[0]
            c[i, 1] -= share * step[1]
            c[i, 2] -= share * step[2]
