"""What benchmarks.papers.polyfit measures: fits of patches by model, and whole garments."""

from __future__ import annotations

import time

import numpy as np
import torch
from torch import nn

from benchmarks.papers.polyfit import fit
from benchmarks.papers.polyfit.families import Patches
from benchmarks.papers.polyfit.garment_patches import NamedGarment, sample_patches
from benchmarks.papers.polyfit.train import fitted, prepare
from drape.garment.partition import partition, patch_count_for

BATCH = 512
CLUSTER_POINTS = 400  # per patch of table 7


def figures(result: fit.Fit, normals: torch.Tensor) -> dict[str, torch.Tensor]:
    """Height RMSE [patch sizes], normal error [deg] and share of points that look down, of every patch."""
    return {
        "height_rmse": fit.height_rmse(result),
        "normal_deg": fit.normal_error_deg(result, normals),
        "over_share": fit.over_share(normals),
    }


def summary(parts: list[dict[str, torch.Tensor]]) -> dict[str, float]:
    """Means over all patches, the 99th percentile of the height, and the share of patches that fold over."""
    joined = {key: torch.cat([p[key] for p in parts]) for key in parts[0]}
    return {
        "height_rmse": float(joined["height_rmse"].mean()),
        "height_rmse_p99": float(joined["height_rmse"].quantile(0.99)),
        "normal_deg": float(joined["normal_deg"].mean()),
        "folded_patch_pct": 100.0 * float((joined["over_share"] > 0).float().mean()),
    }


def evaluate(model: nn.Module | None, patches: Patches, *, order: int = 4) -> dict[str, float]:
    """The fit of ``patches`` in frames chosen by ``model`` (None: principal axes), or the jets it regresses."""
    parts = []
    with torch.no_grad():
        for start in range(0, len(patches.points), BATCH):
            rows = slice(start, start + BATCH)
            own = prepare(Patches(patches.points[rows], patches.normals[rows]))
            parts.append(figures(*fitted(model, own, order=order)))
    return summary(parts)


def mean_normal_frames(patches: Patches) -> Patches:
    """Patches in the frames that the product uses without PolyFit: along the mean normal."""
    own = prepare(patches)
    normal = own.normals.mean(dim=-2)
    normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    up = torch.tensor([0.0, 0.0, 1.0]).expand_as(normal)
    # Half-way rotation from the mean normal to the z axis; w stays positive unless they are opposite.
    side = torch.where(normal[:, 2:] < 0, -1.0, 1.0)
    cross = torch.linalg.cross(side * normal, up)
    quaternion = torch.cat([1.0 + side * normal[:, 2:], cross], dim=-1)
    quaternion = quaternion / quaternion.norm(dim=-1, keepdim=True)
    return Patches(fit.turned(own.points, quaternion), fit.turned(own.normals, quaternion))


def evaluate_mean_normal(patches: Patches) -> dict[str, float]:
    """The fit of ``patches`` in the frames of their mean normals."""
    with torch.no_grad():
        return summary([figures(*fitted(None, mean_normal_frames(patches), order=4))])


def milliseconds_per_patch(model: nn.Module | None, patches: Patches, *, repeats: int = 5) -> float:
    """Processor time [ms] from points to jet, frames included, in batches of ``BATCH``; the least of ``repeats``.

    Not the wall clock's: what else the machine does must not count.
    """
    points, normals = (torch.cat([x] * (BATCH // len(x) + 1))[:BATCH] for x in (patches.points, patches.normals))
    best = np.inf
    with torch.no_grad():
        for _ in range(repeats):
            begun = time.process_time()
            fitted(model, prepare(Patches(points, normals)), order=4)
            best = min(best, time.process_time() - begun)
    return 1e3 * best / BATCH


def cluster_fit(model: nn.Module | None, garment: NamedGarment, *, seed: int = 0) -> dict[str, float]:
    """Point RMSE [m] and normal error [deg] of a garment's patches without overlap, the paper's form (table 7)."""
    rest = garment.rest
    label = partition(
        rest.vertices, rest.faces, rest.areas, patch_count_for(float(rest.areas.sum())), seed=seed, graph=rest.graph
    )
    rng = np.random.default_rng(seed)
    points, normals = sample_patches(rest, label, point_count=CLUSTER_POINTS, rng=rng)
    patches = Patches(torch.from_numpy(points), torch.from_numpy(normals))
    moved = patches.points - patches.points.mean(dim=1, keepdim=True)
    size = moved.norm(dim=-1).amax(dim=-1)
    with torch.no_grad():
        result, turned = fitted(model, prepare(patches), order=4)
    squared = (result.residual * size[:, None]) ** 2
    return {
        "point_rmse_m": float(torch.sqrt(squared.mean())),
        "normal_deg": float(fit.normal_error_deg(result, turned).mean()),
    }
