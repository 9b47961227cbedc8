"""Colliders of a scene, all of them rounded boxes: what cloth does not pass through, beside bodies.

A row (``ROW``,) holds the centre c [m], three axes of unit length, half the size h [m] along each, and a radius r [m].
With q = |axes (x - c)| - h the distance of a point x is

    |max(q, 0)| + min(max q, 0) - r,

negative inside. A capsule is such a box of no width and of no depth. A plane is a face of a box that is
``2 DEEP_M`` wide, so that what is below it is solid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

CENTRE, AXES, HALF, RADIUS, ROW = 0, 3, 12, 15, 16
DEEP_M = 1e4
NONE = np.zeros((0, ROW))


def plane(normal: ArrayLike, offset_m: float) -> np.ndarray:
    """Returns the collider of all x with ``normal`` . x <= ``offset_m``; ``normal`` is scaled to length 1 first. A
    collider is a row (16,) of a rounded box: its centre [m] (3), axes (9), half sizes along these [m] (3), and radius
    [m]."""
    n = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    return _row((offset_m - DEEP_M) * n, _axes_about(n), np.full(3, DEEP_M), 0.0)


def box(centre: ArrayLike, size: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Returns the collider (16,), a row as of ``plane``, of a box around ``centre`` [m] with edges of the lengths
    ``size`` [m] (3,), turned by the rotation vector ``turn`` [rad]."""
    axes = Rotation.from_rotvec(np.asarray(turn, np.float64)).as_matrix().T
    return _row(np.asarray(centre, np.float64), axes, 0.5 * np.asarray(size, np.float64), 0.0)


def capsule(start: ArrayLike, end: ArrayLike, radius_m: float) -> np.ndarray:
    """Returns the collider (16,), a row as of ``plane``, of all points within ``radius_m`` of the segment from
    ``start`` to ``end`` [m]; a ball if these are one point."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    return _row(0.5 * (a + b), _axes_about(along), np.array([0.0, 0.5 * length, 0.0]), radius_m)


def seen_from(colliders: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns ``colliders`` (M, 16), rows as of ``plane``, in coordinates whose origin is at ``origin`` [m] (3,), with
    the same axes."""
    if not len(colliders):
        return colliders
    moved = colliders.copy()
    moved[:, CENTRE:AXES] -= origin
    return moved


def distances(colliders: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns the distance [m] (P,) of each of ``points`` [m] (P, 3) from the nearest of ``colliders`` (M, 16), rows as
    of ``plane``: negative inside one, infinite if there are none."""
    nearest = np.full(len(points), np.inf)
    for row in colliders:
        q = np.abs((points - row[CENTRE:AXES]) @ row[AXES:HALF].reshape(3, 3).T) - row[HALF:RADIUS]
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
        nearest = np.minimum(nearest, outside + np.minimum(q.max(axis=-1), 0.0) - row[RADIUS])
    return nearest


def _axes_about(along: np.ndarray) -> np.ndarray:
    """Three axes (3, 3) of unit length, a row each, of which the second is ``along``."""
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    return np.stack([across, along, np.cross(across, along)])


def _row(centre: np.ndarray, axes: np.ndarray, half: np.ndarray, radius_m: float) -> np.ndarray:
    return np.concatenate([centre, axes.reshape(-1), half, [radius_m]])
