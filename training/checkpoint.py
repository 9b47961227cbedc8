"""Checkpoints: weights, optimiser, random states and configuration in one file, replaced atomically."""

from __future__ import annotations

import pickle
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from drape.errors import ArtifactError
from drape.files.atomic import whole_file
from training.config import DataConfig, ModelConfig, MotionConfig, TrainConfig


def save(path: Path, payload: dict[str, Any], config: TrainConfig) -> None:
    """Writes ``payload`` with ``config``; a crash leaves the file before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        torch.save(payload | {"config": asdict(config)}, file)


def load(path: Path) -> tuple[dict[str, Any], TrainConfig]:
    """The payload at ``path`` and its configuration; only tensors and plain values are read."""
    try:
        payload = torch.load(path, map_location="cpu", weights_only=True)
        config = config_from(payload.pop("config"))
    except (OSError, RuntimeError, KeyError, TypeError, EOFError, pickle.UnpicklingError) as error:
        raise ArtifactError(
            f"checkpoint {path.name}",
            expected="a checkpoint of this program",
            got=str(error),
            cure="Train again or restore the file.",
        ) from error
    return payload, config


def config_from(data: dict[str, Any]) -> TrainConfig:
    """The configuration from its dictionary form; lists become tuples again."""

    data = dict(data)
    data.pop("compile", None)  # checkpoints from before it was dropped have it
    model, drawn = model_config_from(data.pop("model")), _tuples(data.pop("data"))
    if "patch_jitter" in drawn:  # as above: patch counts varied by this share
        share = drawn.pop("patch_jitter")
        drawn["patch_range"] = (1.0 - share, 1.0 + share)
    inputs = DataConfig(**drawn)
    motion = MotionConfig(**_tuples(data.pop("motion", {})))  # checkpoints from before it was there have none
    return TrainConfig(model=model, data=inputs, motion=motion, **_tuples(data))


def model_config_from(data: dict[str, Any]) -> ModelConfig:
    """The sizes of a network from their dictionary form."""
    return ModelConfig(**{"fabric": False, **_tuples(data)})  # networks from before fabrics do not name it


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
