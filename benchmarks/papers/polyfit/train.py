"""The training loop of PolyFit and its peers: deterministic, resumable, guarded.

What a step sees depends on its number alone, so a run that goes on from a checkpoint goes on bit for bit.
"""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.papers.polyfit import fit
from benchmarks.papers.polyfit.canonical import canonical
from benchmarks.papers.polyfit.config import PolyFitConfig
from benchmarks.papers.polyfit.families import Patches, draw_patches
from benchmarks.papers.polyfit.network import DgcnnRegressor, PointNetRegressor, Qstn
from drape.errors import ArtifactError, InputError

SKIPS_MAX = 8


def network(config: PolyFitConfig) -> nn.Module:
    """The untrained network of ``config``."""
    torch.manual_seed(config.seed)
    if config.kind == "qstn":
        return Qstn()
    return PointNetRegressor(config.order) if config.kind == "pointnet" else DgcnnRegressor(config.order)


@dataclass(frozen=True)
class Prepared:
    """Patches in their canonical frames: points and normals (B, n, 3), the latter turned alike."""

    points: Tensor
    normals: Tensor


def prepare(patches: Patches) -> Prepared:
    """Normalisation, basis and frame of every patch (appendix A.1)."""
    own = canonical(patches.points)
    return Prepared(own.local, patches.normals @ own.axes)


def fitted(model: nn.Module | None, patches: Prepared, *, order: int) -> tuple[fit.Fit, Tensor]:
    """The fit of each patch and the true normals in its frame; without a model, in the canonical frame."""
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


class Trainer:
    """State of one training; ``garments`` are the patches that fine-tuning draws from."""

    def __init__(
        self, config: PolyFitConfig, *, garments: Patches | None = None, start: dict[str, Tensor] | None = None
    ) -> None:
        if not config.families and garments is None:
            raise InputError(
                "families", expected="a family, or garment patches", got="neither", cure="Name families to train on."
            )
        self.config, self.garments = config, garments
        self.model = network(config)
        if start is not None:
            self.model.load_state_dict(start)
        self.optimiser = torch.optim.Adam(self.model.parameters(), lr=config.learning_rate)
        self.step_count = 0
        self.skipped = 0

    def rate(self) -> float:
        """Learning rate: warm-up, then a cosine over the steps."""
        config = self.config
        warm = min(1.0, (self.step_count + 1) / config.warmup_steps)
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, self.step_count / config.steps)))
        return warm * (config.final_rate + (config.learning_rate - config.final_rate) * cosine)

    def batch(self) -> Patches:
        """The patches of the present step."""
        config = self.config
        if config.families:
            batches = max(1, config.patch_count // config.batch_size)
            return draw_patches(
                config.batch_size, config.point_count, families=config.families,
                seed=(config.seed, self.step_count % batches),
            )  # fmt: skip
        assert self.garments is not None
        rng = np.random.default_rng((config.seed, self.step_count))
        rows = torch.from_numpy(rng.integers(len(self.garments.points), size=config.batch_size))
        columns = torch.from_numpy(rng.permutation(self.garments.points.shape[1])[: config.point_count])
        gain = torch.from_numpy(np.exp(rng.uniform(0.0, math.log(config.height_gain), size=config.batch_size)))
        return raised(Patches(self.garments.points[rows][:, columns], self.garments.normals[rows][:, columns]), gain)

    def step(self) -> dict[str, float]:
        """One step; its figures. A step that is not finite is not taken."""
        config = self.config
        patches = prepare(self.batch())
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        self.optimiser.zero_grad(set_to_none=True)
        result, normals = fitted(self.model, patches, order=config.order)
        height = fit.height_rmse(result).mean()
        loss = height
        if config.kind == "qstn":
            loss = loss + config.bijectivity_weight * fit.steepness(normals).mean()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        self.step_count += 1
        if not bool(torch.isfinite(norm)):
            self.skipped += 1
            if self.skipped > SKIPS_MAX:
                raise InputError(
                    "training",
                    expected="finite steps",
                    got=f"{self.skipped} that were not",
                    cure="Lower learning_rate.",
                )
            return {"skipped": 1.0}
        self.optimiser.step()
        return {"height_rmse": float(height.detach()), "loss": float(loss.detach())}

    def run(self, *, until: int | None = None, report: Callable[[int, dict[str, float]], None] | None = None) -> None:
        """Steps up to ``until`` (default: all of them)."""
        while self.step_count < (self.config.steps if until is None else until):
            figures = self.step()
            if report is not None:
                report(self.step_count, figures)

    def state(self) -> dict[str, Any]:
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step_count,
            "skipped": self.skipped,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step_count, self.skipped = state["step"], state["skipped"]


def save(path: Path, trainer: Trainer) -> None:
    """Writes a checkpoint; a crash leaves the file before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    torch.save(trainer.state() | {"config": asdict(trainer.config)}, temporary)
    os.replace(temporary, path)


def load(path: Path) -> tuple[dict[str, Any], PolyFitConfig]:
    """State and configuration of a checkpoint; only tensors and plain values are read."""
    try:
        state = torch.load(path, weights_only=True)
        config = state.pop("config")
        return state, PolyFitConfig(**{**config, "families": tuple(config["families"])})
    except (OSError, RuntimeError, KeyError, TypeError, EOFError, AttributeError, pickle.UnpicklingError) as error:
        raise ArtifactError(
            f"checkpoint {path.name}",
            expected="a checkpoint of benchmarks.papers.polyfit",
            got=str(error),
            cure="Train again.",
        ) from error


def load_model(path: Path) -> nn.Module:
    """The network of a checkpoint, in evaluation mode."""
    state, config = load(path)
    model = network(config)
    model.load_state_dict(state["model"])
    return model.eval()
