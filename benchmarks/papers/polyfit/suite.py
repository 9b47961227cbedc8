"""Trains PolyFit, and the networks that its benchmark compares it with.

    python -m benchmarks.papers.polyfit.suite --out runs/polyfit       # all of them, a quarter of an hour on one core
    python -m benchmarks.papers.polyfit.suite --only gaussian families # some; those a run starts from must be there
    python -m benchmarks.papers.polyfit.suite --steps-share 0.1        # a look at the loop

A run that was interrupted goes on where its checkpoint stands; one that is done is not trained again.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import torch

from benchmarks.papers.polyfit.config import PolyFitConfig, suite
from benchmarks.papers.polyfit.families import Patches
from benchmarks.papers.polyfit.garment_patches import designed_garments, draw_garment_patches, held_out_garments
from benchmarks.papers.polyfit.train import Trainer, load, save
from drape.body.assets import load_body
from drape.errors import NotFound, refusing

SAVE_EVERY = 100
COUNTS = (0.3, 1.2)  # times the rule: the shipped designs are smooth, and large patches of them are hard
GARMENT_POINTS = 160  # kept per patch; a step draws its points among them


def run_suite(out: Path, configs: dict[str, PolyFitConfig], *, only: list[str] | None = None) -> None:
    """Trains ``configs`` into ``out``/NAME.pt, those of ``only`` if given."""
    patches: dict[bool, Patches] = {}
    for name, config in configs.items():
        if only is not None and name not in only:
            continue
        path = out / f"{name}.pt"
        if not config.families and config.held_out not in patches:
            patches[config.held_out] = training_patches(out, config)
        trainer = Trainer(config, garments=patches.get(config.held_out), start=_start(out, config))
        if path.is_file():
            state, stored = load(path)
            if stored == config:
                trainer.restore(state)
        _run(name, trainer, path)


def _start(out: Path, config: PolyFitConfig) -> dict[str, torch.Tensor] | None:
    if config.start is None:
        return None
    path = out / f"{config.start}.pt"
    if not path.is_file():
        raise NotFound(
            f"run {config.start}", expected=f"{path.name} in {out.name}/", got="no such file", cure="Train it first."
        )
    return load(path)[0]["model"]


def _run(name: str, trainer: Trainer, path: Path) -> None:
    begun, first = time.monotonic(), trainer.step_count
    mean: dict[str, float] = {}

    def report(step: int, figures: dict[str, float]) -> None:
        for key, value in figures.items():
            mean[key] = value if key not in mean else 0.9 * mean[key] + 0.1 * value
        if step % SAVE_EVERY == 0 or step == trainer.config.steps:
            save(path, trainer)
        if step % 20 == 0 or step == trainer.config.steps:
            speed = (step - first) * trainer.config.batch_size / (time.monotonic() - begun)
            said = " ".join(f"{key} {value:.4f}" for key, value in mean.items())
            print(f"{name} step {step}/{trainer.config.steps} {said} {speed:.0f} patches/s", flush=True)

    trainer.run(report=report)


def training_patches(out: Path, config: PolyFitConfig) -> Patches:
    """Garment patches for fine-tuning, kept in ``out`` since drawing them takes a minute."""
    if config.held_out:
        garments, _ = held_out_garments(load_body(), folder=out / "garments")
        return draw_garment_patches(
            garments, partitions=2 * config.partitions, point_count=GARMENT_POINTS, seed=config.seed + 5
        )
    path = out / f"patches-{config.variants}-{config.partitions}-{config.seed}.pt"
    if path.is_file():
        return Patches(*torch.load(path, weights_only=True))
    garments = designed_garments(load_body(), variants=config.variants, seed=config.seed + 3)
    patches = draw_garment_patches(
        garments, partitions=config.partitions, point_count=GARMENT_POINTS, seed=config.seed + 4, count_range=COUNTS
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save((patches.points, patches.normals), path)
    return patches


@refusing
def main(arguments: list[str] | None = None) -> int:
    """Command line entry."""
    configs = suite()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.papers.polyfit.suite", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--out", type=Path, default=Path("runs/polyfit"))
    parser.add_argument("--only", nargs="+", choices=list(configs))
    parser.add_argument("--steps-share", type=float, default=1.0, help="share of the steps of every run")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    run_suite(options.out, suite(share=options.steps_share), only=options.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
