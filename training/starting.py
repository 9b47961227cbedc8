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
    """Weights, sizes and held-out clips of ``model``: a checkpoint, the folder of a run or of an exported model, or the
    name of one under drape/assets/models."""
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
    payload, found = checkpoint.load_checkpoint(path)
    return payload["model"], found.model, found.data.held_out


def start_from(
    config: TrainConfig, start: Path | None, encoder: Path | None = None
) -> tuple[TrainConfig, Weights | None]:
    """Returns ``config`` on top of the model ``start``, and the weights there; a static preset takes none.

    ``encoder``: an exported model, or the name of one, whose recurrent encoder the run begins with.
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


def finetuned(model: Path, garments: list[str] | None) -> tuple[TrainConfig, Weights]:
    """The configuration that goes on training ``model`` on ``garments`` alone, or else on the shipped preset's, and its
    weights.

    A dynamic model's static drape is trained; --preset dynamic adds motion to the result.
    """
    weights, sizes, held_out = read_model(model)
    config = with_garments(finetune(), garments) if garments else continuation()
    static = {name: value for name, value in weights.items() if not name.startswith("dynamic.")}
    data = replace(config.data, held_out=held_out)
    return replace(config, model=replace(sizes, dynamic=False), data=data), static


def with_garments(config: TrainConfig, garments: list[str] | None) -> TrainConfig:
    """Returns ``config`` with ``garments``, files or names of designs, and no neighbours of theirs; unchanged without
    any.
    """
    if not garments:
        return config
    return replace(config, data=replace(config.data, garments=tuple(garments), variants=0, own_share=1.0))


def with_more_garments(config: TrainConfig, files: list[str] | None) -> TrainConfig:
    """Returns ``config`` with garments besides its own: ``files`` and folders of them."""
    more = [str(path) for path in find_garments(files)] if files else []
    return replace(config, data=replace(config.data, garments=(*config.data.garments, *more)))


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
