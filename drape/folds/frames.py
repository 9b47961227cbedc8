"""Frames of the network's surface, compiled: what a vertex is away from it is carried along in them."""

from __future__ import annotations

import numpy as np

from drape.folds.sheet import LANES
from drape.solver.compiled import kernel
from drape.solver.elements import add, at, cross, dot, scaled, sub


@kernel
def surface_frames(surface, sheet, frames):
    """Frames (P, 3, 3) of ``surface`` [m] (P, 3): rows are the normal, an edge laid into the plane, and their product.

    The edge is that of the vertex's first triangle, its longest one at rest. A vertex without an area or an edge gets
    a frame of zeros.
    """
    zero = sheet.constants.zero
    for block in range(len(sheet.fan_start) - 1):
        begin, end = sheet.fan_start[block], sheet.fan_start[block + 1]
        for lane in range(LANES):
            v = LANES * block + lane
            own, normal, edge = at(surface, v), (zero, zero, zero), (zero, zero, zero)
            for row in range(begin, end):
                j, l = sheet.fan_other[2 * LANES * row + lane], sheet.fan_other[2 * LANES * row + LANES + lane]
                first = sub(at(surface, j), own)
                normal = add(normal, cross(first, sub(at(surface, l), own)))
                if row == begin:
                    edge = first
            normal = _unit(normal, sheet.constants)
            edge = _unit(sub(edge, scaled(dot(edge, normal), normal)), sheet.constants)
            third = cross(normal, edge)
            for i in range(3):
                frames[v, 0, i], frames[v, 1, i], frames[v, 2, i] = normal[i], edge[i], third[i]


@kernel
def _unit(a, k):
    square = dot(a, a)
    share = k.one / np.sqrt(square) if square > k.zero else k.zero
    return scaled(share, a)


@kernel
def in_frame(frames, v, a):
    """The world vector ``a`` in the frame of v."""
    return (
        frames[v, 0, 0] * a[0] + frames[v, 0, 1] * a[1] + frames[v, 0, 2] * a[2],
        frames[v, 1, 0] * a[0] + frames[v, 1, 1] * a[1] + frames[v, 1, 2] * a[2],
        frames[v, 2, 0] * a[0] + frames[v, 2, 1] * a[1] + frames[v, 2, 2] * a[2],
    )


@kernel
def in_world(frames, v, a):
    """What is ``a`` in the frame of v, in world axes."""
    return (
        frames[v, 0, 0] * a[0] + frames[v, 1, 0] * a[1] + frames[v, 2, 0] * a[2],
        frames[v, 0, 1] * a[0] + frames[v, 1, 1] * a[1] + frames[v, 2, 1] * a[2],
        frames[v, 0, 2] * a[0] + frames[v, 1, 2] * a[1] + frames[v, 2, 2] * a[2],
    )


@kernel
def mend(off, sheet, most):
    """Gives vectors ``off`` (P, 3) that differ by more than ``most`` from the mean of their neighbours' that mean.

    Where a surface folds over its frames turn about from one frame to the next, and what they carry with them.
    """
    k, before = sheet.constants, off.copy()
    for block in range(len(sheet.fan_start) - 1):
        begin, end = sheet.fan_start[block], sheet.fan_start[block + 1]
        for lane in range(LANES):
            v = LANES * block + lane
            mean, count = (k.zero, k.zero, k.zero), k.zero
            for row in range(2 * begin, 2 * end):
                j = sheet.fan_other[LANES * row + lane]
                if j != v:
                    mean, count = add(mean, at(before, j)), count + k.one
            if count > k.zero:
                mean = scaled(k.one / count, mean)
                way = sub(at(before, v), mean)
                if dot(way, way) > most * most:
                    off[v, 0], off[v, 1], off[v, 2] = mean[0], mean[1], mean[2]
