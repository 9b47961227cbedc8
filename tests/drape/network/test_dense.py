"""Layers of the network: the sums that numpy gives, of any number of blocks of patches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.engine.calls import call
from drape.engine.library import LANES
from drape.network.dense import Layer, Rows, body_layer, layer, rows_of, run_layer

SLOPE = 0.01
ROUNDING = {np.float32: 1e-5, np.float64: 1e-13}  # of sums of thirty numbers of size one
SPLIT = 3.0 * 2.0**-16  # of the products: what their sums lack by tiles (``drape/engine/source/tiles.hpp``)
BOTH = pytest.mark.parametrize("tiles", [False, True])


def bent(x: np.ndarray, slope: float) -> np.ndarray:
    return np.where(x > 0.0, x, slope * x)


@BOTH
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("blocks", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("outputs", [8, 6, 40])  # six are filled up to eight; forty are two groups of tiles
@pytest.mark.parametrize("added", [False, True])
def test_a_layer_of_patches(blocks: int, outputs: int, added: bool, dtype: type, tiles: bool):
    draw = np.random.default_rng(0)
    weight, bias = draw.normal(size=(outputs, 30)).astype(dtype), draw.normal(size=outputs).astype(dtype)
    x = draw.normal(size=(blocks, 33, LANES)).astype(dtype)  # inputs are rows 3 to 33 of each block
    more = draw.normal(size=(blocks, 40, LANES)).astype(dtype)
    sums = np.einsum("nk,bkl->bnl", weight.astype(np.float64), x[:, 3:]) + bias[:, None]
    want, filled = bent(sums + (more[:, :outputs] if added else 0.0), SLOPE), outputs + -outputs % 8
    largest = np.einsum("nk,bkl->bnl", np.abs(weight), np.abs(x[:, 3:])).max()
    found = np.zeros((blocks, filled + 2, LANES), dtype)
    made, to = layer(weight, bias, SLOPE, tiles=tiles), Rows(found.reshape(-1), filled + 2, 1)
    run_layer(made, Rows(x.reshape(-1), 33, 3), to, Rows(more.reshape(-1), 40, 0) if added else None)
    lacking = SPLIT * largest if len(made.tiles) else 0.0
    assert_allclose(found[:, 1 : 1 + outputs], want, rtol=0, atol=ROUNDING[dtype] + lacking)
    assert not found[:, 0].any() and not found[:, -1].any(), "nothing beside the outputs is written"


@BOTH
def test_a_layer_may_write_what_it_adds_to(tiles: bool):
    draw = np.random.default_rng(3)
    made = layer(draw.normal(size=(8, 40)).astype(np.float32), np.zeros(8, np.float32), tiles=tiles)
    inputs = Rows(draw.normal(size=2 * 40 * 16).astype(np.float32), 40, 0)
    given = Rows(draw.normal(size=2 * 8 * 16).astype(np.float32), 8, 0)
    apart, within = np.empty_like(given.values), given.values.copy()
    run_layer(made, inputs, Rows(apart, 8, 0), given)
    run_layer(made, inputs, Rows(within, 8, 0), Rows(within, 8, 0))
    assert_array_equal(within, apart)


@BOTH
def test_what_is_no_number_is_none(tiles: bool):
    made = layer(np.ones((8, 2), np.float32), np.zeros(8, np.float32), tiles=tiles)
    x, found = np.zeros((2, LANES), np.float32), np.zeros(8 * LANES, np.float32)
    x[0, 3], x[1, 5] = np.nan, np.inf
    run_layer(made, Rows(x.reshape(-1), 2, 0), Rows(found, 8, 0))
    assert_array_equal(np.isfinite(found.reshape(8, LANES)[0]), np.isfinite(x).all(axis=0))


def run_body_layer(made: Layer, inputs: np.ndarray) -> np.ndarray:
    """The layer ``made`` of the numbers ``inputs`` (N, inputs) of N bodies, (N, outputs)."""
    outputs = np.empty((len(inputs), len(made.bias)), made.weight.dtype)
    call("body_layer", made.weight.dtype, made, inputs, len(inputs), outputs)
    return outputs


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("inputs", [30, 31])
def test_a_layer_of_a_body(inputs: int, dtype: type):
    draw = np.random.default_rng(1)
    weight, bias = draw.normal(size=(20, inputs)).astype(dtype), draw.normal(size=20).astype(dtype)
    x = draw.normal(size=(3, inputs)).astype(dtype)
    want = x.astype(np.float64) @ weight.T
    for made, expected in ((body_layer(weight, bias, SLOPE), bent(want + bias, SLOPE)), (body_layer(weight), want)):
        found = run_body_layer(made, x)
        assert_allclose(found[:, :20], expected, rtol=0, atol=ROUNDING[dtype])
        assert_array_equal(found[:, 20:], 0.0)
        assert_array_equal(found[1:2], run_body_layer(made, x[1:2]))


def test_rows_hold_sixteen_patches_and_the_last_one_again():
    values = np.arange(2 * 18.0).reshape(18, 2)
    rows = rows_of(values)
    assert rows.shape == (2, 2, LANES)
    assert_array_equal(rows.swapaxes(1, 2).reshape(-1, 2)[:18], values)
    assert_array_equal(rows[1, :, 2:], values[-1][:, None] + np.zeros((2, 14)))
