"""Lanes that something holds for, as bits."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from drape.kernels.compiled import FAST
from drape.kernels.lane_masks import first_lane, lanes_above, lanes_before, lanes_from, other_lanes
from drape.kernels.lanes import LANES, row_at


@njit(error_model="numpy", fastmath=FAST)
def _bits(a, b):
    return lanes_above(row_at(a, 0), row_at(b, 0)), lanes_above(0.5, row_at(a, 0))


@njit(error_model="numpy", fastmath=FAST)
def _cut(bits, lane):
    return lanes_from(bits, lane), lanes_before(max(lane, 0)), other_lanes(bits), first_lane(bits)


def _of(lanes: np.ndarray) -> int:
    return sum(1 << int(lane) for lane in np.flatnonzero(lanes))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_bits_are_the_lanes_that_are_above(rng, dtype):
    a, b = rng.uniform(size=(2, LANES)).astype(dtype)
    a[4] = b[9] = np.nan
    assert _bits(a, b) == (_of(a > b), _of(a < 0.5))


@pytest.mark.parametrize("lane", [-3, 0, 5, LANES - 1, LANES])
def test_bits_are_cut_at_a_lane(rng, lane: int):
    lanes, every = rng.uniform(size=LANES) > 0.5, np.arange(LANES)
    lanes[7] = True
    wanted = (_of(lanes & (every >= lane)), _of(every < lane), _of(~lanes), int(np.flatnonzero(lanes)[0]))
    assert _cut(_of(lanes), lane) == wanted
