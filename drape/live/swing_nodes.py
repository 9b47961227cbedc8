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
from drape.kernels.elements import (
    add,
    at,
    columns,
    dot,
    mix,
    outer,
    scaled,
    shifted,
    solved,
    squares,
    sub,
)
from drape.kernels.lanes import (
    LANES,
    most,
    points_at,
    points_in,
    put3,
    put_points,
    root,
    row_at,
    rows3_at,
    where_above,
)
from drape.live.swing_rows import placed

STIFFEST_N_PER_M = 300.0
CONTACT_J_M4 = 3.0e4  # a tenth of the folds': half a spacing of skin is behind a node
GAP_M = 0.004
TOUCH_M = 0.06  # a sample farther away says nothing of the skin below a node
REACH_M = 0.01  # a sweep moves no node farther
LEAST = 1e-30  # a residual's square that is small enough by itself [N m]
COMPRESSED = 0.2
LEAST_STRAIN = 1e-9  # a difference of principal strains that says nothing of their axes
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
    # Nothing is won beyond what floats can tell of the first residual, and squares of what is left would go under.
    least = np.finfo(u.dtype).eps
    end = max(least * least * old, u.dtype.type(LEAST))
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
def _slopes(rows, row):
    """The slopes (p1, p2, t1, t2) of the other corners of a ``row`` of triangles."""
    first = 5 * LANES * row
    slope = rows.slope
    return (
        row_at(slope, first),
        row_at(slope, first + LANES),
        row_at(slope, first + 2 * LANES),
        row_at(slope, first + 3 * LANES),
    )


@part
def _columns(x, own, rows, row, slopes):
    """The columns of F of a ``row`` of triangles whose first corners are at ``own``."""
    first = sub(points_at(x, rows.other, 2 * LANES * row), own)
    second = sub(points_at(x, rows.other, 2 * LANES * row + LANES), own)
    return columns(first, second, slopes[0], slopes[1], slopes[2], slopes[3])


@part
def _strain(p, t):
    """Green's strain (pp, tt, pt) of a triangle with the columns ``p`` and ``t`` of F."""
    return 0.5 * (dot(p, p) - 1.0), 0.5 * (dot(t, t) - 1.0), 0.5 * dot(p, t)


@part
def _principal(pp, tt, pt):
    """A symmetric matrix as mean of its principal values, half of their difference, and that times the cosine and the
    sine of twice the angle of the first one's axis."""
    off = 0.5 * (pp - tt)
    return 0.5 * (pp + tt), root(off * off + pt * pt), off, pt


@part
def _positive(found):
    """Mean and half difference of the principal values of the positive part of what ``_principal`` ``found``."""
    high, low = most(found[0] + found[1], 0.0), most(found[0] - found[1], 0.0)
    return 0.5 * (high + low), 0.5 * (high - low)


@kernel
def write_bounds(c, mesh, bound):
    """Writes G+ and G- (pp, tt, pt each) of the triangles of all nodes that move, which are at ``c`` [m] (N, 3), to
    ``bound``: flat, six rows for each one of ``mesh.rows``."""
    rows, x = mesh.rows, placed(c, mesh.rows)
    for block in range(rows.moving):
        own = points_in(x, LANES * block)
        for row in range(rows.start[block], rows.start[block + 1]):
            p, t = _columns(x, own, rows, row, _slopes(rows, row))
            pp, tt, pt = _strain(p, t)
            found = _principal(pp, tt, pt)
            mean, half = _positive(found)
            share = half / most(found[1], LEAST_STRAIN)
            above = mean + share * found[2], mean - share * found[2], share * pt
            put3(bound, 6 * LANES * row, above)
            put3(bound, 6 * LANES * row + 3 * LANES, sub((pp, tt, pt), above))


@part
def pull(x, block, rows, young, bound):
    """Gradient [N] and Hessian [N/m] (00, 01, 02, 11, 12, 22) of the length's energy by the nodes of a ``block``.

    The Hessian has what a triangle resists by along principal axes u that pull, (m . u)^2 F u (F u)^T, and a small
    share of the rest; m are the slopes of the node's corner.
    """
    own = points_in(x, LANES * block)
    none = 0.0 * own[0]
    g, h = (none, none, none), (none, none, none, none, none, none)
    for row in range(rows.start[block], rows.start[block + 1]):
        slopes, first = _slopes(rows, row), 6 * LANES * row
        p, t = _columns(x, own, rows, row, slopes)
        mp, mt = -(slopes[0] + slopes[1]), -(slopes[2] + slopes[3])
        stiff = young * row_at(rows.slope, 5 * LANES * row + 4 * LANES)
        strain = _strain(p, t)
        over = sub(strain, rows3_at(bound, first))
        under = sub(rows3_at(bound, first + 3 * LANES), strain)
        high, low = _principal(over[0], over[1], over[2]), _principal(under[0], under[1], under[2])
        (mean, half), (less, lesser) = _positive(high), _positive(low)
        # One division for three: 1 / a = b c / (a b c).
        a, b, c = most(high[1], LEAST_STRAIN), most(low[1], LEAST_STRAIN), most(less, LEAST_STRAIN)
        per = 1.0 / (a * b * c)
        # Twice the axis of the first principal value: cosine and sine of twice its angle.
        cosine, sine = b * c * per * high[2], b * c * per * high[3]
        cp = stiff * (mp * (mean + half * cosine) + mt * half * sine)
        ct = stiff * (mp * half * sine + mt * (mean - half * cosine))
        full = where_above(0.0, high[0] - high[1], LOOSE, 1.0)  # both principal values pull
        share = full * stiff
        across = 0.5 * share * mp * mt
        kpp, ktt = share * (mp * mp + 0.5 * mt * mt), share * (mt * mt + 0.5 * mp * mp)
        by_p = 0.5 * (mp + mp * cosine + mt * sine)
        by_t = 0.5 * (mp * sine + mt - mt * cosine)
        share = where_above(mean, 0.0, stiff - share, 0.0)
        kpp, across, ktt = kpp + share * by_p * by_p, across + share * by_p * by_t, ktt + share * by_t * by_t
        steady = most(cp * mp + ct * mt, 0.0)
        share = COMPRESSED * stiff
        cosine, sine = lesser * a * c * per * low[2], lesser * a * c * per * low[3]
        cp = cp - share * (mp * (less + cosine) + mt * sine)
        ct = ct - share * (mp * sine + mt * (less - cosine))
        cosine, sine = a * b * per * cosine, a * b * per * sine
        by_p = 0.5 * (mp + mp * cosine + mt * sine)
        by_t = 0.5 * (mp * sine + mt - mt * cosine)
        share = where_above(less, 0.0, share, 0.0)
        kpp, across, ktt = kpp + share * by_p * by_p, across + share * by_p * by_t, ktt + share * by_t * by_t
        g = add(g, mix(cp, p, ct, t))
        h = squares(h, kpp, across, ktt, p, t, steady)
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


# Rows of what holds a block: target and stiffness of the springs; the sample, the normal there, the gap less how deep
# still cloth is, and the square of the distance from which the sample says nothing; contact's stiffness; and the normal
# and height of two planes.
TARGET, SPRING, SAMPLE, NORMAL, HIGH, WITHIN, STIFF, BESIDE = 0, 3, 4, 7, 10, 11, 12, 13
HELD_ROWS = BESIDE + 8


@kernel
def keep_length(c, mesh, young, bound, springs, ground, turns):
    """Moves the nodes ``c`` [m] (N, 3) in place by ``turns`` sweeps there and back, each to its own quadratic
    minimum."""
    rows, x = mesh.rows, placed(c, mesh.rows)
    held = np.empty(HELD_ROWS * LANES * rows.moving, c.dtype)
    beside = _lay_held(mesh, springs, ground, held)
    for turn in range(2 * turns):
        for n in range(rows.moving):
            block = n if turn % 2 == 0 else rows.moving - 1 - n
            own, first = points_in(x, LANES * block), HELD_ROWS * LANES * block
            g, h = pull(x, block, rows, young, bound)
            s = row_at(held, first + SPRING * LANES)
            g = add(g, scaled(s, sub(own, rows3_at(held, first + TARGET * LANES))))
            h = shifted(h, s)
            normal, off = rows3_at(held, first + NORMAL * LANES), sub(own, rows3_at(held, first + SAMPLE * LANES))
            depth = row_at(held, first + HIGH * LANES) - dot(off, normal)
            contact = row_at(held, first + STIFF * LANES)
            stiff = where_above(row_at(held, first + WITHIN * LANES), dot(off, off), contact, 0.0)
            stiff = where_above(depth, 0.0, stiff, 0.0)
            g, h = add(g, scaled(-stiff * depth, normal)), outer(h, stiff, normal)
            if beside:
                for m in range(2):
                    normal = rows3_at(held, first + (BESIDE + 4 * m) * LANES)
                    depth = row_at(held, first + (BESIDE + 4 * m + 3) * LANES) - dot(own, normal)
                    stiff = where_above(depth, 0.0, contact, 0.0)
                    g, h = add(g, scaled(-stiff * depth, normal)), outer(h, stiff, normal)
            step = solved(h, g)
            share = REACH_M / root(most(dot(step, step), REACH_M * REACH_M))
            put_points(x, LANES * block, sub(own, scaled(share, step)))
    for p in range(LANES * rows.moving):
        for axis in range(3):
            c[rows.node[p], axis] = x[p, axis]


@kernel
def _lay_held(mesh, springs, ground, held):
    """Writes what holds the nodes to ``held``, flat, ``HELD_ROWS`` a block; whether any has a plane."""
    dtype, beside = held.dtype.type, False
    for p in range(LANES * mesh.rows.moving):
        i, first = mesh.rows.node[p], HELD_ROWS * LANES * (p // LANES) + p % LANES
        j = ground.touched[i]
        for axis in range(3):
            held[first + (TARGET + axis) * LANES] = springs.target[i, axis]
            held[first + (SAMPLE + axis) * LANES] = ground.skin[j, axis]
            held[first + (NORMAL + axis) * LANES] = ground.skin[j, 4 + axis]
        held[first + SPRING * LANES] = springs.n_per_m[i]
        held[first + HIGH * LANES] = dtype(GAP_M) - ground.deep[i]
        held[first + WITHIN * LANES] = dtype(np.inf) if j == ground.still[i] else dtype(TOUCH_M * TOUCH_M)
        held[first + STIFF * LANES] = dtype(2.0 * CONTACT_J_M4) * mesh.area_m2[i]
        for m in range(2):
            normal, row = at(ground.planes[i], m), first + (BESIDE + 4 * m) * LANES
            there = dot(normal, normal) > 0
            beside |= there
            held[row], held[row + LANES], held[row + 2 * LANES] = normal
            held[row + 3 * LANES] = dtype(GAP_M) + ground.planes[i, m, 3] if there else dtype(-1)
    return beside
