"""What makes one network drape many garments: gain against the number of garments and partitions trained on.

Each run trains the shipped configuration anew for the same time on a part of the data and is measured, without
export, on hard held-out poses of garments that it saw and of garments that it did not: OneFit's table 1 (one
garment or six) and figures 5 and 6 (trained on one garment, draping like and unlike ones).

    python -m benchmarks.papers.generality --minutes 8 --unseen $DRAPE_DATA/garments [--save]
    python -m benchmarks.papers.generality --train-steps 2000 ...    # the same number of steps each, on a busy machine
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR, stored_minimum
from benchmarks.shared import common
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.errors import ended
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.motion.hard_poses import HardPoses, hard_poses
from training.config import PRESETS, TrainConfig
from training.evaluate import evaluate, held_out_clips
from training.garment_design import DESIGNS, cut_garment
from training.poses import PoseBank, read_clips
from training.run import Trainer, sample_motions

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
COLUMNS = {"run": "s", "garments": "d", "partitions": "d", "steps": "d"}


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


def physics_energy(garment: Garment, body: BodyModel, poses: HardPoses, *, steps: int) -> float:
    """Mean total energy [J] of the physics optimum, from the store where it was minimised before."""
    contact, cloth_material = BodyContact(body.faces, body.vertex_count), material()
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth = ClothMesh.from_rest(rest, faces)
    rotations, translations = body.bones(poses.poses)
    still = np.broadcast_to(rest, (len(poses.poses), *rest.shape))
    skinned = skin_points(still, garment.skin_weights.astype(np.float64), rotations, translations)
    skin = body.posed_vertices(poses.poses)
    pushed = nearest_vertex_push(skinned, skin, np.asarray(contact.normals(skin)))

    task = physics.Task.of_garment(
        garment, body, cloth, cloth_material, contact=contact, body_vertices=skin, skinned=skinned, starts=(pushed,)
    )
    optimum, _ = stored_minimum(task, steps, CACHE_DIR)
    height = metrics.mean_height(skinned, cloth)
    parts = metrics.static_parts(optimum.vertices, cloth, cloth_material, contact, skin, height_m=height)
    return float(np.stack(list(parts.values())).sum(axis=0).mean())


def measure(
    trainer: Trainer, garments: Sequence[Garment], optima: dict[str, float], poses: HardPoses
) -> dict[str, float]:
    """Gain of the network alone by garment."""
    trainer.model.eval()
    gains = {}
    for garment in garments:
        rows = {row["method"]: row for row in evaluate(trainer.model, garment, trainer.body, poses)}
        skin, net = rows["skinning_push"]["energy_j"], rows["network"]["energy_j"]
        gains[garment.name] = metrics.gain(skin, net, optima[garment.name])
    return gains


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.papers.generality", description="Gain against variety.")
    parser.add_argument("--minutes", type=float, help="of training per run (default 8, quick 0.1)")
    parser.add_argument("--train-steps", type=int, help="of training per run, whatever time they take")
    parser.add_argument("--runs", nargs="+", choices=sorted(RUNS), help="which (default: all; quick: the first)")
    parser.add_argument("--seen", nargs="+", choices=sorted(DESIGNS), help="designs (default: six of them)")
    parser.add_argument("--unseen", nargs="+", default=[], help="garment files or folders")
    parser.add_argument("--frames", type=int, help="hard poses (default 4, quick 1)")
    parser.add_argument("--steps", type=int, help=f"most physics steps (default {physics.STEPS}, quick 30)")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    quick = options.quick
    options.minutes = options.minutes or (0.1 if quick else 8.0)
    options.frames, options.steps = (
        options.frames or (1 if quick else 4),
        options.steps or (30 if quick else physics.STEPS),
    )
    torch.set_num_threads(options.threads)
    body = load_body()
    config = PRESETS["shipped"]()
    poses = hard_poses(held_out_clips(config, []), body, options.frames)
    seen = [cut_garment(DESIGNS[name], body) for name in options.seen or (("shorts",) if quick else SIX)]
    unseen = [open_garment(p, body) for p in find_garments(options.unseen)] if options.unseen else []
    optima = {g.name: physics_energy(g, body, poses, steps=options.steps) for g in (*seen, *unseen)}
    bank_of = read_clips([data_folder("motions") or sample_motions()], held_out=config.data.held_out)
    rows: list[dict[str, Any]] = []
    for run in options.runs or list(RUNS)[: 1 if quick else None]:
        config = training_config(run, options.minutes, quick=quick)
        trainer = Trainer(config, PoseBank(bank_of, config.data), device=torch.device("cpu"))
        count = sum(len(garment.partitions) for garment in trainer.wardrobe.garments)
        train_for(trainer, options.minutes, options.train_steps)
        gains = measure(trainer, [*seen, *unseen], optima, poses)
        row = {"run": run, "garments": len(trainer.wardrobe.garments), "steps": trainer.step_count}
        row["partitions"] = count + trainer.step_count // config.data.fresh_steps
        rows.append(row | {f"gain_{name}": value for name, value in gains.items()})
        for label, group in (("seen", seen), ("unseen", unseen)):
            if group:
                rows[-1][f"mean_{label}"] = float(np.mean([gains[g.name] for g in group]))
        print(f"{run}: {trainer.step_count} steps", flush=True)
    gain_columns = {key: ".2f" for key in rows[0] if key.startswith(("gain_", "mean_"))}
    common.print_table(rows, COLUMNS | gain_columns)
    return common.finish("generality", rows, options, frames=list(poses.labels), minutes=options.minutes)


if __name__ == "__main__":
    sys.exit(ended(main))
