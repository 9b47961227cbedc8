"""The recurrent encoder: seconds instead of frames, no motion without motion, and rest in finite time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from tests.training.training_setup import TINY
from training.recurrent import REFERENCE_DT_S, CalmingGRU, DynamicEncoder, MotionScale, pendulums, root_mean_square

NEVER_S = 1e9


def cell(size: int = 24, *, decay_s: float = 0.5, rest_s: float = 1.8, wild: float = 0.0) -> CalmingGRU:
    """A cell in float64; ``wild`` large weights would keep an ordinary one going for ever."""
    torch.manual_seed(4)
    made = CalmingGRU(8, size, decay_s=decay_s, rest_s=rest_s).double()
    with torch.no_grad():
        made.weight_hh.add_(wild * torch.randn(made.weight_hh.shape, dtype=torch.float64))
    return made


def steps(count: int, dt_s: float = REFERENCE_DT_S) -> torch.Tensor:
    return torch.full((count,), dt_s, dtype=torch.float64)


def test_without_calming_a_step_is_that_of_torchs_cell():
    ours = cell(decay_s=NEVER_S, rest_s=40.0 * NEVER_S)
    theirs = torch.nn.GRUCell(8, 24, bias=False).double()
    theirs.load_state_dict({"weight_ih": ours.weight_ih.detach(), "weight_hh": ours.weight_hh.detach()})
    # Inputs this large leave the limit of the size out of play.
    x, state = 6.0 * torch.randn(5, 8, dtype=torch.float64), torch.rand(5, 24, dtype=torch.float64) - 0.5
    assert_allclose(ours(x, state, steps(5)).detach(), theirs(x, state).detach(), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("dt_s", [1 / 90, 1 / 30, 0.11])
def test_a_state_without_input_rests_in_time_whatever_the_weights(dtype, dt_s):
    ours = cell(wild=1.0).to(dtype)
    plain = torch.nn.GRUCell(8, 24, bias=False).to(dtype)
    plain.load_state_dict({"weight_ih": ours.weight_ih.detach(), "weight_hh": ours.weight_hh.detach()})
    state = torch.rand(6, 24, dtype=dtype) * 2.0 - 1.0
    restless, none, dt = state.clone(), torch.zeros(6, 8, dtype=dtype), torch.full((6,), dt_s, dtype=dtype)
    first = root_mean_square(state)
    elapsed = 0.0
    with torch.no_grad():
        while elapsed < 1.8:
            state, restless = ours(none, state, dt), plain(none, restless)
            elapsed += dt_s
            bound = torch.clamp((first + ours.offset) * np.exp(-elapsed / 0.5) - ours.offset, min=0.0)
            assert bool((root_mean_square(state) <= bound + 1e-6).all())
    assert bool((state == 0.0).all())
    assert float(root_mean_square(restless).min()) > 0.1, "the weights must be such that this means something"


def test_sizes_never_pass_one():
    ours = cell(wild=1.0)
    state = torch.zeros(4, 24, dtype=torch.float64)
    with torch.no_grad():
        for _ in range(60):
            state = ours(20.0 * torch.randn(4, 8, dtype=torch.float64), state, steps(4))
            assert float(state.abs().max()) <= 1.0


def test_small_states_swing_as_pendulums():
    size = 6
    ours = cell(size, decay_s=NEVER_S, rest_s=40.0 * NEVER_S)
    with torch.no_grad():
        ours.weight_hh[: 2 * size] = 0.0  # gates at one half, as of a small state
    weights = pendulums(size)
    # A pair turns by w dt per step: cos from the diagonal, sin from beside it.
    angle = torch.asin(weights[3:, :3].diagonal() / 4.0).double()
    hertz = angle / (2.0 * np.pi * REFERENCE_DT_S)
    assert_allclose(hertz, np.geomspace(0.4, 4.0, 3), rtol=1e-4, atol=0)
    state = torch.zeros(1, size, dtype=torch.float64)
    state[0, :3] = 1e-4
    with torch.no_grad():
        for step in range(1, 20):
            state = ours(torch.zeros(1, 8, dtype=torch.float64), state, steps(1))
            assert_allclose(state[0, :3], 1e-4 * torch.cos(step * angle), rtol=0, atol=2e-9 * step)
            assert_allclose(state[0, 3:], 1e-4 * torch.sin(step * angle), rtol=0, atol=2e-9 * step)


def test_time_counts_and_not_frames():
    ours = cell()
    x, state = torch.randn(3, 8, dtype=torch.float64), 0.5 * torch.randn(3, 24, dtype=torch.float64)
    with torch.no_grad():

        def after(parts: int, span_s: float) -> torch.Tensor:
            s = state
            for _ in range(parts):
                s = ours(x, s, steps(3, span_s / parts))
            return s

        change = float((after(1, REFERENCE_DT_S) - state).abs().max())
        assert float((after(1, REFERENCE_DT_S) - after(2, REFERENCE_DT_S)).abs().max()) < 0.35 * change
        # Cutting steps in half halves what a step is off: the recurrence has a limit in continuous time.
        off = [float((after(n, 0.1) - after(256, 0.1)).abs().max()) for n in (16, 32)]
        assert 1.6 < off[0] / off[1] < 2.6
        assert float((after(1, 0.0) - state).abs().max()) < 1e-12


def test_gradients_are_those_of_finite_differences_and_finite_at_rest():
    ours = cell(6)
    x = torch.randn(2, 8, dtype=torch.float64, requires_grad=True)
    state = (0.3 * torch.randn(2, 6, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda a, b: ours(a, b, steps(2)), (x, state))
    still = torch.zeros(2, 6, dtype=torch.float64, requires_grad=True)
    nothing = torch.zeros(2, 8, dtype=torch.float64, requires_grad=True)
    ours(nothing, still, steps(2)).sum().backward()
    assert still.grad is not None and nothing.grad is not None
    assert bool(torch.isfinite(still.grad).all()) and bool(torch.isfinite(nothing.grad).all())


def test_a_still_body_has_no_code_and_a_moving_one_is_followed():
    torch.manual_seed(2)
    encoder = DynamicEncoder(replace(TINY, state_size=12, motion_hidden=16))
    still = torch.zeros(2, 24, TINY.dynamic_feature_count)
    dt = torch.full((2,), REFERENCE_DT_S)
    with torch.no_grad():
        code, state = encoder(still, torch.zeros(2, 12), dt)
        assert bool((code == 0.0).all()) and bool((state == 0.0).all())
        code, state = encoder(torch.randn(2, 24, TINY.dynamic_feature_count), state, dt)
        assert float(state.abs().max()) > 1e-2 and float(code.abs().max()) > 0.0
        code, state = encoder(still, state, dt)
        assert float(state.abs().max()) > 1e-2, "the cloth must go on swinging after a stop"


def test_bodies_do_not_see_each_other():
    torch.manual_seed(3)
    encoder = DynamicEncoder(replace(TINY, state_size=12, motion_hidden=16)).double()
    features, state, dt = torch.randn(5, 24, 12), torch.rand(5, 12) - 0.5, torch.rand(5) * 0.05
    features, state, dt = features.double(), state.double(), dt.double()
    code, after = encoder(features, state, dt)
    for i in range(5):
        alone = encoder(features[i : i + 1], state[i : i + 1], dt[i : i + 1])
        assert_allclose(alone[0][0].detach(), code[i].detach(), rtol=0, atol=1e-12)
        assert_allclose(alone[1][0].detach(), after[i].detach(), rtol=0, atol=1e-12)


def test_motion_is_scaled_about_zero_and_bounded():
    scale = MotionScale(12)
    generator = torch.Generator().manual_seed(0)
    sizes = torch.linspace(1.0, 30.0, 12)
    samples = torch.randn(4000, 24, 12, generator=generator) * sizes + sizes
    samples[:, 5] = 0.0
    scale.set_from(samples)
    assert_allclose(scale(samples).square().mean(dim=0)[:5].sqrt(), np.ones((5, 12)), rtol=5e-2, atol=0)
    assert bool((scale(torch.zeros(1, 24, 12)) == 0.0).all())
    assert torch.equal(scale(-samples), -scale(samples))
    assert float(scale(1e9 * samples).abs().max()) == 10.0
    tiny = scale(torch.full((1, 24, 12), 0.1))  # a joint that never moved in training is not blown up
    assert_allclose(tiny[0, 5], [1.0] * 9 + [0.2] * 3, rtol=1e-6, atol=0)
