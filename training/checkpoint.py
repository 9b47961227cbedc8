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

# Parts of a network that files name one by one; its variant says which it has.
FORMER_SWITCHES = ("surroundings", "agreed_base", "closing_fit", "feels_body")


def save(path: Path, payload: dict[str, Any], config: TrainConfig) -> None:
    """Writes ``payload`` and ``config`` as the checkpoint ``path``. A crash leaves the file that was there before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        torch.save(payload | {"config": asdict(config)}, file)


def load_checkpoint(path: Path) -> tuple[dict[str, Any], TrainConfig]:
    """Returns the payload of the checkpoint ``path``, tensors and plain values by name, and its configuration.

    Raises ``ArtifactError`` where the file is no checkpoint of this program.
    """
    try:
        payload = torch.load(path, map_location="cpu", weights_only=True)
        config = config_from(payload.pop("config"))
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        raise ArtifactError(
            f"checkpoint {path.name}",
            expected="a checkpoint of this program",
            got=str(error),
            cure="Train again or restore the file.",
        ) from error
    return payload, config


def config_from(data: dict[str, Any]) -> TrainConfig:
    """Returns the configuration whose fields by name are ``data``, with tuples or lists for tuples."""
    data = dict(data)
    model, inputs = model_config_from(data.pop("model")), DataConfig(**_tuples(data.pop("data")))
    return TrainConfig(model=model, data=inputs, motion=MotionConfig(**_tuples(data.pop("motion"))), **_tuples(data))


def model_config_from(data: dict[str, Any]) -> ModelConfig:
    """Returns the sizes of a network from its fields by name, with tuples or lists for tuples.

    Raises ``ValueError`` where ``data`` is of a network without a part that its variant has now, or with one that its
    variant has not.
    """
    sizes = {name: value for name, value in _tuples(data).items() if name not in FORMER_SWITCHES}
    config = ModelConfig(**sizes)
    odd = [name for name in FORMER_SWITCHES if data.get(name, config.vector) != config.vector]
    if odd:
        raise ValueError(f"{odd[0]}: expected {config.vector} with variant {config.variant!r}. Train it anew.")
    return config


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
