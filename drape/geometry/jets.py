"""Polynomial jets over a patch: basis, position, metric tensor, normal and curvature, all analytic.

A jet of order n is ``sum_{i<=n} sum_{j<=i} a_{i-j,j} u^(i-j) v^j`` (OneFit, equation 1),
coefficients in that order: 1, u, v, u^2, uv, v^2, ... A vector jet carries three
polynomials: in-plane p and q, and height h; its local surface is
``x(u, v) = s (p, q, h)``. ``pack`` and ``unpack`` fix how a patch's coefficients lie in memory. Networks predict
vector jets of 27 numbers; a full one, of 45, has the height's order in the plane as well.
"""

from __future__ import annotations

from drape.arrays import Array, namespace
from drape.geometry.rotations import cross

IN_PLANE_ORDER = 2
HEIGHT_ORDER = 4


def coefficient_count(order: int) -> int:
    """Returns the number of coefficients of a polynomial of ``order`` n in (u, v): (n + 1)(n + 2) / 2."""
    return (order + 1) * (order + 2) // 2


IN_PLANE_COUNT = coefficient_count(IN_PLANE_ORDER)  # 6
HEIGHT_COUNT = coefficient_count(HEIGHT_ORDER)  # 15
JET_COUNT = 2 * IN_PLANE_COUNT + HEIGHT_COUNT  # 27
FULL_COUNT = 3 * HEIGHT_COUNT  # 45


def exponents(order: int) -> list[tuple[int, int]]:
    """Returns the powers (of u, of v) of each monomial up to ``order``, in the order of coefficients: 1, u, v, u^2, uv,
    v^2, ..."""
    return [(i - j, j) for i in range(order + 1) for j in range(i + 1)]


def _powers(x: Array, order: int) -> list[Array]:
    xp = namespace(x)
    powers = [xp.ones_like(x)]
    for _ in range(order):
        powers.append(powers[-1] * x)
    return powers


def basis(uv: Array, order: int) -> Array:
    """Returns the monomials (..., n) up to ``order``, in the order of coefficients, at the parameters ``uv`` (...,
    2)."""
    xp = namespace(uv)
    u, v = _powers(uv[..., 0], order), _powers(uv[..., 1], order)
    return xp.stack([u[a] * v[b] for a, b in exponents(order)], axis=-1)


def basis_derivative(uv: Array, order: int, *, u_times: int = 0, v_times: int = 0) -> Array:
    """Returns the monomials (..., n) up to ``order``, differentiated ``u_times`` by u and ``v_times`` by v, at the
    parameters ``uv`` (..., 2)."""
    xp = namespace(uv)
    u, v = _powers(uv[..., 0], order), _powers(uv[..., 1], order)
    terms = []
    for a, b in exponents(order):
        factor = 1.0
        for k in range(u_times):
            factor *= a - k
        for k in range(v_times):
            factor *= b - k
        terms.append(factor * u[max(a - u_times, 0)] * v[max(b - v_times, 0)])
    return xp.stack(terms, axis=-1)


def pack(p: Array, q: Array, h: Array) -> Array:
    """Returns a vector jet, coefficients (..., 27 or 45): those of the in-plane polynomials ``p`` and ``q`` (..., 6 or
    15), then those of the height ``h`` (..., 15)."""
    return namespace(p).concat([p, q, h], axis=-1)


def unpack(jet: Array) -> tuple[Array, Array, Array]:
    """Returns the coefficients of the in-plane polynomials p and q (..., 6), and of the height h (..., 15), of a vector
    jet (..., 27). Of a full jet (..., 45) p and q are (..., 15) too."""
    plane = (jet.shape[-1] - HEIGHT_COUNT) // 2
    return jet[..., :plane], jet[..., plane : 2 * plane], jet[..., 2 * plane :]


def full(jet: Array) -> Array:
    """Returns ``jet`` (..., 27 or 45) as a full one (..., 45); in-plane coefficients above order 2 are zero where it
    had none."""
    xp = namespace(jet)
    p, q, h = unpack(jet)
    padding = xp.zeros_like(h[..., p.shape[-1] :])
    return xp.concat([p, padding, q, padding, h], axis=-1)


def evaluate_jet(jet: Array, uv: Array, *, u_times: int = 0, v_times: int = 0) -> Array:
    """Returns the position (p, q, h) (..., 3) of the vector jet ``jet`` (..., 27 or 45) at the parameters ``uv`` (...,
    2), in the patch's frame [patch scales], or its derivative, ``u_times`` by u and ``v_times`` by v."""
    xp = namespace(jet)
    p, q, h = unpack(jet)
    height = basis_derivative(uv, HEIGHT_ORDER, u_times=u_times, v_times=v_times)
    plane = height[..., : p.shape[-1]]  # lower orders come first
    return xp.stack([xp.sum(p * plane, axis=-1), xp.sum(q * plane, axis=-1), xp.sum(h * height, axis=-1)], axis=-1)


def normal(jet: Array, uv: Array) -> Array:
    """Returns the unit normals (..., 3) of the vector jet ``jet`` at the parameters ``uv`` (..., 2), in the patch's
    frame."""
    xp = namespace(jet)
    direction = cross(evaluate_jet(jet, uv, u_times=1), evaluate_jet(jet, uv, v_times=1))
    return direction / xp.sqrt(xp.sum(direction * direction, axis=-1, keepdims=True) + 1e-30)


def curvature(jet: Array, uv: Array, scale: Array) -> tuple[Array, Array]:
    """Returns the mean [1/m] and the Gaussian [1/m^2] curvature (...,) of the vector jet ``jet`` at the parameters
    ``uv`` (..., 2); ``scale`` (...,) [m per unit]. The mean is positive where the patch bends towards its normal."""
    xp = namespace(jet)
    du, dv = evaluate_jet(jet, uv, u_times=1), evaluate_jet(jet, uv, v_times=1)
    n = normal(jet, uv)
    second = [xp.sum(n * evaluate_jet(jet, uv, u_times=a, v_times=b), axis=-1) for a, b in ((2, 0), (1, 1), (0, 2))]
    e, f, g = xp.sum(du * du, axis=-1), xp.sum(du * dv, axis=-1), xp.sum(dv * dv, axis=-1)
    determinant = e * g - f * f
    mean = (second[0] * g - 2.0 * second[1] * f + second[2] * e) / (2.0 * determinant * scale)
    gaussian = (second[0] * second[2] - second[1] * second[1]) / (determinant * scale * scale)
    return mean, gaussian
