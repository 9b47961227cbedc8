"""A patch's points in a frame of their own.

The frame is that of the principal axes, its signs fixed by third moments, so that it turns with the points
whatever way they lie: what is decided in it is decided for every orientation of the patch.
"""

from __future__ import annotations

from dataclasses import dataclass

from drape.arrays import Array, namespace


@dataclass(frozen=True)
class Canonical:
    """``points = centre + size * local @ axes^T``: local (..., n, 3), axes (..., 3, 3) in columns, size (...)."""

    local: Array
    axes: Array
    centre: Array
    size: Array


def canonical(points: Array) -> Canonical:
    """``points`` (..., n, 3) moved to their mean, scaled into the unit ball, turned to their principal axes.

    The third axis is that of least spread, towards the side from which the patch is a bowl; the first has
    positive skewness.
    """
    xp = namespace(points)
    centre = xp.mean(points, axis=-2, keepdims=True)
    moved = points - centre
    size = xp.sqrt(xp.max(xp.sum(moved * moved, axis=-1), axis=-1)) + 1e-12
    moved = moved / size[..., None, None]
    _, vectors = xp.linalg.eigh(xp.matmul(xp.moveaxis(moved, -1, -2), moved))  # spreads ascend
    u, n = vectors[..., :, 2], vectors[..., :, 0]
    along, up = xp.sum(moved * u[..., None, :], axis=-1), xp.sum(moved * n[..., None, :], axis=-1)
    radius = xp.sum(moved * moved, axis=-1)
    u = u * _sign(xp, xp.sum(along**3, axis=-1))[..., None]
    n = n * _sign(xp, xp.sum(up * radius, axis=-1))[..., None]
    axes = xp.stack([u, _cross(xp, n, u), n], axis=-1)
    return Canonical(xp.matmul(moved, axes), axes, centre[..., 0, :], size)


def _sign(xp, x: Array) -> Array:
    return xp.where(x < 0, -xp.ones_like(x), xp.ones_like(x))


def _cross(xp, a: Array, b: Array) -> Array:
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return xp.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
