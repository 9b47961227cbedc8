"""The recurrent encoder: what training computes, for networks whose sizes fill no row, and rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.network.motion import MotionEncoder, advance_encoder, motion_encoder
from tests.fixtures.networks import TINY
from training.recurrent import DynamicEncoder

CONFIG = replace(TINY, dynamic=True, motion_hidden=24, state_size=20, body_code_size=12)
ROUNDING = {np.float32: 2e-5, np.float64: 1e-6}  # float64: of the exponential's series


def made(dtype: type) -> tuple[DynamicEncoder, MotionEncoder]:
    torch.manual_seed(0)
    model = DynamicEncoder(CONFIG).to(torch.float64)
    model.scale.set_from(torch.rand(20, 24, 12).double() + 0.1)
    model.set_code_scale(torch.rand(20, 12).double())
    with torch.no_grad():
        model.out.weight.mul_(20.0)
    parameters = {f"dynamic.{name}": value.numpy().astype(dtype) for name, value in model.state_dict().items()}
    return model, motion_encoder(parameters, vars(CONFIG))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_codes_and_states_are_those_of_training(dtype: type, rng: np.random.Generator):
    model, encoder = made(dtype)
    features = 30.0 * rng.normal(size=(4, 24, 12))  # some beyond the limit
    state, dt_s = rng.uniform(-0.7, 0.7, size=(4, 20)), np.array([1 / 240, 1 / 60, 1 / 12, 1.0])
    state[0] = features[3] = 0.0
    with torch.no_grad():
        want = [each.numpy() for each in model(*map(torch.from_numpy, (features, state, dt_s)))]
    given = [np.ascontiguousarray(each, dtype) for each in (features, state, dt_s)]
    code, after = advance_encoder(encoder, *given)
    assert_allclose(code[:, :12], want[0], rtol=0, atol=ROUNDING[dtype])
    assert_allclose(after, want[1], rtol=0, atol=ROUNDING[dtype])
    for i in range(4):
        assert_array_equal(advance_encoder(encoder, *(each[i : i + 1] for each in given))[1][0], after[i])


def test_without_motion_a_state_of_zero_stays_and_gives_a_code_of_zero():
    _, encoder = made(np.float32)
    features, state = np.zeros((1, 24, 12), np.float32), np.zeros((1, 20), np.float32)
    code, after = advance_encoder(encoder, features, state, np.ones(1, np.float32))
    assert not code.any() and not after.any()
