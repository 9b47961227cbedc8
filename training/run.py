"""Trains the draping network.

    python -m training.run --preset shipped --out runs/shipped [--minutes 95] [--motions DIR ...]
    python -m training.run --preset dynamic --from runs/shipped/checkpoint.pt [--encoder onefit] --out runs/dynamic
    python -m training.run --finetune onefit --garment shirt.obj --out runs/shirt
    python -m training.run --finetune onefit --beside runs/sewn_garments --out runs/sewn_too
    python -m training.run --garment shirt.obj --minutes 10 --out runs/scratch
    python -m training.run --resume runs/shipped

Self-supervised: each step draws a garment, one of its random partitions and a batch of
poses, and lowers the total energy of the cloth on the posed body. A step whose loss or
gradient is not finite is not taken: the last good state comes back and the rate halves.
"""

from __future__ import annotations

import argparse
import copy
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from drape.arrays.subnormals import flushed
from drape.catalog import MOTIONS_DIR
from drape.errors import InputError, refusing
from drape.files.data import data_folder
from drape.motion.clip import MotionClip
from training import checkpoint, parallel
from training.config import PRESETS, TrainConfig
from training.dynamics import DynamicTrainer
from training.poses import PoseBank, read_training_clips
from training.starting import finetune_from, start_from, with_garments, with_more_garments
from training.targets import SettledBank
from training.trainer import BaseTrainer, Trainer
from training.windows import WindowBank

HALVINGS_MAX = 8


def train(trainer: BaseTrainer, out: Path) -> None:
    """Takes steps of ``trainer`` until the configured minutes are used. Writes checkpoints to ``checkpoint.pt`` in
    ``out``, and curves for TensorBoard to ``log`` there.

    Raises ``InputError`` after more than ``HALVINGS_MAX`` steps that were not finite.
    """
    from tqdm import tqdm

    config = trainer.config
    leading = parallel.rank() == 0
    writer = SummaryWriter(str(out / "log")) if leading else None
    last_good = copy.deepcopy(trainer.state())
    begun, saved = time.monotonic() - trainer.elapsed_s, time.monotonic()
    bar = tqdm(
        total=round(60 * config.minutes),
        unit="s",
        mininterval=5.0,
        initial=round(trainer.elapsed_s),
        disable=not leading,
    )
    running: dict[str, float] = {}
    frames, since = 0, time.monotonic()
    while trainer.elapsed_s < 60.0 * config.minutes:
        result = trainer.step(time.monotonic() - begun)
        if "skipped" in result:
            trainer.halvings += 1
            if trainer.halvings > HALVINGS_MAX:
                raise InputError(
                    "training",
                    expected="finite steps",
                    got=f"{trainer.halvings} that were not",
                    cure="Lower learning_rate.",
                )
            keep = trainer.step_count, trainer.elapsed_s, trainer.rate_factor / 2.0
            trainer.restore(copy.deepcopy(last_good))
            trainer.step_count, trainer.elapsed_s, trainer.rate_factor = keep
            bar.write(
                f"step {trainer.step_count}: not finite; last good state restored, rate factor {trainer.rate_factor:g}"
            )
            continue
        frames += config.frames_per_step * parallel.world_size()
        for key, value in result.items():
            running[key] = value if key not in running else 0.98 * running[key] + 0.02 * value
        if trainer.step_count % 50 == 0:
            speed = frames / (time.monotonic() - since)
            frames, since = 0, time.monotonic()
            if writer is not None:
                for key, value in {**running, "frames_per_s": speed}.items():
                    writer.add_scalar(key, value, trainer.step_count)
            bar.n = round(trainer.elapsed_s)
            bar.set_postfix_str(
                " ".join(f"{k}={v:.3g}" for k, v in running.items()) + f" step={trainer.step_count} f/s={speed:.0f}"
            )
        if trainer.step_count % 500 == 0:
            last_good = copy.deepcopy(trainer.state())
        if leading and time.monotonic() - saved > 60.0 * config.checkpoint_minutes:
            checkpoint.save(out / "checkpoint.pt", trainer.state(), config)
            saved = time.monotonic()
    if leading:
        checkpoint.save(out / "checkpoint.pt", trainer.state(), config)
    bar.close()
    if writer is not None:
        writer.close()


@refusing
def main() -> int:
    """Runs the command line. Returns 0, or 2 after a refusal, whose sentence it prints."""
    parser = argparse.ArgumentParser(description="Trains the draping network.")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--preset", choices=sorted(PRESETS), default="shipped")
    kind.add_argument("--finetune", type=Path, metavar="MODEL", help="model to go on with, maybe on --garment")
    kind.add_argument("--resume", type=Path, help="folder of an earlier run to go on with")
    parser.add_argument("--garment", nargs="+", help="garment files or names of designs, instead of the preset's")
    parser.add_argument(
        "--beside", nargs="+", metavar="FILE", help="garment files, or folders of them, trained on beside the others"
    )
    parser.add_argument("--settled", type=Path, metavar="FOLDER", help="drapes of python -m training.settled")
    parser.add_argument("--out", type=Path, default=Path("runs/shipped"), help="folder of a new run (%(default)s)")
    parser.add_argument("--from", type=Path, dest="start", help="static model to add dynamics to")
    parser.add_argument(
        "--encoder", type=Path, metavar="MODEL", help="with --from: begin with the motion of this exported model"
    )
    parser.add_argument(
        "--minutes", type=float, help="of training in all, those before --resume included; default: the preset's"
    )
    parser.add_argument("--motions", type=Path, nargs="*", help="folders of motion files; default DRAPE_DATA/motions")
    parser.add_argument("--threads", type=int, help="of torch; one is steadier beside other programs")
    parser.add_argument("--batch", type=int, help="frames, of a dynamic model windows, per step of each process")
    parser.add_argument(
        "--bf16", action="store_true", help="matrices in bfloat16 (docs/guide/training.md says when it pays)"
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    with flushed():  # torch starts its threads at its first large operation, and they inherit it
        _run(arguments)
    return 0


def _run(arguments: argparse.Namespace) -> None:
    state, weights = None, None
    if not arguments.resume and (stored := arguments.out / "checkpoint.pt").is_file():
        raise InputError(
            "--out",
            expected="a folder without an earlier run",
            got=str(stored),
            cure=f"Go on with it (--resume {arguments.out}), or name another folder.",
        )
    if arguments.resume:
        for option, named in (("--garment", arguments.garment), ("--beside", arguments.beside)):
            if named:
                raise InputError(
                    option, expected="nothing with --resume", got=named[0], cure="A run keeps its garments."
                )
        state, config = checkpoint.load_checkpoint(arguments.resume / "checkpoint.pt")
    elif arguments.finetune:
        config, weights = finetune_from(arguments.finetune, arguments.garment)
    else:
        config, weights = start_from(PRESETS[arguments.preset](), arguments.start, arguments.encoder)
        config = with_garments(config, arguments.garment)
    config = with_more_garments(config, arguments.beside)
    chosen = {"minutes": arguments.minutes, "threads": arguments.threads, "batch_size": arguments.batch}
    chosen["autocast"] = arguments.bf16 or None
    config = replace(config, **{name: value for name, value in chosen.items() if value is not None})
    if state is not None and state["elapsed_s"] >= 60.0 * config.minutes:
        print(f"nothing left to do: the run has had its {config.minutes:g} minutes; --minutes says more")
        return
    torch.set_num_threads(config.threads)
    folders = arguments.motions or [f for f in [data_folder("motions")] if f is not None] or [MOTIONS_DIR]
    device = torch.device(arguments.device)
    parallel.start_rank(device)
    clips = read_training_clips(folders, held_out=config.data.held_out)
    settled = None if arguments.settled is None else SettledBank(arguments.settled)
    trainer = make_trainer(config, clips, device=device, weights=weights, settled=settled)
    count = sum(p.numel() for p in trainer.model.parameters() if p.requires_grad)
    print(f"{trainer.bank.frame_count} poses, {len(trainer.wardrobe.garments)} garments, {count} weights to learn")
    if state is not None:
        trainer.restore(state)
    folder = arguments.resume or arguments.out
    train(trainer, folder)
    if parallel.rank() == 0:
        spent = trainer.elapsed_s / 60.0
        print(f"stored    {folder / 'checkpoint.pt'}: step {trainer.step_count} after {spent:.1f} minutes in all")
    parallel.stop()


def make_trainer(
    config: TrainConfig,
    clips: list[MotionClip],
    *,
    device: torch.device,
    weights: dict[str, Any] | None = None,
    settled: SettledBank | None = None,
) -> Trainer | DynamicTrainer:
    """Returns the trainer of a network as ``config`` describes it: of motion for a dynamic network, else of the static
    drape. ``weights`` are those to start from. Raises ``InputError`` for a dynamic network with ``settled`` drapes."""
    if config.model.dynamic:
        if settled is not None:
            raise InputError(
                "--settled", expected="a static model", got="a dynamic one", cure="Train the static one first."
            )
        return DynamicTrainer(config, WindowBank(clips, config.data, config.motion), device=device, weights=weights)
    return Trainer(config, PoseBank(clips, config.data), device=device, weights=weights, settled=settled)


if __name__ == "__main__":
    sys.exit(main())
