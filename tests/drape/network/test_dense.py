"""Layers of the network in kernels: the sums that numpy gives, of any number of blocks of patches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.kernels.lanes import LANES
from drape.network.dense import Layer, Rows, body_layer, layer, run_body_layer, run_layer

SLOPE = 0.01
ROUNDING = 1e-5  # of sums of thirty numbers of size one
SPLIT = 3.0 * 2.0**-16  # of the products: what their sums lack by tiles (``drape.network.tiled``)


def bent(x: np.ndarray, slope: float) -> np.ndarray:
    return np.where(x > 0.0, x, slope * x)


def without_tiles(made: Layer) -> Layer:
    return made._replace(tiles=np.empty(0, np.uint32))


@pytest.mark.parametrize("blocks", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("outputs", [8, 6, 40])  # six are filled up to eight; forty are two groups of tiles
@pytest.mark.parametrize("added", [False, True])
def test_a_layer_of_patches(blocks: int, outputs: int, added: bool):
    draw = np.random.default_rng(0)
    weight, bias = draw.normal(size=(outputs, 30)).astype(np.float32), draw.normal(size=outputs).astype(np.float32)
    x = draw.normal(size=(blocks, 33, LANES)).astype(np.float32)  # inputs are rows 3 to 33 of each block
    more = draw.normal(size=(blocks, 40, LANES)).astype(np.float32)
    given = Rows(more.reshape(-1) if added else np.empty(0, np.float32), 40, 0)
    sums = np.einsum("nk,bkl->bnl", weight.astype(np.float64), x[:, 3:]) + bias[:, None]
    want, filled = bent(sums + (more[:, :outputs] if added else 0.0), SLOPE), outputs + -outputs % 8
    largest = np.einsum("nk,bkl->bnl", np.abs(weight), np.abs(x[:, 3:])).max()
    made = layer(weight, bias, SLOPE)
    for one, within in ((without_tiles(made), ROUNDING), (made, ROUNDING + SPLIT * largest)):
        found = np.zeros((blocks, filled + 2, LANES), np.float32)
        run_layer(one, Rows(x.reshape(-1), 33, 3), given, Rows(found.reshape(-1), filled + 2, 1))
        assert_allclose(found[:, 1 : 1 + outputs], want, rtol=0, atol=within)
        assert not found[:, 0].any() and not found[:, -1].any(), "nothing beside the outputs is written"


def test_a_layer_may_write_what_it_adds_to():
    draw = np.random.default_rng(3)
    made, x = (
        layer(draw.normal(size=(8, 40)).astype(np.float32), np.zeros(8, np.float32)),
        draw.normal(size=(2, 40, 16)),
    )
    inputs, given = Rows(x.astype(np.float32).reshape(-1), 40, 0), draw.normal(size=2 * 8 * 16).astype(np.float32)
    for one in (made, without_tiles(made)):
        apart, within = np.empty_like(given), given.copy()
        run_layer(one, inputs, Rows(given, 8, 0), Rows(apart, 8, 0))
        run_layer(one, inputs, Rows(within, 8, 0), Rows(within, 8, 0))
        assert_array_equal(within, apart)


def test_what_is_no_number_is_none_in_tiles():
    made, found = layer(np.ones((8, 2), np.float32), np.zeros(8, np.float32)), np.zeros(8 * LANES, np.float32)
    x = np.zeros((2, LANES), np.float32)
    x[0, 3], x[1, 5] = np.nan, np.inf
    run_layer(made, Rows(x.reshape(-1), 2, 0), Rows(np.empty(0, np.float32), 1, 0), Rows(found, 8, 0))
    assert_array_equal(np.isfinite(found.reshape(8, LANES)[0]), np.isfinite(x).all(axis=0))


@pytest.mark.parametrize("inputs", [30, 31])
def test_a_layer_of_a_body(inputs: int):
    draw = np.random.default_rng(1)
    weight, bias = draw.normal(size=(20, inputs)).astype(np.float32), draw.normal(size=20).astype(np.float32)
    x, found = draw.normal(size=inputs).astype(np.float32), np.empty(32, np.float32)
    run_body_layer(body_layer(weight, bias), x, np.float32(SLOPE), found)
    assert_allclose(found[:20], bent(weight.astype(np.float64) @ x + bias, SLOPE), rtol=0, atol=ROUNDING)
    run_body_layer(body_layer(weight), x, np.float32(1.0), found)
    assert_allclose(found[:20], weight.astype(np.float64) @ x, rtol=0, atol=ROUNDING)
