"""Points in a grid of cubes, compiled: which of them may lie within a box is known without looking at the others.

    for i in range(first[0], last[0]):
        for j in range(first[1], last[1]):
            begin, end = column(grid, i, j, first, last)
            for entry in range(begin, end):
                point = grid.member[entry]

with ``first, last = cells_within(grid, low, high)`` goes over all points in the box from ``low`` to ``high``, and over
others that share a cell with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part

WIDEST_M = 10.0  # points farther apart than that, along an axis, are in no cell


class Grid(NamedTuple):
    """``count`` (3,) cells along the axes, ``per_m`` a metre, from the corner ``low`` [m] (3,) on.

    The points of cell c are ``member[start[c] : start[c + 1]]``, in their order; c = (i count[1] + j) count[2] + k.
    """

    start: np.ndarray
    member: np.ndarray
    low: np.ndarray
    count: np.ndarray
    per_m: float


@kernel
def grid_of(points, per_m):
    """The grid of the first three numbers of each of ``points`` [m] (N, 3 or more), cells of 1 / ``per_m``.

    It is empty if a coordinate is not finite, or if points lie ``WIDEST_M`` apart.
    """
    low, count = np.empty(3), np.zeros(3, np.int64)
    x, y, z = points[0, 0], points[0, 1], points[0, 2]
    a, b, c, finite = x, y, z, True
    for s in range(len(points)):
        p, q, r = points[s, 0], points[s, 1], points[s, 2]
        x, y, z = min(x, p), min(y, q), min(z, r)
        a, b, c = max(a, p), max(b, q), max(c, r)
        finite &= p - p + (q - q) + (r - r) == 0.0
    low[0], low[1], low[2] = x, y, z
    for axis, most in enumerate((a, b, c)):
        extent = most - low[axis]
        count[axis] = int(extent * per_m) + 1 if finite and extent < WIDEST_M else 0
    # Two cells more than there are: a cell's count stands two behind it, then its begin one behind it.
    start, member = np.zeros(count[0] * count[1] * count[2] + 2, np.int32), np.empty(len(points), np.int32)
    if len(start) > 2:
        cell, wide, deep = np.empty(len(points), np.int32), count[1], count[2]
        x, y, z = low
        for s in range(len(points)):
            i, j = int((points[s, 0] - x) * per_m), int((points[s, 1] - y) * per_m)
            own = (i * wide + j) * deep + int((points[s, 2] - z) * per_m)
            cell[s] = own
            start[own + 2] += 1
        for own in range(1, len(start) - 2):
            start[own + 1] += start[own]
        for s in range(len(points)):
            member[start[cell[s] + 1]] = s
            start[cell[s] + 1] += 1
    return Grid(start[:-1], member, low, count, per_m)


@part
def cells_within(grid, low, high):
    """The first cell along each axis that the box from ``low`` to ``high`` [m] meets, and the one after the last."""
    a, b, c = _cell(grid, low, 0), _cell(grid, low, 1), _cell(grid, low, 2)
    u, v, w = _cell(grid, high, 0) + 1, _cell(grid, high, 1) + 1, _cell(grid, high, 2) + 1
    count = grid.count
    first = (min(max(a, 0), count[0]), min(max(b, 0), count[1]), min(max(c, 0), count[2]))
    return first, (min(u, count[0]), min(v, count[1]), min(w, count[2]))


@part
def _cell(grid, point, axis):
    return int(np.floor((point[axis] - grid.low[axis]) * grid.per_m))


@part
def column(grid, i, j, first, last):
    """Where in ``grid.member`` the points of the cells (i, j) from ``first[2]`` to before ``last[2]`` begin and end."""
    row = (i * grid.count[1] + j) * grid.count[2]
    return grid.start[row + first[2]], grid.start[row + max(last[2], first[2])]
