"""What makes one network drape many garments: gain against the number of garments and partitions trained on.

Each run trains the shipped configuration anew for the same time on a part of the data and is measured, without
export, on hard held-out poses of garments that it saw and of garments that it did not: OneFit's table 1 (one
garment or six) and figures 5 and 6 (trained on one garment, draping like and unlike ones).

    python -m benchmarks.papers.generality --minutes 8 --unseen $DRAPE_DATA/garments [--save]
    python -m benchmarks.papers.generality --train-steps 2000 ...    # the same number of steps each, on a busy machine
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.papers.held_out import JUDGING, HeldOut, training_clips
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from training.config import PRESETS, TrainConfig
from training.evaluate import CPU
from training.garment_design import DESIGNS, cut_garment
from training.poses import PoseBank
from training.run import Trainer

SIX = ("tshirt", "longsleeve", "tank", "trousers", "shorts", "dress")
NEVER = 10**9  # steps
# Run -> what it changes in the shipped configuration's data.
RUNS: dict[str, dict[str, Any]] = {
    "T-shirt, 1 partition": {"garments": ("tshirt",), "partitions": 1, "variants": 0, "fresh_steps": NEVER},
    "T-shirt, fresh partitions": {"garments": ("tshirt",), "partitions": 16, "variants": 0, "fresh_steps": 100},
    "T-shirt and 8 variants": {"garments": ("tshirt",), "partitions": 6, "variants": 8},
    "six, 1 partition each": {"garments": SIX, "partitions": 1, "variants": 0, "fresh_steps": NEVER},
    "six, fresh partitions": {"garments": SIX, "partitions": 6, "variants": 0, "fresh_steps": 100},
    "seven and 7 variants each": {},
}


def training_config(run: str, minutes: float, *, quick: bool) -> TrainConfig:
    """The shipped configuration with the data of ``run``."""
    config = PRESETS["shipped"]()
    changes = RUNS[run] | ({"garments": ("shorts",), "partitions": 1, "variants": 0} if quick else {})
    return replace(config, data=replace(config.data, **changes), minutes=minutes, threads=torch.get_num_threads())


def train_for(trainer: Trainer, minutes: float, steps: int | None = None) -> None:
    """Steps until ``minutes`` have passed; or ``steps`` of them, which then are what the minutes are counted in."""
    started = time.monotonic()
    while trainer.elapsed_s < 60.0 * minutes:
        clock_s = time.monotonic() - started if steps is None else 60.0 * minutes * (trainer.step_count + 1) / steps
        trainer.step(clock_s)


@Benchmark(
    "generality",
    "Gain against variety.",
    {"run": "s", "garments": "d", "partitions": "d", "steps": "d", "mean_seen": ".2f", "mean_unseen": ".2f"},
    Option("--minutes", 8.0, "of training per run", 0.1),
    Option("--train-steps", None, "of training per run, whatever time they take", kind=int),
    Option("--runs", tuple(RUNS), "which", tuple(RUNS)[:1], choices=sorted(RUNS)),
    Option("--seen", SIX, "designs that are measured", ("shorts",), choices=sorted(DESIGNS)),
    Option("--unseen", (), "garment files or folders"),
    *JUDGING,
)
def main(run: Run) -> None:
    """A row for each run."""
    options, body, shipped = run.options, load_body(), PRESETS["shipped"]()
    held_out = HeldOut(shipped, body, options.frames, options.steps)
    seen = [cut_garment(DESIGNS[name], body) for name in options.seen]
    unseen = [open_garment(path, body) for path in find_garments(options.unseen)] if options.unseen else []
    clips = training_clips(shipped)
    for name in options.runs:
        config = training_config(name, options.minutes, quick=options.quick)
        trainer = Trainer(config, PoseBank(clips, config.data), device=CPU)
        first = sum(len(garment.partitions) for garment in trainer.wardrobe.garments)
        train_for(trainer, options.minutes, options.train_steps)
        steps, gains = trainer.step_count, held_out.gains(trainer.model, [*seen, *unseen])
        row: dict[str, Any] = {"run": name, "garments": len(trainer.wardrobe.garments), "steps": steps}
        row |= {"partitions": first + steps // config.data.fresh_steps}
        row |= {f"gain_{garment}": value for garment, value in gains.items()}
        for label, group in (("seen", seen), ("unseen", unseen)):
            if group:
                row[f"mean_{label}"] = float(np.mean([gains[garment.name] for garment in group]))
        run.columns = {**run.columns, **dict.fromkeys((f"gain_{garment}" for garment in gains), ".2f")}
        run.add([row])
    run.extra |= {"frames": list(held_out.poses.labels), "minutes": options.minutes}


if __name__ == "__main__":
    main.command()
