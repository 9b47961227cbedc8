"""Training of the recurrent encoder: the right potential, frozen statics, bit-identical resumption, refusals."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.catalog import MOTIONS_DIR
from drape.errors import ArtifactError, InputError
from drape.motion.clip import MotionClip
from tests.training.training_setup import CPU, JERSEY, MOVING_RUN, TINY_RUN, check_no_step_is_taken, resumes_bit_for_bit
from training import checkpoint, run
from training.config import TrainConfig, dynamic
from training.dynamics import CALM_M_S2, DynamicTrainer
from training.fabrics import stretch_share
from training.onefit import OneFit
from training.poses import read_training_clips
from training.run import make_trainer
from training.starting import start_from
from training.trainer import BatchLoss, take_weights
from training.windows import HISTORY, WindowBank, Windows

RUN, MODEL, MOTION = MOVING_RUN, MOVING_RUN.model, MOVING_RUN.motion
MASS = JERSEY.density_kg_m2 / stretch_share(JERSEY)  # in the units of the loss, per area


@pytest.fixture(scope="module")
def static() -> OneFit:
    torch.manual_seed(0)
    made = OneFit(TINY_RUN.model)
    # Untrained heads hardly answer; a code could do nothing through them.
    for head in made.decoder.heads.values():
        torch.nn.init.normal_(list(head.parameters())[-2], std=0.3)
    # Nor do its static codes differ much, which are the unit of dynamic ones.
    torch.nn.init.normal_(list(made.body.parameters())[-2], std=10.0)
    return made


@pytest.fixture(scope="module")
def trainer(static: OneFit) -> DynamicTrainer:
    torch.set_num_threads(1)
    clips = read_training_clips([MOTIONS_DIR], held_out=())
    made = make_trainer(RUN, clips, device=CPU, weights=static.state_dict())
    assert isinstance(made, DynamicTrainer)
    made.fabrics = None  # one fabric, so that losses of two steps compare
    return made


def on_the_same_windows(trainer: DynamicTrainer) -> float:
    """Mean loss of windows that are the same at every call; the trainer is as before afterwards."""
    state = copy.deepcopy(trainer.state())
    trainer.rng = np.random.default_rng(0)
    trainer.generator.manual_seed(0)
    with torch.no_grad():
        losses = [float(trainer.objective().loss) for _ in range(12)]
    trainer.restore(state)
    return float(np.mean(losses))


@pytest.mark.long
def test_training_calms_a_wild_start_and_statics_stay_bit_for_bit(trainer: DynamicTrainer, static: OneFit):
    with torch.no_grad():
        trainer.encoder.out.weight.mul_(120.0)
    first = on_the_same_windows(trainer)
    begun = {name: value.clone() for name, value in trainer.model.state_dict().items()}
    for _ in range(40):
        trainer.step()
    assert on_the_same_windows(trainer) < 0.9 * first
    for name, value in trainer.model.state_dict().items():
        if not name.startswith("dynamic."):
            assert torch.equal(value, begun[name]) and torch.equal(value, static.state_dict()[name]), name
    changed = [n for n, p in trainer.encoder.named_parameters() if not torch.equal(p, begun[f"dynamic.{n}"])]
    assert len(changed) == len(list(trainer.encoder.parameters()))


def with_codes(trainer: DynamicTrainer, monkeypatch: pytest.MonkeyPatch, codes: torch.Tensor) -> BatchLoss:
    """The objective on windows that are the same at every call, whose codes are ``codes``."""
    monkeypatch.setattr(trainer, "codes", lambda windows, betas, shown: codes)
    monkeypatch.setattr(trainer, "rng", np.random.default_rng(3))
    monkeypatch.setattr(trainer, "generator", torch.Generator().manual_seed(3))
    return trainer.objective()


def test_codes_get_the_slope_of_a_frames_own_potential(trainer: DynamicTrainer, monkeypatch):
    shape = (RUN.batch_size, HISTORY + MOTION.window_frames, MODEL.body_code_size)
    codes = 0.5 * torch.randn(shape, generator=torch.Generator().manual_seed(5))
    codes.requires_grad_()
    (slope,) = torch.autograd.grad(with_codes(trainer, monkeypatch, codes).loss, codes)
    # Earlier frames are given.
    assert float(slope[:, :HISTORY].abs().max()) == 0.0
    # No frame comes after the last: its slope is that of the loss.
    way = torch.zeros(shape)
    way[:, -1] = slope[:, -1] / slope[:, -1].norm()
    step = 2e-2
    with torch.no_grad():
        up, down = (float(with_codes(trainer, monkeypatch, codes + sign * step * way).loss) for sign in (1, -1))
    assert_allclose((up - down) / (2.0 * step), float(slope[:, -1].norm()), rtol=0.05, atol=0)


def test_a_resumed_run_continues_bit_for_bit(trainer: DynamicTrainer, tmp_path):
    assert resumes_bit_for_bit(trainer, RUN, tmp_path)


def test_a_step_that_is_not_finite_is_not_taken(trainer: DynamicTrainer):
    check_no_step_is_taken(trainer, replace(trainer.material, density_kg_m2=1e38))


def falling(trainer: DynamicTrainer, acceleration: np.ndarray) -> dict[str, float]:
    """The report on a body in one pose whose root is under a constant acceleration [m/s^2], without a dynamic code."""
    time_s = np.arange(120) / 60.0
    clip = MotionClip(np.zeros((120, 24, 3)), 0.5 * time_s[:, None] ** 2 * acceleration, 60.0, "falling")
    plain = replace(MOTION, drop_share=0.0, intervals_s=(1 / 30,), speeds=(1.0, 1.0), stop_share=0.0, sway_share=0.0)
    data = replace(RUN.data, mirror_share=0.0, shape_share=0.0)
    bank, config, weights = trainer.bank, trainer.config, trainer.encoder.out.weight.detach().clone()
    try:
        trainer.bank, trainer.config = WindowBank([clip], data, plain), replace(RUN, data=data, motion=plain)
        with torch.no_grad():
            trainer.encoder.out.weight.zero_()
            return trainer.objective().report()
    finally:
        trainer.bank, trainer.config = bank, config
        with torch.no_grad():
            trainer.encoder.out.weight.copy_(weights)


def test_inertia_counts_the_way_of_the_root_through_the_world(trainer: DynamicTrainer):
    acceleration = np.array([3.0, -1.0, 2.0])
    got = falling(trainer, acceleration)["inertia"]
    # Cloth that hangs still on a body under acceleration a: m a^2 dt^2 / 2, here per area.
    want = 0.5 * MASS * (acceleration**2).sum() / 30.0**2
    assert_allclose(got, want, rtol=2e-2, atol=0)
    assert falling(trainer, np.zeros(3))["inertia"] < 1e-9


def test_gradients_reach_as_far_back_as_the_memory(trainer: DynamicTrainer, monkeypatch):
    shown = HISTORY + MOTION.window_frames
    for before in (MOTION.memory_frames, MOTION.memory_frames + 1):
        state = torch.full((2, MODEL.state_size), 0.1, requires_grad=True)
        monkeypatch.setattr(trainer, "_first_state", lambda count, state=state: state)
        windows = trainer.bank.draw(2, HISTORY + before + shown, np.random.default_rng(1))
        codes = trainer.codes(windows, np.zeros((2, 10)), shown)
        assert codes.shape == (2, shown, MODEL.body_code_size)
        (slope,) = torch.autograd.grad(codes[:, -1].sum(), state, allow_unused=True)
        if before == MOTION.memory_frames:
            assert slope is not None and float(slope.abs().max()) > 0.0
        else:
            assert slope is None


def test_some_windows_begin_with_a_state(trainer: DynamicTrainer):
    states = trainer._first_state(400)
    sizes = states.square().mean(dim=1).sqrt()
    share = float((sizes > 0.0).float().mean())
    assert abs(share - MOTION.random_state_share) < 0.1
    assert float(sizes.max()) > 0.5 and float(states.abs().max()) <= 1.0


def test_the_preset_grows_from_a_static_checkpoint(static: OneFit, tmp_path):
    data = replace(TINY_RUN.data, held_out=("walk",))
    checkpoint.save(tmp_path / "checkpoint.pt", {"model": static.state_dict()}, replace(TINY_RUN, data=data))
    config, weights = start_from(dynamic(), tmp_path / "checkpoint.pt")
    wanted = dynamic().model
    assert config.model == replace(
        TINY_RUN.model, dynamic=True, state_size=wanted.state_size, motion_hidden=wanted.motion_hidden
    )
    assert config.data.held_out == ("walk",)
    assert weights is not None and torch.equal(weights["decoder.from_body.weight"], static.decoder.from_body.weight)
    assert start_from(TrainConfig(), None) == (TrainConfig(), None)


@pytest.mark.parametrize(("preset", "start"), [("dynamic", None), ("shipped", "checkpoint.pt")])
def test_a_start_that_does_not_fit_the_preset_is_refused(preset, start, tmp_path, monkeypatch, capsys):
    arguments = ["run", "--preset", preset, *(["--from", str(tmp_path / start)] if start else [])]
    monkeypatch.setattr("sys.argv", arguments)
    assert run.main() == 2
    assert "--from: expected" in capsys.readouterr().err
    with pytest.raises(InputError, match="--preset dynamic --from"):
        start_from(run.PRESETS[preset](), None if start is None else tmp_path / start)


@pytest.mark.parametrize("change", [{"body_code_size": 12}, {"corrections": 2}])
def test_weights_of_another_architecture_are_refused(static: OneFit, change):
    with pytest.raises(ArtifactError, match="weights to start from"):
        take_weights(OneFit(replace(MODEL, **change)), static.state_dict())


def test_a_jerk_counts_less_than_its_square(trainer: DynamicTrainer):
    """The weight of a frame under the acceleration a is 1 / sqrt(1 + (a / 2)^2), however far apart frames are."""
    dt_s = np.array([[1 / 30, 1 / 60, 1 / 20]])
    windows = Windows(np.zeros((1, 4, 24, 3)), np.zeros((1, 4, 3)), dt_s)
    for acceleration in (0.0, 2.0, 20.0):
        inertia = 0.5 * MASS * acceleration**2 * torch.from_numpy(dt_s[:, 1:] ** 2)
        want = np.full((1, 2), 1.0 / np.sqrt(1.0 + (acceleration / CALM_M_S2) ** 2))
        assert_allclose(trainer._weight(inertia, windows), want, rtol=1e-6, atol=0)


def test_a_candidate_is_judged_after_the_frames_that_were(trainer: DynamicTrainer):
    """Cloth that was 1 cm to the side for two frames and goes back in the third: m / (2 dt^2) (1 cm)^2."""
    garment, count = trainer.wardrobe.garments[0], trainer.config.batch_size
    windows = Windows(np.zeros((count, 3, 24, 3)), np.zeros((count, 3, 3)), np.full((count, 2), 1 / 30))
    still = torch.from_numpy(garment.rest.vertices).float().expand(count, -1, -1)
    aside = still + torch.tensor([0.01, 0.0, 0.0])
    history = aside.repeat_interleave(2, dim=0)
    assert_allclose(trainer._inertia(history, aside, windows, garment), np.zeros((count, 1)), rtol=0, atol=1e-9)
    got = trainer._inertia(history, aside, windows, garment, candidate=still)
    assert_allclose(got, np.full((count, 1), 0.5 * MASS * 0.01**2 * 30.0**2), rtol=1e-3, atol=0)
