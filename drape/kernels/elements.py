"""Vectors, triangles, hinges and what acts on a vertex, compiled; a vector is a tuple of three numbers.

The energies are those of ``drape.cloth.energies``; ``reference`` says the same in a readable way, and tests compare.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel, part

# --- vectors ---------------------------------------------------------------------------------------------------------


@kernel
def at(x, v):
    return x[v, 0], x[v, 1], x[v, 2]


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


@part
def slopes(t, entry):
    s = t.slope
    return s[entry, 0], s[entry, 1], s[entry, 2], s[entry, 3], s[entry, 4]


@kernel
def add_to(x, v, a):
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


@kernel
def shifted(h, s):
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


# --- elements --------------------------------------------------------------------------------------------------------


@kernel
def stress(p, t, area, k):
    """Stress times area (pp, tt, pt) [N m] of a triangle with the columns p, t of F, and its energy [J]."""
    cp, ct, cs = dot(p, p) - k.one, dot(t, t) - k.one, dot(p, t)
    pp = area * (k.warp * cp + k.cross * ct)
    tt = area * (k.cross * cp + k.weft * ct)
    pt = area * k.shear * cs
    return pp, tt, pt, k.half * (k.half * (pp * cp + tt * ct) + pt * cs)


@kernel
def tension(pp, tt, pt, k):
    """The stress (pp, tt, pt) without what pushes: principal values below zero are zero."""
    mean = k.half * (pp + tt)
    radius = np.sqrt(k.half * k.half * (pp - tt) * (pp - tt) + pt * pt)
    if mean >= radius:
        return pp, tt, pt
    if mean <= -radius or radius == k.zero:
        return k.zero, k.zero, k.zero
    share, low = k.half * (mean + radius) / radius, mean - radius
    return share * (pp - low), share * (tt - low), share * pt


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
    """Derivatives [1/m] of the fold by the corners."""
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
    """Derivatives [1/m] of the dihedral angle by the corners, (l - u.a) n / |n|^2 and so on; guarded."""
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
def outside(x, v, problem, around):
    """Energy [J], gradient [N] and symmetric Hessian [N/m] of weight, contact and springs at the point ``x`` of v."""
    k = problem.constants
    normal = at(around.normal, v)
    weight = problem.weight_n[v]
    energy = weight * x[1]
    gradient = (k.zero, weight, k.zero)
    hessian = (k.zero, k.zero, k.zero, k.zero, k.zero, k.zero)
    depth = k.gap - dot(sub(x, at(around.point, v)), normal)
    if depth > k.zero:
        stiffness = problem.contact_n_per_m[v]
        energy += k.half * stiffness * depth * depth
        gradient = add(gradient, scaled(-stiffness * depth, normal))
        hessian = outer(hessian, stiffness, normal)
    spring = around.target_n_per_m[v]
    if spring > k.zero:
        way = sub(x, at(around.target, v))
        energy += k.half * spring * dot(way, way)
        gradient = add(gradient, scaled(spring, way))
        hessian = shifted(hessian, spring)
    spring = around.band_n_per_m[v]
    if spring > k.zero:
        way = sub(x, at(around.band, v))
        length = np.sqrt(dot(way, way))
        if length > k.slack:
            past = length - k.slack
            energy += k.half * spring * past * past
            gradient = add(gradient, scaled(spring * past / length, way))
            hessian = outer(shifted(hessian, spring * past / length), spring * k.slack / length**3, way)
    return energy, gradient, hessian


@kernel
def add_to_block(blocks, z, a, b):
    """Adds a b^T to block z."""
    for i in range(3):
        for j in range(3):
            blocks[z, i, j] += a[i] * b[j]
