"""The ablation trains with the loss it names: house is training.run's own, a term that is left out changes no other."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.papers import loss_ablation
from benchmarks.papers.loss_ablation import LOSS_SETS, PAPER_TERMS, LossTrainer
from tests.benchmarks.papers.representation_setup import bench, bent
from tests.training.training_setup import CPU, TINY, TINY_RUN, bank
from training.config import as_published
from training.trainer import Trainer

pytestmark = pytest.mark.slow
REPORTED = {"gradient_norm", "loss", "disagreement_mm"}


@pytest.fixture(scope="module")
def trainer() -> LossTrainer:
    torch.set_num_threads(1)
    return LossTrainer(TINY_RUN, bank(), LOSS_SETS["house"], device=CPU)


def terms(trainer: LossTrainer, name: str) -> dict[str, float]:
    """The weighted terms of the first step with another set of losses; the trainer is as before afterwards."""
    state = copy.deepcopy(trainer.state())
    trainer.chosen, trainer.rate_factor = LOSS_SETS[name], 0.0
    found = trainer.step()
    trainer.restore(state)
    assert found["gradient_norm"] > 0.0
    return {key: value for key, value in found.items() if key not in REPORTED}


def test_house_is_the_loss_of_training(trainer: LossTrainer):
    state, found = copy.deepcopy(trainer.state()), []
    trainer.chosen = LOSS_SETS["house"]
    for objective in (trainer.objective, lambda: Trainer.objective(trainer)):
        trainer.optimiser.zero_grad(set_to_none=True)
        loss = objective().loss
        loss.backward()
        found.append((loss.item(), [p.grad.clone() for p in trainer.model.parameters() if p.grad is not None]))
        trainer.restore(state)
    (own, own_gradients), (expected, gradients) = found
    assert own == pytest.approx(expected, rel=1e-5)
    assert len(own_gradients) == len(gradients) > 0
    for got, wanted in zip(own_gradients, gradients, strict=True):
        assert torch.allclose(got, wanted, atol=1e-5 * max(1.0, float(wanted.abs().max())))


def test_steps_stand_for_the_clock(trainer: LossTrainer):
    state = copy.deepcopy(trainer.state())
    trainer.steps, trainer.rate_factor = 4, 0.0
    for share in (0.25, 0.5):
        trainer.step(clock_s=1e9)
        assert trainer.progress() == pytest.approx(share)
    trainer.steps = None
    trainer.restore(state)


def test_a_term_left_out_changes_no_other(trainer: LossTrainer):
    full = terms(trainer, "paper")
    assert tuple(full) == PAPER_TERMS
    for term in PAPER_TERMS:
        rest = terms(trainer, f"no_{term}")
        assert rest == pytest.approx({key: value for key, value in full.items() if key != term}, rel=1e-5)


def test_the_metric_beside_the_house_energy_changes_no_other_term(trainer: LossTrainer):
    house, with_metric = terms(trainer, "house"), terms(trainer, "house_metric")
    assert set(with_metric) - set(house) == {"metric"}
    assert {key: with_metric[key] for key in house} == pytest.approx(house, rel=1e-5)


def test_a_step_that_is_not_finite_is_not_taken(trainer: LossTrainer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(trainer, "fabrics", None)  # or the step draws another cloth
    state, hidden = copy.deepcopy(trainer.state()), trainer.material
    try:
        trainer.chosen, trainer.material = LOSS_SETS["house"], replace(hidden, warp_n_per_m=1e38)
        assert trainer.step() == {"skipped": 1.0}
        assert all(torch.equal(value, state["model"][name]) for name, value in trainer.model.state_dict().items())
    finally:
        trainer.material = hidden
        trainer.restore(state)


def test_the_published_form_of_patches_trains_with_the_published_losses():
    config = replace(TINY_RUN, model=as_published(TINY))
    found = LossTrainer(config, bank(), LOSS_SETS["paper"], device=CPU).step()
    assert set(found) == {*PAPER_TERMS, *REPORTED}
    assert found["metric"] > 0.0
    assert np.isfinite(list(found.values())).all()


def test_a_finished_run_is_not_trained_again_and_a_damaged_one_is(tmp_path, capsys):
    (tmp_path / "checkpoint.pt").write_bytes(b"no checkpoint")
    first = loss_ablation.trained(LOSS_SETS["paper"], TINY_RUN, bank(), tmp_path, steps=3)
    assert "checkpoint of this program" in capsys.readouterr().out
    again = loss_ablation.trained(LOSS_SETS["paper"], TINY_RUN, bank(), tmp_path, steps=3)
    assert first.step_count == again.step_count == 3
    for name, value in again.model.state_dict().items():
        assert torch.equal(value, first.model.state_dict()[name])


def test_a_network_is_judged_by_the_product_s_measures(trainer: LossTrainer):
    row = loss_ablation.judge_network(trainer.model, bench().judge, bent(), trainer)
    trainer.model.train()
    # Untrained, the network leaves the garment near its rigid patches: strained, in one piece.
    assert 0.5 < row["edge_pct"] < 30.0
    assert 0.0 < row["chart_gap_p99_mm"] < 500.0
    parts = [row[f"{name}_j"] for name in ("membrane", "bending", "gravity", "contact")]
    assert row["energy_j"] == pytest.approx(sum(parts), rel=1e-6)


def test_runs_share_a_small_configuration():
    assert set(loss_ablation.PUBLISHED) < set(LOSS_SETS)
    config = loss_ablation.small_config(loss_ablation.main.parse(["--variant", "paper", "--minutes", "3"]))
    assert (config.model.variant, config.model.surroundings, config.minutes) == ("paper", False, 3.0)
    assert config.data.garments == ("tank",)
