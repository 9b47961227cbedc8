"""The start of a run: from nothing, from a static model that gets a recurrent encoder, or from one to be fine-tuned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drape.artifacts import MODELS_DIR, load_manifest, model_folder, read_parameters
from drape.catalog import find_garments
from drape.errors import ArtifactError, InputError
from training import checkpoint
from training.checkpoint import model_config_from
from training.config import ModelConfig, TrainConfig, continuation, finetune
from training.onefit import OneFit

Weights = dict[str, Tensor]
CHECKPOINT, MANIFEST = "checkpoint.pt", "manifest.json"


def read_model(model: Path) -> tuple[Weights, ModelConfig, tuple[str, ...]]:
    """Returns the weights by name, the sizes and the held-out clips of ``model``: a checkpoint, the folder of a run or
    of an exported model, or the name of one under drape/assets/models.

    Raises ``InputError`` where there is none, and ``ArtifactError`` where it cannot be read.
    """
    for folder in (model, MODELS_DIR / model):
        if (folder / MANIFEST).is_file():
            return load_exported(folder)
    path = model / CHECKPOINT if model.is_dir() else model
    if not path.is_file():
        raise InputError(
            "model to start from",
            expected=f"a checkpoint, a folder with {CHECKPOINT} or {MANIFEST}, or a name under drape/assets/models",
            got=model.name,
            cure="Name one that is there.",
        )
    payload, config = checkpoint.load_checkpoint(path)
    return payload["model"], config.model, config.data.held_out


def start_from(
    config: TrainConfig, start: Path | None, encoder: Path | None = None
) -> tuple[TrainConfig, Weights | None]:
    """Returns the configuration and the weights with which a run of ``config`` begins. A dynamic network begins with
    the static model ``start``, of which it takes sizes, weights and held-out clips, and with the recurrent ``encoder``
    of an exported model (folder or name), if that is given. A static one begins with None for weights.

    Raises ``InputError`` for a dynamic network without ``start``, and for a static one with it.
    """
    if config.model.dynamic != (start is not None):
        raise InputError(
            "--from",
            expected="a static model" if config.model.dynamic else "nothing for a static preset",
            got="nothing" if start is None else start.name,
            cure="Train a static preset first, then --preset dynamic --from its checkpoint.pt.",
        )
    if start is None:
        return config, None
    weights, model, held_out = read_model(start)
    if not model.dynamic:
        wanted = config.model
        sizes = {"motion_hidden": wanted.motion_hidden, "state_size": wanted.state_size}
        calming = {"state_decay_s": wanted.state_decay_s, "state_rest_s": wanted.state_rest_s}
        model = replace(model, dynamic=True, **sizes, **calming)
    if encoder is not None:
        moving, sizes = load_encoder(model_folder(encoder))
        names = ("motion_hidden", "state_size", "state_decay_s", "state_rest_s")
        model = replace(model, **{name: getattr(sizes, name) for name in names})
        weights = weights | moving
    return replace(config, model=model, data=replace(config.data, held_out=held_out)), weights


def finetune_from(model: Path, garments: list[str] | None) -> tuple[TrainConfig, Weights]:
    """Returns the configuration and the weights of a run that goes on training ``model`` (as of ``read_model``) on
    ``garments`` alone, or on the shipped preset's where none are given.

    Of a dynamic model the static network is trained; --preset dynamic adds motion to the result.
    """
    weights, sizes, held_out = read_model(model)
    config = with_garments(finetune(), garments) if garments else continuation()
    static = {name: value for name, value in weights.items() if not name.startswith("dynamic.")}
    data = replace(config.data, held_out=held_out)
    return replace(config, model=replace(sizes, dynamic=False), data=data), static


def with_garments(config: TrainConfig, garments: list[str] | None) -> TrainConfig:
    """Returns ``config`` with ``garments``, files or names of designs, in place of its own, and without neighbours of
    designs; unchanged if there are none."""
    if not garments:
        return config
    return replace(config, data=replace(config.data, garments=tuple(garments), variants=0, own_share=1.0))


def with_more_garments(config: TrainConfig, files: list[str] | None) -> TrainConfig:
    """Returns ``config`` with ``files``, garment files or folders of them, beside its own garments."""
    more = [str(path) for path in find_garments(files)] if files else []
    return replace(config, data=replace(config.data, garments=(*config.data.garments, *more)))


def load_exported(folder: Path) -> tuple[dict[str, Tensor], ModelConfig, tuple[str, ...]]:
    """Returns the weights by name of the static network of the exported model in ``folder``, its sizes, and the names
    of the clips that it was never trained on.

    A recurrent encoder is not read: what is trained from here is the drape of single poses. Raises ``ArtifactError``
    where the folder does not hold the weights.
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
    """Returns the weights by name of the recurrent encoder of the exported model in ``folder``, and the sizes of its
    network. A static model that was trained on from that one gets its motion this way.

    Raises ``ArtifactError`` where the model is static.
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
    wanted = {name: value for name, value in OneFit(config).state_dict().items() if name.startswith("dynamic.")}
    return _shaped(read_parameters(folder, manifest.weights), wanted), config


def _shaped(read: dict[str, np.ndarray], wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: torch.from_numpy(read[name]).reshape(value.shape) for name, value in wanted.items()}
