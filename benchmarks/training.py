"""Training throughput [frames/s] on one garment, and where the time of a step goes.

Rows: one process with one thread, one process with all threads, and one process per core under torchrun, with
the same configuration and the same number of frames per step in all. The stages are read with a profiler in a
pass of their own, after the timed one.

    python -m benchmarks.training [--garment tshirt] [--batch 4] [--steps 60] [--bf16] [--device cpu] [--save]
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.harness import ROOT, Benchmark, Option, Run
from benchmarks.tables import Row
from drape.files.data import data_folder
from training import parallel
from training.config import PRESETS, TrainConfig
from training.poses import PoseBank, read_clips
from training.run import Trainer, sample_motions

WARM_STEPS, BLOCKS = 5, 5
# Stage -> functions (file, name) whose time, callees included, it is made of.
STAGES = {
    "pose": (("data.py", "pose"),),
    "network": (("model.py", "forward"), ("layers.py", "forward")),
    "blend": (("losses.py", "garment_vertices"), ("losses.py", "disagreement")),
    "energy": (("energies.py", "total"),),
    "contact": (("collider.py", "nearest_rows"),),
    "backward": (("_tensor.py", "backward"),),
    "average": (("parallel.py", "average_gradients"),),
    "optimiser": (("adam.py", "step"), ("clip_grad.py", "clip_grad_norm_")),
}
COLUMNS = {"processes": "d", "threads": "d", "batch": "d", "frames_per_s": ".1f", "spread": ".1f"} | {
    f"{stage}_ms": ".2f" for stage in (*STAGES, "other")
}


def stage_times(profile: cProfile.Profile, frames: int) -> dict[str, float]:
    """Milliseconds per frame by stage; "other" is what no stage holds."""
    stats: dict[tuple[str, int, str], Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    total = max(entry[3] for (path, _, name), entry in stats.items() if name == "step" and path.endswith("trainer.py"))
    times: dict[str, float] = {}
    for stage, functions in STAGES.items():
        found = [entry[3] for (path, _, name), entry in stats.items() if (Path(path).name, name) in functions]
        # A layer within a layer counts in its caller already: the largest is the whole.
        times[stage] = max(found, default=0.0) if stage == "network" else sum(found)
    times["other"] = total - sum(times.values())
    return {f"{stage}_ms": 1e3 * seconds / frames for stage, seconds in times.items()}


def make_trainer(config: TrainConfig, device: str) -> Trainer:
    folder = data_folder("motions") or sample_motions()
    return Trainer(
        config, PoseBank(read_clips([folder], held_out=config.data.held_out), config.data), device=torch.device(device)
    )


def measure(trainer: Trainer, steps: int) -> Row:
    """Median rate over ``BLOCKS`` blocks of steps, the spread between them, and the stages."""
    for _ in range(WARM_STEPS):
        trainer.step()
    per_block = max(1, steps // BLOCKS)
    frames = per_block * trainer.config.batch_size * parallel.world_size()
    rates = []
    for _ in range(BLOCKS):
        started = time.perf_counter()
        for _ in range(per_block):
            trainer.step()
        _wait(trainer.device)
        rates.append(frames / (time.perf_counter() - started))
    profile = cProfile.Profile()
    profile.enable()
    for _ in range(per_block):
        trainer.step()
    profile.disable()
    return {
        "processes": parallel.world_size(),
        "threads": torch.get_num_threads(),
        "batch": trainer.config.batch_size,
        "bf16": trainer.config.autocast,
        "vertices": len(trainer.wardrobe.garments[0].rest.vertices),
        "patches": len(trainer.wardrobe.garments[0].partitions[0].patches.scale),
        "frames_per_s": float(np.median(rates)),
        "spread": float(np.ptp(rates)),
        **stage_times(profile, per_block * trainer.config.batch_size),
    }


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def configuration(garment: str, batch: int, *, bf16: bool = False) -> TrainConfig:
    """The shipped model's configuration on one garment with two partitions."""
    config = PRESETS["shipped"]()
    data = replace(config.data, garments=(garment,), partitions=2, variants=0)
    return replace(config, data=data, batch_size=batch, autocast=bf16)


def parallel_row(options: argparse.Namespace, processes: int) -> Row:
    """The row of ``processes`` processes under torchrun, which run this module as workers."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    command += ["-m", "benchmarks.training", "--garment", options.garment, "--device", options.device]
    command += ["--batch", str(options.batch), "--steps", str(options.steps), *(["--bf16"] if options.bf16 else [])]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
    if done.returncode:
        raise RuntimeError(f"torchrun ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def worker(options: argparse.Namespace) -> None:
    """One process of a parallel row; the first prints the row."""
    torch.set_num_threads(1)
    parallel.start(torch.device(options.device))
    config = configuration(options.garment, options.batch, bf16=options.bf16)
    row = measure(make_trainer(config, options.device), options.steps)
    if parallel.rank() == 0:
        print(json.dumps(row), flush=True)
    parallel.stop()


@Benchmark(
    "training",
    "Training throughput.",
    COLUMNS,
    Option("--garment", "tshirt", "what is trained on"),
    Option("--batch", 4, "frames per step and process"),
    Option("--steps", 100, "timed steps", 20),
    Option("--bf16", False, "matrices in bfloat16, as of training.run"),
    Option("--device", "cpu", "of torch"),
)
def main(run: Run) -> None:
    """A row for each way to share a step among threads and processes."""
    options = run.options
    trainer = make_trainer(configuration(options.garment, options.batch, bf16=options.bf16), options.device)
    for threads in sorted({1, options.threads}):
        torch.set_num_threads(threads)
        run.rows.append(measure(trainer, options.steps))
    if not options.quick and options.threads > 1 and options.device == "cpu":
        run.rows.append(parallel_row(options, options.threads))
    run.notes.append("stages: milliseconds per frame of one process, profiled apart from the timed steps")
    run.extra |= {"garment": options.garment, "device": options.device}


if __name__ == "__main__":
    worker(main.parse()) if "RANK" in os.environ else main.command()
