"""A step of training makes all that it needs on the device of its weights: torch's device "meta" refuses all others."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from drape.catalog import MOTIONS_DIR
from training import chart_consensus, losses
from training.config import PRESETS
from training.poses import PoseBank, read_training_clips
from training.starting import with_garments
from training.trainer import Trainer

META = torch.device("meta")


@pytest.fixture
def trainer(monkeypatch: pytest.MonkeyPatch) -> Trainer:
    # Two things have no meta: sparse matrices, and the places of vertices that the search of contacts reads.
    monkeypatch.setattr(chart_consensus, "_csr", lambda matrix, device: torch.zeros(matrix.shape, device=device))
    found = losses.contact_planes

    def planes(vertices: torch.Tensor, batch, **options) -> losses.SampledPlanes:
        at = found(torch.zeros(vertices.shape), batch, **options)
        return losses.SampledPlanes(at.sample.to(META), at.point.to(META), at.normal.to(META))

    monkeypatch.setattr(losses, "contact_planes", planes)
    config = replace(with_garments(PRESETS["shipped"](), ["tshirt"]), batch_size=3, full_share=0.5, smooth_share=0.5)
    return Trainer(config, PoseBank(read_training_clips([MOTIONS_DIR], held_out=()), config.data), device=META)


@pytest.mark.long
def test_a_step_stays_on_its_device(trainer: Trainer):
    for trainer.step_count in range(8):  # with more and fewer corrections, poses alone and by threes
        trainer.draw_fabric()
        trainer.objective().loss.backward()
    assert all(weight.grad is None or weight.grad.device == META for weight in trainer.model.parameters())


@pytest.mark.long
def test_a_number_left_on_the_processor_is_refused(trainer: Trainer):
    trainer.model.felt_terms = trainer.model.felt_terms.new_zeros(trainer.model.felt_terms.shape, device="cpu")
    trainer.step_count = 0
    with pytest.raises(RuntimeError, match="device"):
        trainer.objective()
