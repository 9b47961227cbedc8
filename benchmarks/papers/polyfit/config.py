"""Settings of PolyFit's training and of the run that makes every network its benchmark compares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from benchmarks.papers.polyfit.families import FAMILIES

Kind = Literal["qstn", "pointnet", "dgcnn"]


@dataclass(frozen=True)
class PolyFitConfig:
    """One training. ``families``: what patches are sums of; empty: patches of garments (fine-tuning).

    ``patch_count`` distinct patches of ``point_count`` points come round again and again; ``order`` of the jets;
    ``bijectivity_weight`` on normals that lean past the plane; ``height_gain``: garment patches are made up to this
    many times as high, since those of the designs are smoother than what comes. Batch and first rate are those of
    appendix A.1. ``held_out``: fine-tuned on other patches of the very garments that are measured, as the paper's
    appendix does; never used outside its table.
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
