"""Small real things for the tests of training: a tube of cloth round the trunk, its partition, a tiny network."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import MOTIONS_DIR
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import grain_along
from drape.contact.skin import body_skin
from drape.garment.fitting import RestGarment, rest_garment
from tests.drape.cloth import cloth_shapes
from tests.fixtures.networks import TINY
from training import checkpoint
from training.batches import BodySource, TrainingGarment, draw_partition
from training.config import DataConfig, MotionConfig, TrainConfig
from training.poses import PoseBank, read_training_clips
from training.trainer import BaseTrainer

CPU = torch.device("cpu")
JERSEY = fabric("jersey")
TINY_RUN = TrainConfig(
    model=TINY,
    data=DataConfig(garments=("shorts",), partitions=1, variants=0, fresh_steps=70),
    batch_size=2,
    warmup_steps=2,
    threads=1,
)
MOVING_RUN = replace(
    TINY_RUN,
    model=replace(TINY, dynamic=True, motion_hidden=16, state_size=16),
    motion=MotionConfig(window_frames=3, warm_up_frames=4, memory_frames=3),
    learning_rate=1e-2,
)


def resumes_bit_for_bit(trainer: BaseTrainer, config: TrainConfig, folder: Path) -> bool:
    """Whether ``trainer`` goes on from its checkpoint as it would have gone on."""
    checkpoint.save(folder / "checkpoint.pt", trainer.state(), config)
    straight, drawn = [trainer.step()["loss"] for _ in range(3)], trainer.wardrobe.seeds()
    state, found = checkpoint.load_checkpoint(folder / "checkpoint.pt")
    assert found == config
    trainer.restore(state)
    return [trainer.step()["loss"] for _ in range(3)] == straight and trainer.wardrobe.seeds() == drawn


def check_no_step_is_taken(trainer: BaseTrainer, material: Material) -> None:
    """A step with ``material``, whose loss is not finite, leaves weights and rate as they are."""
    before, rate = {name: value.clone() for name, value in trainer.model.state_dict().items()}, trainer.rate_factor
    hidden, trainer.material = trainer.material, material
    assert trainer.step() == {"skipped": 1.0}
    trainer.material = hidden
    assert trainer.rate_factor == rate
    assert all(torch.equal(value, before[name]) for name, value in trainer.model.state_dict().items())


@cache
def body() -> BodyModel:
    return load_body()


@cache
def tube() -> RestGarment:
    """A sleeveless tube round the chest, 480 vertices."""
    vertices, faces = cloth_shapes.tube(40, 11, radius_m=1.0, height_m=0.3)
    return rest_garment(vertices * [0.20, 1.0, 0.16] + [0.0, 0.1, 0.0], faces, body())


@cache
def garment() -> TrainingGarment:
    rest = tube()
    cloth = ClothMesh.from_rest(rest.vertices, rest.faces).like(torch.zeros(1))
    weights = torch.from_numpy(rest.binding.weights.astype(np.float32))
    upright = grain_along(rest.vertices, rest.faces)
    partition = draw_partition(rest, body_skin(body()), seed=3, span=(1.0, 1.0), device=CPU, warp=upright)
    return TrainingGarment("tube", rest, cloth, [partition], weights)


@cache
def source() -> BodySource:
    return BodySource(body(), device=CPU)


@cache
def bank() -> PoseBank:
    return PoseBank(read_training_clips([MOTIONS_DIR], held_out=()), TINY_RUN.data)
