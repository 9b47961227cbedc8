"""The membrane of cloth for arrays: the energy of triangles and its derivatives by their corners.

    F = [x1 - x0, x2 - x0] D^-1 = [p t],   E = (F^T F - 1) / 2
    W = area / 2 (k_p Epp^2 + 2 k_c Epp Ett + k_t Ett^2 + k_s Ept^2)

The orthotropic St.Venant-Kirchhoff model. D (2 x 2) holds the edges of a triangle at rest from its first corner, in
two axes of the cloth; ``stiffness`` is (k_p, k_t, k_c, k_s) [N/m]: with the axes warp and weft it is (warp, weft,
cross, shear). An isotropic cloth has k_p = k_t = 2 mu + lambda, k_c = lambda, k_s = 4 mu.

Written once for numpy and torch, differentiable in everything. Triangles are the last axis: ``corners`` are three
arrays (3, ..., F) of positions [m]. The engine has the same (``elements.hpp``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drape.arrays import Array, like, namespace

# Share of the mean of k_p and k_t below which a stress counts as slack in the definite Hessian; the transition is
# smooth, so that gradients through a step exist at rest too.
SLACK_SHARE = 1e-3

Corners = Sequence[Array] | Array
Stiffness = Sequence[float | Array] | Array
Symmetric = tuple[Array, Array, Array]  # pp, tt, pt


class RestTriangles(NamedTuple):
    """The constants of F triangles: entries 00, 10, 01, 11 of the ``inverse`` (4, F) [1/m] of D, and the ``area`` (F,)
    [m^2].

    D (2 x 2) has the edges [m] from the first corner at rest as columns, in the two axes of the cloth.
    """

    inverse: Array
    area: Array


def rest_triangles(first: Array, second: Array) -> RestTriangles:
    """Returns the constants of triangles whose edges from the first corner are ``first`` and ``second`` (2, F) [m] at
    rest.

    A mirrored triangle has a positive area too.
    """
    double = first[0] * second[1] - first[1] * second[0]
    inverse = namespace(first).stack([second[1], -first[1], -second[0], first[0]], axis=0) / double
    return RestTriangles(inverse, 0.5 * namespace(first).abs(double))


def deformation_columns(corners: Corners, inverse: Array) -> tuple[Array, Array]:
    """Returns the columns p and t (3, ..., F) of the deformation gradient at ``corners``, three arrays (3, ..., F) [m].
    ``inverse`` (4, F) [1/m] is that of ``RestTriangles``. They are linear in ``corners``."""
    first, second = corners[1] - corners[0], corners[2] - corners[0]
    a, b, c, d = namespace(inverse).unstack(inverse, axis=0)
    return a * first + b * second, c * first + d * second


def green_strain(p: Array, t: Array) -> Symmetric:
    """Returns Green's strain (Epp, Ett, Ept), each (..., F), of the columns (3, ..., F) of the deformation gradient."""
    return 0.5 * (_dot(p, p) - 1.0), 0.5 * (_dot(t, t) - 1.0), 0.5 * _dot(p, t)


def stress(strain: Sequence[Array], stiffness: Stiffness) -> Symmetric:
    """Returns the second Piola-Kirchhoff stress (Spp, Stt, Spt) [N/m] of Green's ``strain`` (Epp, Ett, Ept), each with
    the shape of its strain. ``stiffness`` is (k_p, k_t, k_c, k_s) [N/m]."""
    warp, weft, cross, shear = (stiffness[i] for i in range(4))
    pp, tt, pt = strain
    return warp * pp + cross * tt, cross * pp + weft * tt, 0.5 * shear * pt


def membrane_energy(corners: Corners, rest: RestTriangles, stiffness: Stiffness) -> Array:
    """Returns the membrane energy [J] (..., F) of every triangle at ``corners``, three arrays (3, ..., F) [m]."""
    strain = green_strain(*deformation_columns(corners, rest.inverse))
    return (0.5 * rest.area) * _double_dot(stress(strain, stiffness), strain)


def membrane_gradient(corners: Corners, rest: RestTriangles, stiffness: Stiffness) -> Array:
    """Returns the gradient [N] (3, 3, F) of ``membrane_energy`` by the three ``corners``. The forces on them are its
    negative."""
    p, t = deformation_columns(corners, rest.inverse)
    pp, tt, pt = stress(green_strain(p, t), stiffness)
    by_p, by_t = rest.area * (pp * p + pt * t), rest.area * (pt * p + tt * t)
    along, across = _slopes(rest.inverse)
    return along[:, None] * by_p + across[:, None] * by_t


def membrane_hessian(corners: Corners, rest: RestTriangles, stiffness: Stiffness, *, definite: bool) -> Array:
    """Returns the Hessian [N/m] (9, 9, F) of ``membrane_energy`` by the coordinates of the three corners, corner by
    corner.

    ``definite``: returns a positive semidefinite one, in which ``tension`` stands in place of the stress.
    """
    xp = namespace(rest.area)
    p, t = deformation_columns(corners, rest.inverse)
    along, across = _slopes(rest.inverse)
    count = along.shape[-1]
    by_p, by_t = along[:, None], across[:, None]
    rows = [xp.reshape(row, (9, count)) for row in (by_p * p, by_t * t, 0.5 * (by_p * t + by_t * p))]
    pp, tt, pt = stress(rows, stiffness)
    elastic = pp[:, None] * rows[0] + tt[:, None] * rows[1] + 2.0 * pt[:, None] * rows[2]
    pp, tt, pt = _geometric_stress(p, t, stiffness, definite)
    pulled = (pp * along + pt * across)[:, None] * along + (pt * along + tt * across)[:, None] * across
    identity = like(rest.area, np.eye(3))[None, :, None, :, None]
    return rest.area * (elastic + xp.reshape(pulled[:, None, :, None] * identity, (9, 9, count)))


def membrane_bilinear(
    corners: Corners, rest: RestTriangles, stiffness: Stiffness, left: Corners, right: Corners
) -> Array:
    """Returns ``left``^T H ``right`` (F,) of every triangle, without storing H, the definite Hessian [N/m] of
    ``membrane_hessian``. ``left`` and ``right`` are displacements of the corners, three arrays (3, F) each."""
    p, t = deformation_columns(corners, rest.inverse)
    (lp, lt), (rp, rt) = deformation_columns(left, rest.inverse), deformation_columns(right, rest.inverse)
    by_left, by_right = (
        (_dot(p, dp), _dot(t, dt), 0.5 * (_dot(p, dt) + _dot(t, dp))) for dp, dt in ((lp, lt), (rp, rt))
    )
    both = _dot(lp, rp), _dot(lt, rt), 0.5 * (_dot(lp, rt) + _dot(lt, rp))
    pulled = _double_dot(_geometric_stress(p, t, stiffness, definite=True), both)
    return rest.area * (_double_dot(stress(by_left, stiffness), by_right) + pulled)


def tension(stresses: Sequence[Array], floor: Array | float) -> Symmetric:
    """Returns the stress (pp, tt, pt) with each principal value s replaced by (s + sqrt(s^2 + floor^2)) / 2 > 0, in the
    unit and shape of ``stresses``.

    Written in the squared radius of Mohr's circle, so that it is smooth where principal values meet.
    """
    pp, tt, pt = stresses
    xp = namespace(pp)
    mean, half = 0.5 * (pp + tt), 0.5 * (pp - tt)
    radius2 = half * half + pt * pt
    square = floor * floor
    product = (mean * mean - radius2) ** 2 + 2.0 * square * (mean * mean + radius2) + square * square
    roots = xp.sqrt(2.0 * (mean * mean + radius2 + square) + 2.0 * xp.sqrt(product))
    centre, slope = 0.5 * mean + 0.25 * roots, 0.5 + mean / roots
    return centre + slope * half, centre - slope * half, slope * pt


def _geometric_stress(p: Array, t: Array, stiffness: Stiffness, definite: bool) -> Symmetric:
    found = stress(green_strain(p, t), stiffness)
    return tension(found, SLACK_SHARE * 0.5 * (stiffness[0] + stiffness[1])) if definite else found


def _slopes(inverse: Array) -> tuple[Array, Array]:
    """Derivatives [1/m] (3, F) of the shape functions of the three corners along both axes."""
    xp = namespace(inverse)
    a, b, c, d = xp.unstack(inverse, axis=0)
    return xp.stack([-a - b, a, b], axis=0), xp.stack([-c - d, c, d], axis=0)


def _double_dot(a: Symmetric, b: Symmetric) -> Array:
    return a[0] * b[0] + a[1] * b[1] + 2.0 * (a[2] * b[2])


def _dot(a: Array, b: Array) -> Array:
    return namespace(a).sum(a * b, axis=0)
