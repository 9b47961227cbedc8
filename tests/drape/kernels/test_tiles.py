"""Tiles of a processor: how numbers are split into halves, and products where there are tiles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.kernels import tiles
from drape.kernels.compiled import kernel
from drape.kernels.lanes import LANES, row_at
from drape.kernels.tiles import (
    SHAPES,
    TILE,
    aligned,
    begin_tiles,
    end_tiles,
    has_tiles,
    put_split,
    room_for,
    split,
    tile_load,
    tile_product,
    tile_store,
    tile_zero,
)

HALF = 2.0**-8  # what the nearest number of eight bits is off by, of a number


@kernel
def put_split_rows(values, high, low):
    put_split(high, low, 0, row_at(values, 0), row_at(values, LANES))


@kernel
def product(a, b, c):
    begin_tiles(SHAPES)
    tile_zero(0)
    tile_load(1, a, 0)
    tile_load(2, b, 0)
    tile_product(0, 1, 2)
    tile_product(0, 1, 2)
    tile_store(0, c, 0)
    end_tiles()


@kernel
def begins_at(count, kind):
    return room_for(count, kind).ctypes.data


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


def test_a_kernel_splits_rows_as_numpy_does():
    values = np.random.default_rng(1).normal(size=(2, LANES)).astype(np.float32)
    high, low = np.zeros((2, LANES), np.uint32)
    put_split_rows(values.reshape(-1), high, low)
    for got, want in zip((high, low), split(values.T.reshape(-1)), strict=True):
        assert_array_equal(got, want)


def test_memory_for_tiles_begins_with_a_line_of_the_cache():
    for count in (1, 300, 5000):
        array = np.arange(count, dtype=np.uint32).reshape(1, count)
        copy = aligned(array)
        assert_array_equal(copy, array)
        assert copy.ctypes.data % 64 == 0 and begins_at(count, np.uint32) % 64 == 0


def test_a_processor_that_kernels_are_not_compiled_for_has_no_tiles(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tiles.config, "CPU_NAME", "generic")
    assert not tiles.compiles_tiles.__wrapped__()


@pytest.mark.skipif(not has_tiles(), reason="no tiles here: run the test on a processor with AMX")
def test_a_product_of_tiles_is_that_of_matrices():
    draw = np.random.default_rng(2)
    a, b = draw.normal(size=(LANES, 32)).astype(np.float32), draw.normal(size=(32, LANES)).astype(np.float32)
    left, right = split(a)[0], split(np.ascontiguousarray(b.T))[0]
    found = np.empty(TILE, np.float32)
    product(aligned(left.reshape(-1)), aligned(np.ascontiguousarray(right.T).reshape(-1)), found)
    want = 2.0 * halves(left).astype(np.float64) @ halves(right).T.astype(np.float64)
    assert_allclose(found.reshape(LANES, LANES), want, rtol=0, atol=1e-5)
