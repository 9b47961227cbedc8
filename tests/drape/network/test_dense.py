"""Layers of the network in kernels: the sums that numpy gives, of any number of blocks of patches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.kernels.lanes import LANES
from drape.network.dense import Rows, body_layer, layer, run_body_layer, run_layer

SLOPE = 0.01
ROUNDING = 1e-5  # of sums of thirty numbers of size one


def bent(x: np.ndarray, slope: float) -> np.ndarray:
    return np.where(x > 0.0, x, slope * x)


@pytest.mark.parametrize("blocks", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("outputs", [8, 6])  # the latter are filled up to eight
@pytest.mark.parametrize("added", [False, True])
def test_a_layer_of_patches(blocks: int, outputs: int, added: bool):
    draw = np.random.default_rng(0)
    weight, bias = draw.normal(size=(outputs, 30)).astype(np.float32), draw.normal(size=outputs).astype(np.float32)
    x = draw.normal(size=(blocks, 33, LANES)).astype(np.float32)  # inputs are rows 3 to 33 of each block
    more = draw.normal(size=(blocks, 8, LANES)).astype(np.float32)
    found = np.zeros((blocks, 10, LANES), np.float32)
    given = Rows(more.reshape(-1) if added else np.empty(0, np.float32), 8, 0)
    run_layer(layer(weight, bias, SLOPE), Rows(x.reshape(-1), 33, 3), given, Rows(found.reshape(-1), 10, 1))
    sums = np.einsum("nk,bkl->bnl", weight.astype(np.float64), x[:, 3:]) + bias[:, None]
    want = bent(sums + (more[:, :outputs] if added else 0.0), SLOPE)
    assert_allclose(found[:, 1 : 1 + outputs], want, rtol=0, atol=ROUNDING)
    assert not found[:, 0].any() and not found[:, 9].any(), "nothing beside the outputs is written"


@pytest.mark.parametrize("inputs", [30, 31])
def test_a_layer_of_a_body(inputs: int):
    draw = np.random.default_rng(1)
    weight, bias = draw.normal(size=(20, inputs)).astype(np.float32), draw.normal(size=20).astype(np.float32)
    x, found = draw.normal(size=inputs).astype(np.float32), np.empty(32, np.float32)
    run_body_layer(body_layer(weight, bias), x, np.float32(SLOPE), found)
    assert_allclose(found[:20], bent(weight.astype(np.float64) @ x + bias, SLOPE), rtol=0, atol=ROUNDING)
    run_body_layer(body_layer(weight), x, np.float32(1.0), found)
    assert_allclose(found[:20], weight.astype(np.float64) @ x, rtol=0, atol=ROUNDING)
