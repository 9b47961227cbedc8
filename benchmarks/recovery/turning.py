"""Arkin's turning distance: how far the shapes of two outlines differ, whatever their place, size and orientation."""

from __future__ import annotations

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import InputError

FEWEST_CORNERS = 3
CHUNK = 2_000_000  # numbers held at once


def turning_distance(first: np.ndarray, second: np.ndarray, *, mirror: bool = True) -> float:
    """The distance [rad] of two closed outlines (M, 2) and (N, 2), first point not repeated.

    Arkin et al. (1991): the turning function is the direction of the tangent over the share of the arc length, and

        d = min over t and c of (integral over s of |T1(s + t) - T2(s) + c|^2)^(1/2).

    For a given start t the best c is the mean difference, and what remains is concave between starts where two corners
    meet, so the least of those M N starts is exact. With ``mirror`` the mirror image of ``second`` is tried too. Raises
    ``InputError`` for an outline with less than three corners or without area.
    """
    first, second = _outline("first", first), _outline("second", second)
    least = _least_square(first, second)
    if mirror:
        least = min(least, _least_square(first, _outline("second", second[::-1] * np.array([-1.0, 1.0]))))
    return float(np.sqrt(max(least, 0.0)))


def _outline(name: str, points: np.ndarray) -> np.ndarray:
    """``points`` counter-clockwise, those that repeat the one before left out."""
    points = np.asarray(points, dtype=np.float64)
    check_shape(name, points, (None, 2))
    check_finite(name, points)
    size = float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0
    points = points[np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-12 * size]
    x, y = points.T
    area = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    if len(points) < FEWEST_CORNERS or abs(area) <= 1e-12 * size**2:
        raise InputError(
            f"{name} outline",
            expected=f"a polygon of at least {FEWEST_CORNERS} corners that bounds an area",
            got=f"{len(points)} corners, {area:.1e} m^2",
            cure="Pass the outline of a panel (recovery.pattern.geometry.outline).",
        )
    return points if area > 0.0 else points[::-1]


def _steps(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The turning function: it is ``value`` (N,) [rad] from ``start`` (N,) in [0, 1) to the next start."""
    sides = np.roll(points, -1, axis=0) - points
    lengths = np.linalg.norm(sides, axis=1)
    before = np.roll(sides, 1, axis=0)
    turn = np.arctan2(before[:, 0] * sides[:, 1] - before[:, 1] * sides[:, 0], (before * sides).sum(axis=1))
    start = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / lengths.sum()
    return start, np.cumsum(turn) - turn[0]


def _least_square(first: np.ndarray, second: np.ndarray) -> float:
    """The least variance [rad^2] over s of T1(s + t) - T2(s), over all starts t."""
    (starts1, values1), (starts2, values2) = _steps(first), _steps(second)
    shifts = (starts1[:, None] - starts2[None, :]).reshape(-1) % 1.0
    size = len(starts1) + len(starts2)
    least = np.inf
    for chunk in np.array_split(shifts, max(1, len(shifts) * size // CHUNK)):
        cuts = np.sort(
            np.concatenate(
                [(starts1[None, :] - chunk[:, None]) % 1.0, np.broadcast_to(starts2, (len(chunk), len(starts2)))],
                axis=1,
            ),
            axis=1,
        )
        ends = np.concatenate([cuts[:, 1:], np.ones((len(chunk), 1))], axis=1)  # the first cut is 0, second's start
        widths, middles = ends - cuts, 0.5 * (cuts + ends)
        there = middles + chunk[:, None]
        turns = np.floor(there)
        gap = values1[np.searchsorted(starts1, there - turns, side="right") - 1] + 2.0 * np.pi * turns
        gap = gap - values2[np.searchsorted(starts2, middles, side="right") - 1]
        mean = (widths * gap).sum(axis=1, keepdims=True)
        least = min(least, float((widths * (gap - mean) ** 2).sum(axis=1).min()))
    return least
