"""The weights of an exported model, so that training can go on from what is shipped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
        weights = {
            name: torch.from_numpy(read[name]).reshape(made.shape) for name, made in OneFit(config).state_dict().items()
        }
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"model {manifest.name}",
            expected="the weights of a draping network",
            got=f"none of {error}",
            cure="Start from the checkpoint.pt of its training.",
        ) from error
    return weights, config, tuple(str(clip) for clip in manifest.training.get("held_out", ()))
