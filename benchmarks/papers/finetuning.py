"""Fine-tuned or from scratch: OneFit's table 2, on garments that the shipped model was never trained on.

    python -m benchmarks.papers.finetuning --garments $DRAPE_DATA/garments/NAME.obj ... --train-steps 1000 [--save]

Each garment is draped by the shipped model as it is, by the model fine-tuned on the garment for so many steps, and by
networks of the same size trained on that garment alone from nothing, for as many steps and for ``--patience`` times as
many. Judged on hard held-out poses, the network alone, without export. The paper's own figures, in edge strain on its
jumpsuit: 2.40 % as it is, 1.98 % fine-tuned for an hour, 1.85 % from scratch in three (four A100).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.judge import physics
from benchmarks.papers.generality import physics_energy, train_for
from benchmarks.shared import common
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact
from drape.errors import ended
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.motion.clip import MotionClip
from drape.motion.hard_poses import HardPoses, hard_poses
from training.config import PRESETS, TrainConfig
from training.data import BodySource
from training.evaluate import evaluate, held_out_clips, posed_patches
from training.model import OneFit
from training.poses import PoseBank, read_clips
from training.run import sample_motions
from training.starting import Weights, finetuned, read_model, with_garments
from training.trainer import Trainer

STEPS, QUICK_STEPS = 1000, 4
PATIENCE = 3
CPU = torch.device("cpu")
COLUMNS = {
    "garment": "s", "network": "s", "steps": "d", "train_s": ".0f", "edge_pct": ".2f", "area_pct": ".2f",
    "colliding_vertex_pct": ".2f", "energy_j": ".4f", "gain": ".3f",
}  # fmt: skip


def configurations(model: Path, garment: str) -> dict[str, tuple[TrainConfig, Weights | None]]:
    """What "fine-tuned" and "from scratch" on the file ``garment`` start from, by name."""
    scratch = with_garments(PRESETS["shipped"](), [garment])
    return {"fine-tuned": finetuned(model, [garment]), "from scratch": (scratch, None)}


def measured(
    model: OneFit, garment: Garment, source: BodySource, poses: HardPoses, optimum_j: float
) -> dict[str, float]:
    """Strains [%], colliding vertices [%], energy [J] and gain of the network alone."""
    model.eval()
    rows = {row["method"]: row for row in evaluate(model, garment, source.body, poses)}
    network, skinning_j = rows["network"], rows["skinning_push"]["energy_j"]
    vertices, _ = posed_patches(model, garment, source, poses.poses)
    skin = source.body.posed_vertices(poses.poses)
    normals = np.asarray(BodyContact(source.body.faces, source.body.vertex_count).normals(skin))
    return {
        "edge_pct": network["edge_pct"],
        "area_pct": network["area_pct"],
        "colliding_vertex_pct": float(metrics.colliding_vertex_pct(vertices, skin, normals).mean()),
        "energy_j": network["energy_j"],
        "gain": metrics.gain(skinning_j, network["energy_j"], optimum_j),
    }


def rows_of(
    path: Path,
    garment: Garment,
    model: Path,
    source: BodySource,
    poses: HardPoses,
    clips: list[MotionClip],
    *,
    steps: int,
    patience: int,
    physics_steps: int,
) -> list[dict[str, Any]]:
    """Rows of one garment."""
    optimum_j = physics_energy(garment, source.body, poses, steps=physics_steps)
    weights, sizes, _ = read_model(model)
    shipped = OneFit(sizes)
    shipped.load_state_dict({name: value for name, value in weights.items() if not name.startswith("dynamic.")})
    rows = [
        {"network": "as shipped", "steps": 0, "train_s": 0.0} | measured(shipped, garment, source, poses, optimum_j)
    ]
    for name, (config, start) in configurations(model, str(path)).items():
        for count in (steps,) if start is not None else (steps, patience * steps):
            trainer = Trainer(config, PoseBank(clips, config.data), device=CPU, weights=start)
            begun = time.monotonic()
            train_for(trainer, config.minutes, count)
            row = {"network": name, "steps": trainer.step_count, "train_s": time.monotonic() - begun}
            rows.append(row | measured(trainer.model, garment, source, poses, optimum_j))
            print(f"{garment.name}, {name}: {trainer.step_count} steps, gain {rows[-1]['gain']:.3f}", flush=True)
    return [{"garment": garment.name, **row} for row in rows]


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.papers.finetuning", description="Fine-tuned or from scratch."
    )
    parser.add_argument(
        "--garments", nargs="+", default=[], help="files or folders (default: the shipped; quick: tank)"
    )
    parser.add_argument(
        "--model", type=Path, default=Path("onefit"), help="what is fine-tuned, as training.run takes it"
    )
    parser.add_argument("--train-steps", type=int, help=f"of each run (default {STEPS}, quick {QUICK_STEPS})")
    parser.add_argument(
        "--patience", type=int, default=PATIENCE, help="times as many steps of a second run from scratch"
    )
    parser.add_argument("--frames", type=int, help="hard poses (default 4, quick 1)")
    parser.add_argument("--steps", type=int, help=f"most physics steps (default {physics.STEPS}, quick 30)")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    steps = options.train_steps or (QUICK_STEPS if options.quick else STEPS)
    body = load_body()
    source = BodySource(body, device=CPU)
    clips = read_clips([data_folder("motions") or sample_motions()], held_out=PRESETS["shipped"]().data.held_out)
    poses = hard_poses(held_out_clips(PRESETS["shipped"](), []), body, options.frames or (1 if options.quick else 4))
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments or (["tank"] if options.quick else [])):
        garment = open_garment(path, body)
        rows += rows_of(
            path, garment, options.model, source, poses, clips, steps=steps, patience=options.patience,
            physics_steps=options.steps or (30 if options.quick else physics.STEPS),
        )  # fmt: skip
    common.print_table(rows, COLUMNS)
    means = {
        name: float(np.mean([row["gain"] for row in rows if (row["network"], row["steps"]) == name]))
        for name in dict.fromkeys((row["network"], row["steps"]) for row in rows)
    }
    mean_gain = {f"{name}, {count} steps": gain for (name, count), gain in means.items()}
    return common.finish("finetuning", rows, options, frames=list(poses.labels), mean_gain=mean_gain)


if __name__ == "__main__":
    sys.exit(ended(main))
