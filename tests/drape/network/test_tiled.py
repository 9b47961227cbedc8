"""Weights for a processor's tiles: how numbers are split into halves."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from drape.network.tiled import GROUP, INPUTS, split, tiles_of

HALF = 2.0**-8  # what the nearest number of eight bits is off by, of a number


def halves(pairs: np.ndarray) -> np.ndarray:
    """The numbers (..., 2 n) float32 of ``pairs`` (..., n)."""
    both = np.stack([pairs << 16, pairs & np.uint32(0xFFFF0000)], axis=-1).view(np.float32)
    return both.reshape(*pairs.shape[:-1], -1)


def test_two_halves_hold_a_number_to_sixteen_bits():
    values = np.random.default_rng(0).normal(size=(5, 64)).astype(np.float32)
    high, low = (halves(pairs).astype(np.float64) for pairs in split(values))
    assert (np.abs(values - high) <= HALF * np.abs(values)).all()
    assert (np.abs(values - high - low) <= HALF**2 * np.abs(values)).all()
    assert_array_equal(halves(split(high.astype(np.float32))[0]), high)
    odd = np.array([np.inf, -np.inf, np.nan, 0.0], np.float32)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        assert_array_equal(halves(split(odd)[0]), odd)


def test_tiles_begin_with_a_line_of_the_cache_and_are_filled_up():
    tiles = tiles_of(np.ones((GROUP + 1, INPUTS + 1), np.float32))
    assert tiles.ctypes.data % 64 == 0
    assert tiles.size == 2 * 2 * 4 * 256
    assert halves(tiles).sum() == (GROUP + 1) * (INPUTS + 1)
