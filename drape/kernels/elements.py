"""The formulas of vectors, triangles and hinges, compiled.

A vector is a tuple of three numbers, or of three rows (``drape.kernels.lanes``): one formula serves a vertex and a
block of sixteen. The energies are those of ``drape.cloth.energies``. ``k`` are a problem's ``KernelConstants``.

*Membrane.* With D the rest shape of a triangle, F = dx D^-1 has the columns p along the warp and t along the weft, and

    E = A/8 (warp pp^2 + 2 cross pp tt + weft tt^2 + shear pt^2),   pp = p.p - 1, tt = t.t - 1, pt = p.t.

``k`` holds half of the fabric's warp, cross and weft and a quarter of its shear. A corner whose slopes along warp
and weft are mp and mt moves p by mp and t by mt, so that its gradient is (mp spp + mt spt) p + (mp spt + mt stt) t
with the stress times area spp, stt, spt.

*Hinge.* E = stiffness (1 - cos(theta - theta0)), theta the signed angle between two triangles that share the edge e.
"""

from __future__ import annotations

import numpy as np
from numba.extending import overload

from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import number_at

# --- vectors ---------------------------------------------------------------------------------------------------------


def at(x, v):
    """The vector in the row ``v`` of ``x``, which is not negative."""
    return x[v, 0], x[v, 1], x[v, 2]


@overload(at)
def _at(x, v):
    if x.layout != "C":
        return lambda x, v: (x[v, 0], x[v, 1], x[v, 2])

    def chosen(x, v):
        first = np.intp(v) * x.shape[1]
        return number_at(x, first), number_at(x, first + 1), number_at(x, first + 2)

    return chosen


@kernel
def sub(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def scaled(s, a):
    return s * a[0], s * a[1], s * a[2]


@kernel
def mix(s, a, t, b):
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def add_to(x, v, a):
    """Adds the vector ``a`` to row ``v`` of ``x``."""
    x[v, 0] += a[0]
    x[v, 1] += a[1]
    x[v, 2] += a[2]


@kernel
def outer(h, s, a):
    """The symmetric matrix ``h`` (00, 01, 02, 11, 12, 22) plus s a a^T."""
    b = scaled(s, a)
    return (
        h[0] + b[0] * a[0],
        h[1] + b[0] * a[1],
        h[2] + b[0] * a[2],
        h[3] + b[1] * a[1],
        h[4] + b[1] * a[2],
        h[5] + b[2] * a[2],
    )


@part
def squares(h, kpp, kpt, ktt, p, t, s):
    """The symmetric matrix ``h`` plus kpp p p^T + kpt (p t^T + t p^T) + ktt t t^T and s times the identity."""
    by_p, by_t = mix(kpp, p, kpt, t), mix(kpt, p, ktt, t)
    return (
        h[0] + by_p[0] * p[0] + by_t[0] * t[0] + s,
        h[1] + by_p[0] * p[1] + by_t[0] * t[1],
        h[2] + by_p[0] * p[2] + by_t[0] * t[2],
        h[3] + by_p[1] * p[1] + by_t[1] * t[1] + s,
        h[4] + by_p[1] * p[2] + by_t[1] * t[2],
        h[5] + by_p[2] * p[2] + by_t[2] * t[2] + s,
    )


@kernel
def with_spare(x):
    """Room for as many points as ``x`` (P, 3) has, and behind them for one more (``drape.kernels.lanes.spared_at``)."""
    return np.empty((len(x) + 1, 3), x.dtype)[: len(x)]


@kernel
def shifted(h, s):
    """The symmetric matrix ``h`` plus s times the identity."""
    return h[0] + s, h[1], h[2], h[3] + s, h[4], h[5] + s


@kernel
def solved(h, g):
    """``h``^-1 g of a symmetric matrix."""
    a = h[3] * h[5] - h[4] * h[4]
    b = h[2] * h[4] - h[1] * h[5]
    c = h[1] * h[4] - h[2] * h[3]
    d = h[0] * h[5] - h[2] * h[2]
    e = h[1] * h[2] - h[0] * h[4]
    f = h[0] * h[3] - h[1] * h[1]
    det = h[0] * a + h[1] * b + h[2] * c
    return (
        (a * g[0] + b * g[1] + c * g[2]) / det,
        (b * g[0] + d * g[1] + e * g[2]) / det,
        (c * g[0] + e * g[1] + f * g[2]) / det,
    )


@kernel
def farthest_m(x, y):
    """The largest distance [m] between a point of ``x`` (P, 3) and that of ``y``, NaN where one is."""
    most = x.dtype.type(0)
    for v in range(len(x)):
        way = sub(at(x, v), at(y, v))
        square = dot(way, way)
        if most == most and not square <= most:  # NaN, once met, stays
            most = square
    return np.sqrt(most)


@kernel
def are_finite(values):
    """Whether all of the flat ``values`` are finite."""
    wrong = False
    for i in range(len(values)):  # no way out of the loop: it is done in rows
        wrong |= values[i] - values[i] != 0
    return not wrong


# --- membrane --------------------------------------------------------------------------------------------------------


@part
def columns(first, second, p1, p2, t1, t2):
    """The columns p and t of F, from the edges ``first`` and ``second`` at a corner and the slopes of their ends."""
    return mix(p1, first, p2, second), mix(t1, first, t2, second)


@part
def stress(p, t, area, k):
    """Stress times area (spp, stt, spt) [N m] of a triangle with the columns p, t of F, and its energy [J]."""
    pp, tt, pt = dot(p, p) - k.one, dot(t, t) - k.one, dot(p, t)
    spp = area * (k.warp * pp + k.cross * tt)
    stt = area * (k.cross * pp + k.weft * tt)
    spt = area * k.shear * pt
    return spp, stt, spt, k.half * (k.half * (spp * pp + stt * tt) + spt * pt)


@part
def corner_force(p, t, mp, mt, area, k):
    """How much (cp, ct) of the columns p and t the gradient [N] of a corner with the slopes mp, mt has."""
    spp, stt, spt, _ = stress(p, t, area, k)
    return mp * spp + mt * spt, mp * spt + mt * stt


@part
def corner_stiffness(mp, mt, area, k):
    """Weights (kpp, ktt, kpt) of p p^T, t t^T and p t^T + t p^T in a corner's Gauss-Newton Hessian [N/m].

    The derivatives of the strains by the corner, 2 mp p, 2 mt t and mp t + mt p, times the material.
    """
    twice = k.one + k.one
    return (
        area * (twice * k.warp * mp * mp + k.shear * mt * mt),
        area * (twice * k.weft * mt * mt + k.shear * mp * mp),
        area * (twice * k.cross + k.shear) * mp * mt,
    )


# --- hinge -----------------------------------------------------------------------------------------------------------


@kernel
def fold(corners, cosine, sine, k):
    """1 - cos(theta - theta0) of a hinge at four points, and the vectors (e, a, b, n1, n2) and scalars of it."""
    origin = corners[0]
    e = scaled(k.per_edge, sub(corners[1], origin))
    a = scaled(k.per_edge, sub(corners[2], origin))
    b = scaled(k.per_edge, sub(corners[3], origin))
    n1, n2 = cross(e, a), cross(b, e)
    q1, q2 = dot(n1, n1), dot(n2, n2)
    scale = k.one / np.sqrt(q1 * q2 + k.degenerate)
    length = np.sqrt(dot(e, e) + k.degenerate)
    rise = dot(n1, b)
    value = cosine * dot(n1, n2) - sine * length * rise
    return k.one - scale * value, (e, a, b, n1, n2), (q1, q2, scale, length, rise, value)


@kernel
def fold_gradient(vectors, scalars, cosine, sine, k):
    """Derivatives [1/m] of the fold by the four corners."""
    e, a, b, n1, n2 = vectors
    q1, q2, scale, length, rise, value = scalars
    cube = value * scale * scale * scale
    by_n1 = add(mix(-scale * cosine, n2, scale * sine * length, b), scaled(cube * q2, n1))
    by_n2 = mix(-scale * cosine, n1, cube * q1, n2)
    by_e = add(add(cross(a, by_n1), cross(by_n2, b)), scaled(scale * sine * rise / length, e))
    by_a = cross(by_n1, e)
    by_b = add(cross(e, by_n2), scaled(scale * sine * length, n1))
    by_e, by_a, by_b = scaled(k.per_edge, by_e), scaled(k.per_edge, by_a), scaled(k.per_edge, by_b)
    origin = scaled(-k.one, add(by_e, add(by_a, by_b)))
    return origin, by_e, by_a, by_b


@kernel
def angle_gradient(vectors, k):
    """Derivatives [1/m] of theta by the four corners, guarded where a triangle has no area."""
    e, a, b, n1, n2 = vectors
    square = dot(e, e) + k.degenerate
    length = np.sqrt(square)
    over1 = k.per_edge / (dot(n1, n1) + k.degenerate)
    over2 = k.per_edge / (dot(n2, n2) + k.degenerate)
    along1, along2 = dot(a, e) / length, dot(b, e) / length
    return (
        mix((length - along1) * over1, n1, (length - along2) * over2, n2),
        mix(along1 * over1, n1, along2 * over2, n2),
        scaled(-length * over1, n1),
        scaled(-length * over2, n2),
    )


@part
def hinge_corner(x, hinges, member, k):
    """The stiffness [J] of the hinge ``member`` // 4 of ``hinges`` at ``x`` [m], and the derivatives [1/m] of its fold
    and of its angle by the corner ``member`` % 4."""
    h, corner = member // 4, member % 4
    vertex, cosine, sine = hinges.corner[h], hinges.cosine[h], hinges.sine[h]
    points = (at(x, vertex[0]), at(x, vertex[1]), at(x, vertex[2]), at(x, vertex[3]))
    _, vectors, scalars = fold(points, cosine, sine, k)
    by_corner = fold_gradient(vectors, scalars, cosine, sine, k)
    return hinges.stiffness[h], by_corner[corner], angle_gradient(vectors, k)[corner]
