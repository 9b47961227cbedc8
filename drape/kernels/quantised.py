"""Points in whole steps of their box, compiled: ``drape.wire.messages.quantise``, to the bit."""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.lanes import LANES, least, most, put, row_at
from drape.wire.messages import FLAT_M, STEP_COUNT

_RUN = 3 * LANES  # numbers at a time: whole points, in whole rows
_WHOLE = np.float32(1.5 * 2.0**23)  # added and taken away, it rounds a smaller number to a whole one


def quantise(positions: np.ndarray, count: int = STEP_COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps (V, 3) uint16 from 0 to ``count``, low corner (3,) and step size (3,) of finite ``positions`` (V, 3)."""
    steps, box = np.empty(positions.shape, np.uint16), np.empty((2, 3), np.float32)
    points = np.array(positions, np.float32, order="C", copy=None)
    _quantise(points.reshape(-1), np.float32(count), steps.reshape(-1), box)
    return steps, box[0], box[1]


@kernel
def _quantise(points, count, steps, box):
    whole, turned = len(points) // _RUN * _RUN, np.empty(len(points), points.dtype)
    low, high = np.empty(_RUN, points.dtype), np.empty(_RUN, points.dtype)
    for i in range(_RUN):
        low[i] = high[i] = points[i % 3]
    for first in range(0, _RUN, LANES):
        lows, highs = row_at(low, first), row_at(high, first)
        for begin in range(first, whole, _RUN):
            row = row_at(points, begin)
            lows, highs = least(lows, row), most(highs, row)
        put(low, first, lows)
        put(high, first, highs)
    for i in range(whole, len(points)):
        low[i % 3], high[i % 3] = min(low[i % 3], points[i]), max(high[i % 3], points[i])
    for axis in range(3):
        for i in range(axis, _RUN, 3):
            low[axis], high[axis] = min(low[axis], low[i]), max(high[axis], high[i])
        box[0, axis], box[1, axis] = low[axis], max((high[axis] - low[axis]) / count, points.dtype.type(FLAT_M))
    for i in range(_RUN):
        low[i], high[i] = box[0, i % 3], box[1, i % 3]
    for first in range(0, _RUN, LANES):
        lows, sizes = row_at(low, first), row_at(high, first)
        for begin in range(first, whole, _RUN):
            put(turned, begin, (row_at(points, begin) - lows) / sizes)
    for i in range(whole, len(points)):
        turned[i] = (points[i] - low[i % 3]) / high[i % 3]
    for i in range(len(points)):
        steps[i] = np.int32(turned[i] + _WHOLE - _WHOLE)
