"""Woven cloth on its sewing pattern: orthotropic membrane on planar rest panels, and bending of hinges.

Energies [J] of single elements with their analytic gradients and Hessians, written once for numpy and
torch; summing elements into a mesh belongs to the caller. Element arrays keep the element last: corners
of triangles (3, 3, F) and of hinges (4, 3, H) are (corner, coordinate, element), those of the panels
(3, 2, F). Gradients have the shape of the corners, Hessians (9, 9, F) and (12, 12, H).

The strain is Green's, e = (F^T F - I) / 2 in the axes of the panel (x the weft, y the warp), the stress
s00 = H00 e00 + H01 e11, s11 = H01 e00 + H11 e11, s01 = H22 e01, and the energy area/2 s : e. An isotropic
cloth has H00 = H11 = lambda + 2 mu, H01 = lambda, H22 = 2 mu.

A hinge holds k l^2 / (A1 + A2) 4 (1 - cos(theta / 2)) with the lengths of the panels: near the plane that
is the hinge of ``energies.bending``, and up to a full fold its moment grows, as sin(theta / 2) does in
equation 3 of Yu, Cordier and Seo (2024), whose constant is twice this k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.arrays import Array, like, namespace
from drape.errors import InputError

# Share of the mean of H00 and H11 below which a stress counts as slack in the definite Hessian; the
# transition is smooth, so that gradients through a step exist at rest too.
SLACK_SHARE = 1e-3
# Added to the squared normal of a hinge's triangle, in units of its rest edge to the fourth power.
COLLAPSED = 1e-18


@dataclass(frozen=True)
class OrthotropicMaterial:
    """Constants of a woven cloth: ``h00`` .. ``h22`` [N/m], plate rigidity ``bending_j`` [J], ``density_kg_m2``."""

    h00: float
    h01: float
    h11: float
    h22: float
    bending_j: float
    density_kg_m2: float

    def __post_init__(self) -> None:
        numbers = np.array(list(vars(self).values()), dtype=np.float64)
        stiff = self.h00 > 0.0 and self.h11 > 0.0 and self.h22 > 0.0 and self.h01**2 < self.h00 * self.h11
        if not (np.isfinite(numbers).all() and stiff and self.bending_j >= 0.0 and self.density_kg_m2 > 0.0):
            raise InputError(
                "orthotropic material",
                expected="h00, h11, h22, density > 0, h01^2 < h00 h11, bending >= 0",
                got=str(self),
                cure="Give a stiffness that resists every strain.",
            )

    @property
    def stretch_n_per_m(self) -> np.ndarray:
        """(H00, H01, H11, H22) [N/m]."""
        return np.array([self.h00, self.h01, self.h11, self.h22])


class RestShape(NamedTuple):
    """What the panels say: gradients of the shape functions (3, 2, F) [1/m] and ``area`` [m^2] (F,)."""

    gradient: Array
    area: Array


def corners(planes: Array, index: Array, count: int) -> Array:
    """Element corners (count, D, n) of ``planes`` (D, V) at ``index`` (count * n,), all first corners first."""
    xp = namespace(planes)
    gathered = xp.take(planes, index, axis=-1)
    split = xp.reshape(gathered, (planes.shape[0], count, index.shape[0] // count))
    return xp.permute_dims(split, (1, 0, 2))


def rest_shape(panel: Array) -> RestShape:
    """Constants of rest triangles (3, 2, F) [m]; a mirrored triangle counts with its positive area."""
    xp = namespace(panel)
    e1, e2 = panel[1] - panel[0], panel[2] - panel[0]
    double = e1[0] * e2[1] - e1[1] * e2[0]
    g1 = xp.stack([e2[1], -e2[0]], axis=0) / double
    g2 = xp.stack([-e1[1], e1[0]], axis=0) / double
    return RestShape(xp.stack([-g1 - g2, g1, g2], axis=0), 0.5 * xp.abs(double))


def rest_area(panel: Array) -> Array:
    """Areas [m^2] (F,) of rest triangles (3, 2, F)."""
    e1, e2 = panel[1] - panel[0], panel[2] - panel[0]
    return 0.5 * namespace(panel).abs(e1[0] * e2[1] - e1[1] * e2[0])


def panel_edges(panel: Array) -> Array:
    """Lengths [m] (3, F) of the edges that start at each corner of the rest triangles (3, 2, F)."""
    xp = namespace(panel)
    edges = xp.stack([panel[1] - panel[0], panel[2] - panel[1], panel[0] - panel[2]], axis=0)
    return xp.sqrt(xp.sum(edges * edges, axis=1))


# --- membrane --------------------------------------------------------------------------------------------------------


def deformation(position: Array, rest: RestShape) -> Array:
    """The two columns (2, 3, F) of the deformation gradient; linear in ``position``."""
    xp = namespace(position)
    return xp.sum(position[:, None] * rest.gradient[:, :, None], axis=0)


def green_strain(f: Array) -> Array:
    """(e00, e11, e01) as (3, F)."""
    xp = namespace(f)
    e00, e11, e01 = _dot(f[0], f[0]) - 1.0, _dot(f[1], f[1]) - 1.0, _dot(f[0], f[1])
    return 0.5 * xp.stack([e00, e11, e01], axis=0)


def stress(strain: Array, stretch: Array) -> Array:
    """(s00, s11, s01) [N/m] (3, ...) of ``strain`` (3, ...) under (H00, H01, H11, H22)."""
    xp = namespace(strain)
    h00, h01, h11, h22 = (stretch[i] for i in range(4))
    s00 = h00 * strain[0] + h01 * strain[1]
    return xp.stack([s00, h01 * strain[0] + h11 * strain[1], h22 * strain[2]], axis=0)


def membrane_energy(position: Array, rest: RestShape, stretch: Array) -> Array:
    """Energy [J] (F,) of every triangle."""
    strain = green_strain(deformation(position, rest))
    return 0.5 * rest.area * _double_dot(stress(strain, stretch), strain)


def membrane_gradient(position: Array, rest: RestShape, stretch: Array) -> Array:
    """Derivative [N] (3, 3, F) of the energy by the corners: minus the force."""
    xp = namespace(position)
    f = deformation(position, rest)
    s = stress(green_strain(f), stretch)
    p = xp.stack([s[0] * f[0] + s[2] * f[1], s[2] * f[0] + s[1] * f[1]], axis=0)
    return rest.area * xp.sum(rest.gradient[:, :, None] * p[None], axis=1)


def membrane_work(position: Array, rest: RestShape, stretch: Array, direction: Array) -> Array:
    """Gradient times ``direction`` (3, 3, F), summed per triangle (F,)."""
    f = deformation(position, rest)
    return rest.area * _double_dot(stress(green_strain(f), stretch), _variation(f, deformation(direction, rest)))


def membrane_hessian(position: Array, rest: RestShape, stretch: Array, *, definite: bool) -> Array:
    """Second derivative [N/m] (9, 9, F); ``definite`` keeps of the stress only ``tension``."""
    xp = namespace(position)
    f = deformation(position, rest)
    g = rest.gradient
    count = g.shape[-1]
    g0, g1 = g[:, 0, None], g[:, 1, None]
    rows = xp.stack([g0 * f[0], g1 * f[1], 0.5 * (g0 * f[1] + g1 * f[0])], axis=0)
    b = xp.reshape(rows, (3, 9, count))
    t = rest.area * stress(b, stretch)
    material = t[0][:, None] * b[0][None] + t[1][:, None] * b[1][None] + 2.0 * (t[2][:, None] * b[2][None])
    s = _geometric_stress(f, stretch, definite)
    pulled = xp.stack([s[0] * g[:, 0] + s[2] * g[:, 1], s[2] * g[:, 0] + s[1] * g[:, 1]], axis=1)
    geometric = rest.area * xp.sum(g[:, None] * pulled[None], axis=2)
    identity = like(position, np.eye(3))[None, :, None, :, None]
    return material + xp.reshape(geometric[:, None, :, None] * identity, (9, 9, count))


def membrane_bilinear(
    position: Array, rest: RestShape, stretch: Array, left: Array, right: Array, *, definite: bool
) -> Array:
    """``left``^T Hessian ``right`` per triangle (F,) for directions (3, 3, F), without the Hessian itself."""
    xp = namespace(position)
    f, fl, fr = (deformation(vectors, rest) for vectors in (position, left, right))
    linear = _double_dot(stress(_variation(f, fl), stretch), _variation(f, fr))
    mixed = xp.stack([_dot(fl[0], fr[0]), _dot(fl[1], fr[1]), 0.5 * (_dot(fl[0], fr[1]) + _dot(fl[1], fr[0]))], axis=0)
    return rest.area * (linear + _double_dot(_geometric_stress(f, stretch, definite), mixed))


def tension(s: Array, floor: Array | float) -> Array:
    """The stress (3, F) with each principal value p replaced by (p + sqrt(p^2 + floor^2)) / 2 > 0.

    Written in the squared radius of Mohr's circle, so that it is smooth where principal values meet.
    """
    xp = namespace(s)
    mean, half = 0.5 * (s[0] + s[1]), 0.5 * (s[0] - s[1])
    radius2 = half * half + s[2] * s[2]
    square = floor * floor
    product = (mean * mean - radius2) ** 2 + 2.0 * square * (mean * mean + radius2) + square * square
    roots = xp.sqrt(2.0 * (mean * mean + radius2 + square) + 2.0 * xp.sqrt(product))
    centre, slope = 0.5 * mean + 0.25 * roots, 0.5 + mean / roots
    return xp.stack([centre + slope * half, centre - slope * half, slope * s[2]], axis=0)


def _geometric_stress(f: Array, stretch: Array, definite: bool) -> Array:
    s = stress(green_strain(f), stretch)
    return tension(s, SLACK_SHARE * 0.5 * (stretch[0] + stretch[2])) if definite else s


def _variation(f: Array, df: Array) -> Array:
    xp = namespace(f)
    return xp.stack([_dot(f[0], df[0]), _dot(f[1], df[1]), 0.5 * (_dot(f[0], df[1]) + _dot(f[1], df[0]))], axis=0)


def _double_dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + 2.0 * (a[2] * b[2])


# --- bending ---------------------------------------------------------------------------------------------------------


class _Hinge(NamedTuple):
    """``angle`` (H,), its derivative (4, 3, H), and what the second derivative needs."""

    angle: Array
    gradient: Array
    edge: Array
    length: Array
    arms: tuple[Array, Array]
    normals: tuple[Array, Array]
    squares: tuple[Array, Array]
    factors: tuple[Array, Array]


def _hinge(position: Array) -> _Hinge:
    """Dihedral angle of hinges (4, 3, H) = (i, j, k, l), positive where the fold points along the normals."""
    xp = namespace(position)
    e = position[1] - position[0]
    a, b = position[2] - position[0], position[3] - position[0]
    n1, n2 = _cross(e, a), _cross(b, e)
    length = xp.sqrt(_dot(e, e))
    floor = COLLAPSED * length**4
    q1, q2 = _dot(n1, n1) + floor, _dot(n2, n2) + floor
    angle = xp.atan2(-length * _dot(n1, b), _dot(n1, n2))
    unit = e / length
    ua, ub = _dot(a, unit), _dot(b, unit)
    # d angle = sum_i (c1_i n1 / q1 + c2_i n2 / q2) . dx_i, with the sign of the angle above.
    zero = xp.zeros_like(length)
    c1 = xp.stack([length - ua, ua, -length, zero], axis=0)
    c2 = xp.stack([length - ub, ub, zero, -length], axis=0)
    gradient = c1[:, None] * (n1 / q1) + c2[:, None] * (n2 / q2)
    return _Hinge(angle, gradient, unit, length, (a, b), (n1, n2), (q1, q2), (c1, c2))


def hinge_angle(position: Array) -> Array:
    """Signed dihedral angle [rad] (H,), zero in the plane."""
    return _hinge(position).angle


def hinge_weight(length: Array, first_area: Array, second_area: Array) -> Array:
    """l^2 / (A1 + A2) (H,) of rest hinges."""
    return length * length / (first_area + second_area)


def bending_energy(position: Array, weight: Array, bending_j: Array | float, rest: Array | float = 0.0) -> Array:
    """Energy [J] (H,) of every hinge; ``rest`` [rad] () or (H,) is the angle without stress."""
    xp = namespace(position)
    # 4 (1 - cos(t / 2)) = 8 sin(t / 4)^2, which keeps its digits near the plane.
    return 8.0 * bending_j * weight * xp.sin(0.25 * (hinge_angle(position) - rest)) ** 2


def bending_gradient(position: Array, weight: Array, bending_j: Array | float, rest: Array | float = 0.0) -> Array:
    """Derivative [N] (4, 3, H) of the energy by the corners: minus the force."""
    xp = namespace(position)
    hinge = _hinge(position)
    return 2.0 * bending_j * weight * xp.sin(0.5 * (hinge.angle - rest)) * hinge.gradient


def bending_work(
    position: Array, weight: Array, bending_j: Array | float, direction: Array, rest: Array | float = 0.0
) -> Array:
    """Gradient times ``direction`` (4, 3, H), summed per hinge (H,)."""
    xp = namespace(position)
    return xp.sum(bending_gradient(position, weight, bending_j, rest) * direction, axis=(0, 1))


def bending_hessian(
    position: Array, weight: Array, bending_j: Array | float, rest: Array | float = 0.0, *, definite: bool
) -> Array:
    """Second derivative [N/m] (12, 12, H); ``definite`` leaves out the curvature of the angle."""
    xp = namespace(position)
    hinge = _hinge(position)
    g = xp.reshape(hinge.gradient, (12, -1))
    scale = bending_j * weight
    linear = (scale * _turn_stiffness(hinge, rest, definite) * g)[:, None] * g[None]
    if definite:
        return linear
    return linear + 2.0 * scale * xp.sin(0.5 * (hinge.angle - rest)) * _angle_hessian(hinge)


def bending_bilinear(
    position: Array,
    weight: Array,
    bending_j: Array | float,
    left: Array,
    right: Array,
    rest: Array | float = 0.0,
    *,
    definite: bool,
) -> Array:
    """``left``^T Hessian ``right`` per hinge (H,) for directions (4, 3, H)."""
    xp = namespace(position)
    if definite:
        hinge = _hinge(position)
        turns = xp.sum(hinge.gradient * left, axis=(0, 1)) * xp.sum(hinge.gradient * right, axis=(0, 1))
        return bending_j * weight * _turn_stiffness(hinge, rest, definite) * turns
    hessian = bending_hessian(position, weight, bending_j, rest, definite=False)
    left, right = xp.reshape(left, (12, 1, -1)), xp.reshape(right, (1, 12, -1))
    return xp.sum(left * hessian * right, axis=(0, 1))


def _turn_stiffness(hinge: _Hinge, rest: Array | float, definite: bool) -> Array:
    """Second derivative (H,) of 4 (1 - cos(t / 2)) by t, the turn from rest; never negative if ``definite``."""
    xp = namespace(hinge.angle)
    curvature = xp.cos(0.5 * (hinge.angle - rest))
    # Beyond half a turn from rest, which only a hinge with an angle at rest can reach, the energy is concave.
    return xp.where(curvature > 0.0, curvature, 0.0 * curvature) if definite else curvature


def _angle_hessian(hinge: _Hinge) -> Array:
    """Second derivative (12, 12, H) of the angle: d(c_i n / q) = n / q dc_i + c_i (I - 2 n n^T / q) dn / q."""
    xp = namespace(hinge.angle)
    u, length = hinge.edge, hinge.length
    zero = xp.zeros_like(u)
    total = None
    for side, third in ((0, 2), (1, 3)):
        arm, n, q, c = hinge.arms[side], hinge.normals[side], hinge.squares[side], hinge.factors[side]
        height = (arm - _dot(arm, u) * u) / length
        # dc (corner, by corner, 3, H): c_0 = |e| - arm.u, c_1 = arm.u, c_third = -|e|, u = e / |e|
        slope = {
            (0, 0): height, (0, 1): u - height, (0, third): -u,
            (1, 0): -u - height, (1, 1): height, (1, third): u,
            (third, 0): u, (third, 1): -u,
        }  # fmt: skip
        dc = xp.stack([xp.stack([slope.get((i, j), zero) for j in range(4)], axis=0) for i in range(4)], axis=0)
        # dn = cross(opposite edge, dx) for each corner of the triangle, reversed on the second side
        sign = 1.0 if side == 0 else -1.0
        opposite = {0: sign * (arm - length * u), 1: -sign * arm, third: sign * length * u}
        turned = xp.stack([_mirrored_cross(opposite[j], n, q) if j in opposite else _no_turn(n) for j in range(4)])
        part = (n / q)[None, :, None, None] * dc[:, None] + c[:, None, None, None] * xp.permute_dims(
            turned, (1, 0, 2, 3)
        )
        total = part if total is None else total + part
    return xp.reshape(total, (12, 12, -1))


def _no_turn(n: Array) -> Array:
    return namespace(n).zeros_like(n[:, None] * n[None])


def _mirrored_cross(edge: Array, n: Array, q: Array) -> Array:
    """(I - 2 n n^T / q) [edge]x / q as (3, 3, H)."""
    xp = namespace(edge)
    zero = xp.zeros_like(edge[0])
    skew = xp.stack(
        [
            xp.stack([zero, -edge[2], edge[1]], axis=0),
            xp.stack([edge[2], zero, -edge[0]], axis=0),
            xp.stack([-edge[1], edge[0], zero], axis=0),
        ],
        axis=0,
    )
    along = xp.sum(n[:, None] * skew, axis=0)
    return (skew - 2.0 * (n / q)[:, None] * along[None]) / q


def _cross(a: Array, b: Array) -> Array:
    xp = namespace(a)
    rows = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    return xp.stack(rows, axis=0)


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
