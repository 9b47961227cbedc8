"""The training of PolyFit and of the networks it is compared with.

The patches of a step depend on its number alone, so that a training gives the same network whenever it runs. A trained
network is kept with its configuration, and not trained again.
"""

from __future__ import annotations

import math
import pickle
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.papers.polyfit import fit
from benchmarks.papers.polyfit.canonical import canonical
from benchmarks.papers.polyfit.families import FAMILIES, Patches, draw_patches
from benchmarks.papers.polyfit.garment_patches import designed_garments, draw_garment_patches, held_out_garments
from benchmarks.papers.polyfit.network import DgcnnRegressor, PointNetRegressor, Qstn
from drape.body.assets import load_body
from drape.errors import ArtifactError, InputError
from drape.files.atomic import whole_file

SKIPS_MAX = 8
SMOOTH_COUNTS = (0.3, 1.2)  # times the rule: the shipped designs are smooth, and large patches of them are hard
GARMENT_POINTS = 160  # kept per patch; a step draws its points among them
Kind = Literal["qstn", "pointnet", "dgcnn"]


@dataclass(frozen=True)
class PolyFitConfig:
    """One training. ``families``: what patches are sums of; empty: patches of garments (fine-tuning).

    ``patch_count`` distinct patches of ``point_count`` points come round again and again; ``order`` of the jets;
    ``bijectivity_weight`` on normals that lean past the plane; ``height_gain``: garment patches are made up to this
    many times as high, since those of the designs are smoother than what comes. Batch and first rate are those of
    appendix A.1. ``held_out``: fine-tuned on other patches of the very garments that are measured, as in the paper's
    appendix, for that table alone.
    """

    kind: Kind = "qstn"
    families: tuple[str, ...] = FAMILIES
    start: str | None = None
    patch_count: int = 100_000
    point_count: int = 64
    batch_size: int = 512
    order: int = 4
    steps: int = 300
    learning_rate: float = 1e-3
    final_rate: float = 1e-5
    warmup_steps: int = 20
    gradient_clip: float = 1.0
    bijectivity_weight: float = 0.05
    height_gain: float = 4.0
    held_out: bool = False
    variants: int = 2
    partitions: int = 5
    seed: int = 0


def suite(*, share: float = 1.0) -> dict[str, PolyFitConfig]:
    """Every training that the benchmark's tables compare, by name, in order; ``share`` scales the steps of all."""
    base = PolyFitConfig()
    tuned = replace(base, families=(), learning_rate=5e-4, steps=200)
    runs = {
        "gaussian": replace(base, families=("gaussian",)),
        "families": base,
        "finetuned": replace(tuned, start="families"),
        "adapted": replace(tuned, start="finetuned", held_out=True, height_gain=1.0),
        "pointnet_families": replace(base, kind="pointnet"),
        "pointnet": replace(tuned, kind="pointnet", start="pointnet_families"),
        "dgcnn_families": replace(base, kind="dgcnn"),
        "dgcnn": replace(tuned, kind="dgcnn", start="dgcnn_families"),
    }
    return {name: replace(config, steps=max(1, round(share * config.steps))) for name, config in runs.items()}


def network(config: PolyFitConfig) -> nn.Module:
    """The untrained network of ``config``."""
    torch.manual_seed(config.seed)
    if config.kind == "qstn":
        return Qstn()
    return PointNetRegressor(config.order) if config.kind == "pointnet" else DgcnnRegressor(config.order)


def prepare(patches: Patches) -> Patches:
    """``patches`` in their canonical frames: normalisation, basis and frame of every patch (appendix A.1)."""
    own = canonical(patches.points)
    return Patches(own.local, patches.normals @ own.axes)


def fitted(model: nn.Module | None, patches: Patches, *, order: int) -> tuple[fit.Fit, Tensor]:
    """The fit of each prepared patch and the true normals in its frame; without a model, in the canonical frame."""
    if model is None:
        return fit.fit_jet(patches.points, order=order), patches.normals
    if isinstance(model, Qstn):
        quaternion = model(patches.points)
        turned = fit.turned(patches.points, quaternion)
        return fit.fit_jet(turned, order=order), fit.turned(patches.normals, quaternion)
    return fit.given_jet(patches.points, model(patches.points), order=order), patches.normals


def raised(patches: Patches, gain: Tensor) -> Patches:
    """``patches`` in their canonical frames with heights ``gain`` (B,) times as high, and the normals of that."""
    own = prepare(patches)
    gain = gain.to(own.points.dtype)[:, None]
    points = torch.cat([own.points[..., :2], gain[..., None] * own.points[..., 2:]], dim=-1)
    normals = torch.cat([gain[..., None] * own.normals[..., :2], own.normals[..., 2:]], dim=-1)
    return Patches(points, normals / normals.norm(dim=-1, keepdim=True).clamp(min=1e-12))


def rate(config: PolyFitConfig, step: int) -> float:
    """The learning rate of a step: warm-up, then a cosine over the steps."""
    warm = min(1.0, (step + 1) / config.warmup_steps)
    cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, step / config.steps)))
    return warm * (config.final_rate + (config.learning_rate - config.final_rate) * cosine)


def batch(config: PolyFitConfig, garments: Patches | None, step: int) -> Patches:
    """The patches of a step, drawn from the families or from those of ``garments``."""
    if config.families:
        seed = config.seed, step % max(1, config.patch_count // config.batch_size)
        return draw_patches(config.batch_size, config.point_count, families=config.families, seed=seed)
    if garments is None:
        raise InputError(
            "families", expected="a family, or garment patches", got="neither", cure="Name families to train on."
        )
    rng = np.random.default_rng((config.seed, step))
    rows = torch.from_numpy(rng.integers(len(garments.points), size=config.batch_size))
    columns = torch.from_numpy(rng.permutation(garments.points.shape[1])[: config.point_count])
    gain = torch.from_numpy(np.exp(rng.uniform(0.0, math.log(config.height_gain), size=config.batch_size)))
    return raised(Patches(garments.points[rows][:, columns], garments.normals[rows][:, columns]), gain)


def train(model: nn.Module, config: PolyFitConfig, *, garments: Patches | None = None, name: str = "") -> nn.Module:
    """``model`` after the steps of ``config``, in evaluation mode. A step that is not finite is not taken."""
    optimiser = torch.optim.Adam(model.parameters(), lr=config.learning_rate)
    skipped, begun = 0, time.monotonic()
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = rate(config, step)
        optimiser.zero_grad(set_to_none=True)
        result, normals = fitted(model, prepare(batch(config, garments, step)), order=config.order)
        height = fit.height_rmse(result).mean()
        steep = config.bijectivity_weight * fit.steepness(normals).mean() if config.kind == "qstn" else 0.0
        (height + steep).backward()
        if bool(torch.isfinite(nn.utils.clip_grad_norm_(model.parameters(), config.gradient_clip))):
            optimiser.step()
        else:
            skipped += 1
        if skipped > SKIPS_MAX:
            raise InputError(
                "training", expected="finite steps", got=f"{skipped} that were not", cure="Lower learning_rate."
            )
        if name and (step + 1) % 20 == 0:
            speed = (step + 1) * config.batch_size / (time.monotonic() - begun)
            print(f"{name} step {step + 1}/{config.steps} height {float(height):.4f} {speed:.0f} patches/s", flush=True)
    return model.eval()


def train_missing(folder: Path, configs: dict[str, PolyFitConfig]) -> dict[str, nn.Module]:
    """The networks of ``configs`` by name; those that ``folder`` has no file of are trained and kept there."""
    garments: dict[bool, Patches] = {}
    models: dict[str, nn.Module] = {}
    for name, config in configs.items():
        path = folder / f"{name}.pt"
        if not path.is_file() or load(path)[1] != config:
            if not config.families and config.held_out not in garments:
                garments[config.held_out] = garment_patches(folder, config)
            model = network(config)
            if config.start is not None:
                model.load_state_dict(models[config.start].state_dict())
            save(path, train(model, config, garments=garments.get(config.held_out), name=name), config)
        models[name] = load(path)[0]
    return models


def garment_patches(folder: Path, config: PolyFitConfig) -> Patches:
    """The garment patches that fine-tuning draws from; intake of held-out garments is kept in ``folder``."""
    if config.held_out:
        garments, _ = held_out_garments(load_body(), folder=folder / "garments")
        return draw_garment_patches(
            garments, partitions=2 * config.partitions, point_count=GARMENT_POINTS, seed=config.seed + 5
        )
    garments = designed_garments(load_body(), variants=config.variants, seed=config.seed + 3)
    return draw_garment_patches(
        garments,
        partitions=config.partitions,
        point_count=GARMENT_POINTS,
        seed=config.seed + 4,
        count_range=SMOOTH_COUNTS,
    )


def save(path: Path, model: nn.Module, config: PolyFitConfig) -> None:
    """Writes a network; a crash leaves the file before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        torch.save({"model": model.state_dict(), "config": asdict(config)}, file)


def load(path: Path) -> tuple[nn.Module, PolyFitConfig]:
    """A network that was kept, in evaluation mode, and its configuration; only tensors and plain values are read."""
    try:
        state = torch.load(path, weights_only=True)
        config = PolyFitConfig(**{**state["config"], "families": tuple(state["config"]["families"])})
        model = network(config)
        model.load_state_dict(state["model"])
    except (OSError, RuntimeError, KeyError, TypeError, EOFError, AttributeError, pickle.UnpicklingError) as error:
        raise ArtifactError(
            f"checkpoint {path.name}",
            expected="a checkpoint of benchmarks.papers.polyfit",
            got=str(error),
            cure="Train again.",
        ) from error
    return model.eval(), config
