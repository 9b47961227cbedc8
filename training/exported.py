"""The weights of an exported model, so that training can go on from what is shipped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drape.artifacts import load_manifest, read_parameters
from drape.errors import ArtifactError
from training.checkpoint import model_config_from
from training.config import ModelConfig
from training.model import OneFit


def load_exported(folder: Path) -> tuple[dict[str, Tensor], ModelConfig, tuple[str, ...]]:
    """Weights of the static network in ``folder``, its sizes, and the clips that it was never trained on.

    A recurrent encoder is not read: what is trained from here is the drape of single poses.
    """
    manifest = load_manifest(folder)
    try:
        if manifest.weights is None:
            raise KeyError("weights")
        config = replace(model_config_from(manifest.network), dynamic=False)
        read = read_parameters(folder, manifest.weights)
        weights = _shaped(read, OneFit(config).state_dict())
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"model {manifest.name}",
            expected="the weights of a draping network",
            got=f"none of {error}",
            cure="Start from the checkpoint.pt of its training.",
        ) from error
    return weights, config, tuple(str(clip) for clip in manifest.training.get("held_out", ()))


def load_encoder(folder: Path) -> tuple[dict[str, Tensor], ModelConfig]:
    """Weights of the recurrent encoder of the exported model in ``folder``, and the sizes of its network.

    So that a static model which went on from that one has motion too. Raises ``ArtifactError`` where it has none.
    """
    manifest = load_manifest(folder)
    config = model_config_from(manifest.network)
    if manifest.weights is None or not config.dynamic:
        raise ArtifactError(
            f"model {manifest.name}",
            expected="a model that knows motion",
            got="a static one",
            cure="Name another, or train with --preset dynamic.",
        )
    wanted = {name: made for name, made in OneFit(config).state_dict().items() if name.startswith("dynamic.")}
    return _shaped(read_parameters(folder, manifest.weights), wanted), config


def _shaped(read: dict[str, np.ndarray], wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: torch.from_numpy(read[name]).reshape(made.shape) for name, made in wanted.items()}
