"""The bending of cloth for arrays: the energy of hinges and its derivatives by their corners.

    W = k w (1 - cos(theta - theta0)),   w = l^2 / (A1 + A2)

theta is the dihedral angle of two triangles at their common edge, zero in the plane and positive where the fold points
along the normals; theta0 that at rest, k the rigidity [J], l and A length and areas at rest. Near rest it is Seung and
Nelson's (1988) k w (theta - theta0)^2 / 2, a plate of rigidity k on a mesh of equilateral triangles. The moment
grows as sin(theta - theta0): a hinge that is bent by more than 90 degrees gives way.

With e = xj - xi, a = xk - xi, b = xl - xi the normals are n1 = e x a and n2 = b x e, and n1 x n2 = -(n1 . b) e:

    cos theta = n1 . n2 / |n1| |n2|,   sin theta = -|e| n1 . b / |n1| |n2|

Written once for numpy and torch, differentiable in everything. Hinges are the last axis: ``corners`` are four arrays
(3, ..., H) of positions, i and j the ends of the edge. The engine has the same (``elements.hpp``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from drape.arrays import Array, namespace

# Added to squares of lengths [m^2] and to products of squared areas [m^8] of float64: a collapsed triangle has no
# angle, and keeps a finite gradient.
COLLAPSED = 1e-40

Corners = Sequence[Array] | Array
Vector = Sequence[Array] | Array


class Hinge(NamedTuple):
    """The geometry of H hinges, two triangles at a common edge from i to j with the third corners k and l, in the unit
    of the corners [m].

    ``cosine`` and ``sine`` (..., H) are of the dihedral angle. ``edge`` e, the two ``arms`` from i to k and l, and the
    two ``normals`` n1 = e x a and n2 = b x e, which are not of unit length, are vectors (3, ..., H). ``length`` (...,
    H) is that of the edge, ``squares`` are n1 . n1 and n2 . n2, each (..., H).
    """

    cosine: Array
    sine: Array
    edge: Vector
    arms: tuple[Vector, Vector]
    normals: tuple[Vector, Vector]
    length: Array
    squares: tuple[Array, Array]


def hinge(corners: Corners, collapsed: float = COLLAPSED) -> Hinge:
    """Returns the geometry of the hinges at ``corners``, four arrays (3, ..., H) [m]: the ends of the edge, then the
    third corners. ``collapsed`` is added to squares of lengths and of areas, so that a collapsed triangle does not
    divide by zero."""
    xp = namespace(corners[0])
    e, a, b = (xp.unstack(corners[k] - corners[0], axis=0) for k in (1, 2, 3))
    n1, n2 = _cross(e, a), _cross(b, e)
    squares = _dot(n1, n1), _dot(n2, n2)
    length = xp.sqrt(_dot(e, e) + collapsed)
    scale = 1.0 / xp.sqrt(squares[0] * squares[1] + collapsed)
    return Hinge(_dot(n1, n2) * scale, -length * _dot(n1, b) * scale, e, (a, b), (n1, n2), length, squares)


def one_minus_cosine(hinges: Hinge, cosine: Array, sine: Array) -> Array:
    """Returns 1 - cos(theta - theta0) (..., H) of ``hinges`` with the dihedral angle theta; ``cosine`` and ``sine``
    (H,) are those of the angle theta0 at rest."""
    return 1.0 - (hinges.cosine * cosine + hinges.sine * sine)


def bending_energy(corners: Corners, stiffness_j: Array, rest_rad: Array) -> Array:
    """Returns the bending energy k w (1 - cos(theta - theta0)) [J] (..., H) of the hinges at ``corners``, four arrays
    (3, ..., H) [m].

    ``stiffness_j`` [J] (H,) is k w, the rigidity times the square of the edge over both areas at rest; ``rest_rad``
    [rad] (H,) is the angle theta0 at rest.
    """
    xp = namespace(rest_rad)
    return stiffness_j * one_minus_cosine(hinge(corners), xp.cos(rest_rad), xp.sin(rest_rad))


def bending_gradient(corners: Corners, stiffness_j: Array, rest_rad: Array) -> Array:
    """Returns the gradient [N] (4, 3, H) of ``bending_energy`` by the four ``corners``. The forces on them are its
    negative."""
    found = hinge(corners)
    return stiffness_j * _turn(found, rest_rad)[1] * angle_gradient(found)


def bending_hessian(corners: Corners, stiffness_j: Array, rest_rad: Array, *, definite: bool) -> Array:
    """Returns the Hessian [N/m] (12, 12, H) of ``bending_energy`` by the coordinates of the four corners, corner by
    corner.

    ``definite``: returns a positive semidefinite one, which takes every hinge as stiff as an unbent one and leaves out
    the curvature of the angle.
    """
    xp = namespace(stiffness_j)
    edge = hinge(corners)
    slope = xp.reshape(angle_gradient(edge), (12, -1))
    if definite:
        return (stiffness_j * slope)[:, None] * slope
    cosine, sine = _turn(edge, rest_rad)
    return stiffness_j * (cosine * slope[:, None] * slope + sine * _angle_hessian(edge))


def bending_bilinear(corners: Corners, stiffness_j: Array, left: Array, right: Array) -> Array:
    """Returns ``left``^T H ``right`` (H,) of every hinge, without storing H, the definite Hessian [N/m] of
    ``bending_hessian``. ``left`` and ``right`` (4, 3, H) are displacements of the corners."""
    xp = namespace(stiffness_j)
    slope = angle_gradient(hinge(corners))
    return stiffness_j * xp.sum(slope * left, axis=(0, 1)) * xp.sum(slope * right, axis=(0, 1))


def angle_gradient(hinges: Hinge) -> Array:
    """Returns the gradient [rad/m] (4, 3, H) of the dihedral angle by the corners: the sum over both triangles of c_i n
    / n^2."""
    xp = namespace(hinges.length)
    factors = _factors(hinges)
    first, second = (
        factor[:, None] * (xp.stack(list(normal), axis=0) / (square + COLLAPSED))
        for factor, normal, square in zip(factors, hinges.normals, hinges.squares, strict=True)
    )
    return first + second


def _turn(hinges: Hinge, rest_rad: Array) -> tuple[Array, Array]:
    """Cosine and sine (H,) of theta - theta0."""
    xp = namespace(rest_rad)
    cosine, sine = xp.cos(rest_rad), xp.sin(rest_rad)
    return hinges.cosine * cosine + hinges.sine * sine, hinges.sine * cosine - hinges.cosine * sine


def _factors(hinges: Hinge) -> tuple[Array, Array]:
    """c (4, H) of both sides: |e| - arm . u, arm . u and, for the side's own wing, -|e|, with u = e / |e|."""
    xp = namespace(hinges.length)
    length = hinges.length
    zero = xp.zeros_like(length)
    along = [_dot(arm, hinges.edge) / length for arm in hinges.arms]
    return (
        xp.stack([length - along[0], along[0], -length, zero], axis=0),
        xp.stack([length - along[1], along[1], zero, -length], axis=0),
    )


def _angle_hessian(hinges: Hinge) -> Array:
    """Second derivative [1/m^2] (12, 12, H) of the angle: d(c_i n / q) = n / q dc_i + c_i (1 - 2 n n^T / q) dn / q."""
    xp = namespace(hinges.length)
    length = hinges.length
    u = xp.stack([part / length for part in hinges.edge], axis=0)
    zero = xp.zeros_like(u)
    total = 0.0
    for side, third in ((0, 2), (1, 3)):
        arm, n = (xp.stack(list(vectors[side]), axis=0) for vectors in (hinges.arms, hinges.normals))
        q, c = hinges.squares[side] + COLLAPSED, _factors(hinges)[side]
        height = (arm - _dot(arm, u) * u) / length
        # dc: the row is the corner whose c it is, the column the corner that moves
        slope = {
            (0, 0): height, (0, 1): u - height, (0, third): -u,
            (1, 0): -u - height, (1, 1): height, (1, third): u,
            (third, 0): u, (third, 1): -u,
        }  # fmt: skip
        dc = xp.stack([xp.stack([slope.get((i, j), zero) for j in range(4)], axis=0) for i in range(4)], axis=0)
        # dn = cross(opposite edge, dx) for each corner of the triangle, reversed on the second side
        sign = 1.0 if side == 0 else -1.0
        opposite = {0: sign * (arm - length * u), 1: -sign * arm, third: sign * length * u}
        turned = xp.stack([_mirrored_cross(opposite.get(j, zero), n, q) for j in range(4)], axis=0)
        part = (n / q)[None, :, None, None] * dc[:, None]
        total = total + part + c[:, None, None, None] * xp.permute_dims(turned, (1, 0, 2, 3))
    return xp.reshape(total, (12, 12, -1))


def _mirrored_cross(edge: Array, n: Array, q: Array) -> Array:
    """(1 - 2 n n^T / q) [edge]x / q as (3, 3, H)."""
    xp = namespace(edge)
    zero = xp.zeros_like(edge[0])
    rows = ((zero, -edge[2], edge[1]), (edge[2], zero, -edge[0]), (-edge[1], edge[0], zero))
    skew = xp.stack([xp.stack(row, axis=0) for row in rows], axis=0)
    along = xp.sum(n[:, None] * skew, axis=0)
    return (skew - 2.0 * (n / q)[:, None] * along[None]) / q


def _cross(a: Vector, b: Vector) -> tuple[Array, Array, Array]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
