"""The loop: it learns, it resumes bit for bit, it survives a step that is not finite."""

from __future__ import annotations

import copy
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from drape.errors import ArtifactError, InputError
from tests.training.training_setup import CPU, TINY_RUN, bank, check_no_step_is_taken, resumes_bit_for_bit
from training import checkpoint
from training.run import Trainer, train

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trainer() -> Trainer:
    torch.set_num_threads(1)
    return Trainer(TINY_RUN, bank(), device=CPU)


def loss_on_the_same_poses(trainer: Trainer) -> float:
    """Mean loss of batches that are the same at every call; the trainer is as before afterwards."""
    state = copy.deepcopy(trainer.state())
    trainer.rng = np.random.default_rng(0)
    trainer.generator.manual_seed(0)
    trainer.rate_factor = 0.0
    losses = [trainer.step()["loss"] for _ in range(24)]
    trainer.restore(state)
    return float(np.mean(losses))


@pytest.mark.long
def test_training_lowers_the_energy(trainer: Trainer):
    first = loss_on_the_same_poses(trainer)
    for _ in range(150):
        trainer.step()
    assert loss_on_the_same_poses(trainer) < 0.8 * first


def test_lost_area_counts_by_its_weight(trainer: Trainer, monkeypatch):
    state, found = copy.deepcopy(trainer.state()), []
    for weight in (0.0, 100.0):
        monkeypatch.setattr(trainer, "config", replace(TINY_RUN, area_weight=weight))
        trainer.restore(copy.deepcopy(state))
        found.append(trainer.objective())
    lost = float(found[1].parts["lost_area_pct"]) / 100.0
    assert lost > 0.0
    assert float(found[1].loss - found[0].loss) == pytest.approx(100.0 * lost**2, rel=1e-3)
    assert "lost_area_pct" not in found[0].parts


def test_smooth_steps_come_as_often_as_asked_and_pay_for_the_second_difference(trainer: Trainer, monkeypatch):
    state, found = copy.deepcopy(trainer.state()), []
    for share, weight in ((1.0, 0.0), (1.0, 1e7), (0.0, 0.0)):
        monkeypatch.setattr(trainer, "config", replace(TINY_RUN, smooth_share=share, smooth_weight=weight))
        trainer.restore(copy.deepcopy(state))
        found.append(trainer.objective())
    bend = float(found[0].parts["second_difference_mm"]) * 1e-3
    assert bend > 0.0
    assert float(found[1].loss - found[0].loss) == pytest.approx(1e7 * bend**2, rel=1e-3)
    assert "second_difference_mm" not in found[2].parts

    monkeypatch.setattr(trainer, "config", replace(TINY_RUN, smooth_share=0.25))
    often = []
    for trainer.step_count in range(400):
        often.append(trainer._smooth())
    assert np.mean(often) == pytest.approx(0.25, abs=0.07)
    trainer.restore(state)


def test_a_step_takes_subnormal_numbers_as_zero(trainer: Trainer, monkeypatch):
    objective, found = trainer.objective, []

    def looking():
        found.append(float(torch.tensor(1e-30) * 1e-10))
        return objective()

    state = copy.deepcopy(trainer.state())
    monkeypatch.setattr(trainer, "objective", looking)
    trainer.step()
    trainer.restore(state)
    assert found == [0.0] and float(torch.tensor(1e-30) * 1e-10) > 0.0


@pytest.mark.long
def test_so_do_all_threads_of_torch_in_a_run():
    script = """
import sys, torch
from training import run
def look(arguments):
    torch.set_num_threads(2)
    print(int((torch.full((1_000_000,), 1e-30) * 1e-10 != 0.0).sum()))
run._run = look
sys.argv = ["run"]
run.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0"


def test_a_resumed_run_continues_bit_for_bit(trainer: Trainer, tmp_path):
    assert resumes_bit_for_bit(trainer, TINY_RUN, tmp_path)


def test_a_step_that_is_not_finite_is_not_taken(trainer: Trainer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(trainer, "fabrics", None)  # or the step draws another cloth
    check_no_step_is_taken(trainer, replace(trainer.material, warp_n_per_m=1e38))


def test_a_run_that_never_is_finite_stops_with_a_sentence(trainer: Trainer, tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(trainer, "fabrics", None)  # or the step draws another cloth
    state, hidden, used = trainer.state(), trainer.material, trainer.elapsed_s
    try:
        trainer.material = replace(hidden, warp_n_per_m=1e38)
        with pytest.raises(InputError, match="Lower learning_rate"):
            train(trainer, tmp_path)
        assert trainer.rate_factor < 0.02
    finally:
        trainer.material, trainer.halvings = hidden, 0
        trainer.restore(state)
        trainer.elapsed_s = used


def test_rate_warms_up_then_falls(trainer: Trainer):
    step, used = trainer.step_count, trainer.elapsed_s
    try:
        trainer.step_count, trainer.elapsed_s = 0, 0.0
        start = trainer.rate()
        trainer.step_count = 100
        top = trainer.rate()
        trainer.elapsed_s = 60.0 * TINY_RUN.minutes
        end = trainer.rate()
    finally:
        trainer.step_count, trainer.elapsed_s = step, used
    assert start < top
    assert end == pytest.approx(TINY_RUN.final_rate, rel=1e-6)


def test_a_damaged_checkpoint_is_refused(tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes(b"not a checkpoint")
    with pytest.raises(ArtifactError, match="checkpoint"):
        checkpoint.load_checkpoint(tmp_path / "checkpoint.pt")
