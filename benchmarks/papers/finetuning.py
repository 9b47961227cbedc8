"""Fine-tuned or from scratch: OneFit's table 2, on garments that the shipped model was never trained on.

    python -m benchmarks.papers.finetuning --garments $DRAPE_DATA/garments/NAME.obj ... --train-steps 1000 [--save]

Each garment is draped by the shipped model as it is, by the model fine-tuned on the garment for so many steps, and by
networks of the same size trained on that garment alone from nothing, for as many steps and for ``--patience`` times as
many. The network alone is judged on hard held-out poses, without export. The paper's own figures, in edge strain on its
jumpsuit, are 2.40 % as it is, 1.98 % fine-tuned for an hour, and 1.85 % from scratch in three (four A100).
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.papers.generality import train_for
from benchmarks.papers.held_out import JUDGING, HeldOut, training_clips
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.motion.clip import MotionClip
from training.config import PRESETS, TrainConfig
from training.evaluate import CPU
from training.model import OneFit
from training.poses import PoseBank
from training.starting import Weights, finetuned, read_model, with_garments
from training.trainer import Trainer

FIGURES = ("edge_pct", "area_pct", "colliding_vertex_pct", "energy_j", "gain")
COLUMNS = {
    "garment": "s", "network": "s", "steps": "d", "train_s": ".0f", "edge_pct": ".2f", "area_pct": ".2f",
    "colliding_vertex_pct": ".2f", "energy_j": ".4f", "gain": ".3f",
}  # fmt: skip


def configurations(model: Path, garment: str) -> dict[str, tuple[TrainConfig, Weights | None]]:
    """The start of "fine-tuned" and of "from scratch" on the file ``garment``, by name."""
    scratch = with_garments(PRESETS["shipped"](), [garment])
    return {"fine-tuned": finetuned(model, [garment]), "from scratch": (scratch, None)}


def rows_of(
    path: Path, model: Path, clips: list[MotionClip], held_out: HeldOut, *, steps: int, patience: int
) -> list[Row]:
    """Rows of the garment at ``path``."""
    garment = open_garment(path, held_out.body)
    weights, sizes, _ = read_model(model)
    shipped = OneFit(sizes)
    shipped.load_state_dict({name: value for name, value in weights.items() if not name.startswith("dynamic.")})
    networks = [({"network": "as shipped", "steps": 0, "train_s": 0.0}, shipped)]
    for name, (config, start) in configurations(model, str(path)).items():
        for count in (steps,) if start is not None else (steps, patience * steps):
            trainer = Trainer(config, PoseBank(clips, config.data), device=CPU, weights=start)
            begun = time.monotonic()
            train_for(trainer, config.minutes, count)
            told = {"network": name, "steps": trainer.step_count, "train_s": time.monotonic() - begun}
            networks.append((told, trainer.model))
            print(f"{garment.name}, {name}: {trainer.step_count} steps", flush=True)
    found = ((told, held_out.figures(network, garment)) for told, network in networks)
    return [{"garment": garment.name, **told, **{name: all_[name] for name in FIGURES}} for told, all_ in found]


@Benchmark(
    "finetuning",
    "Fine-tuned or from scratch.",
    COLUMNS,
    Option("--garments", (), "files or folders, or names of shipped ones", ("tank",)),
    Option("--model", Path("onefit"), "what is fine-tuned, as training.run takes it", kind=Path),
    Option("--train-steps", 1000, "of each run", 4),
    Option("--patience", 3, "times as many steps of a second run from scratch"),
    *JUDGING,
)
def main(run: Run) -> None:
    """Rows of every garment and network, and the mean gain of each network."""
    options, config = run.options, PRESETS["shipped"]()
    held_out = HeldOut(config, load_body(), options.frames, options.steps)
    clips = training_clips(config)
    steps = {"steps": options.train_steps, "patience": options.patience}
    for path in find_garments(options.garments):
        run.add(rows_of(path, options.model, clips, held_out, **steps))
    groups: dict[str, list[float]] = {}
    for row in run.rows:
        groups.setdefault(f"{row['network']}, {row['steps']} steps", []).append(row["gain"])
    mean_gain = {name: float(np.mean(gains)) for name, gains in groups.items()}
    run.extra |= {"frames": list(held_out.poses.labels), "mean_gain": mean_gain}


if __name__ == "__main__":
    main.command()
