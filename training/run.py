"""Trains the draping network.

    python -m training.run --preset shipped --out runs/shipped [--minutes 95] [--motions DIR ...]
    python -m training.run --resume runs/shipped

Self-supervised: each step draws a garment, one of its random partitions and a batch of
poses, and lowers the total energy of the cloth on the posed body. A step whose loss or
gradient is not finite is not taken: the last good state comes back and the rate halves.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from drape.body.assets import load_body
from drape.cloth.material import material
from drape.data_paths import data_folder
from drape.errors import InputError
from training import checkpoint, losses, parallel
from training.config import PRESETS, TrainConfig
from training.data import BodySource, collider_surface
from training.model import OneFit
from training.poses import PoseBank, draw_betas, read_clips
from training.wardrobe import Wardrobe

EARLY_AGREEMENT = 0.02  # share of the weight of disagreement at the start
SAMPLE_VERTICES = 384  # per step, for the disagreement of charts
HALVINGS_MAX = 8


class Trainer:
    """The state of a run: model, optimiser, random sources, and how far it is."""

    def __init__(self, config: TrainConfig, bank: PoseBank, *, device: torch.device) -> None:
        self.config, self.bank, self.device = config, bank, device
        torch.manual_seed(config.seed)
        self._seed_draws(config.seed)
        self.body = load_body()
        self.source = BodySource(self.body, *collider_surface(self.body), device=device)
        self.material = material()
        self.wardrobe = Wardrobe(config.data, self.body, seed=config.seed + 3, device=device, process=parallel.rank())
        self.model = OneFit(config.model).to(device)
        self._set_statistics()
        parallel.share(self.model)  # statistics are of this process's garments: all take those of the first
        self.optimiser = torch.optim.Adam(self.model.parameters(), lr=config.learning_rate)
        self.step_count = 0
        self.frame_count = 0
        self.elapsed_s = 0.0
        self.rate_factor = 1.0
        self.halvings = 0

    def _seed_draws(self, seed: int) -> None:
        """Random sources of this process: every process of a parallel run draws its own batches."""
        sequence = np.random.SeedSequence(seed, spawn_key=(parallel.rank(),) if parallel.rank() else ())
        self.rng = np.random.default_rng(sequence)
        self.generator = torch.Generator().manual_seed(seed + 1000003 * parallel.rank())

    def _set_statistics(self) -> None:
        garments = self.wardrobe.garments
        self.model.garment.standardise.set_from(torch.cat([p.features for g in garments for p in g.partitions]))
        poses = self.bank.draw(512, np.random.default_rng(self.config.seed + 1))
        betas = draw_betas(512, self.body.shape_count, self.config.data, np.random.default_rng(self.config.seed + 2))
        self.model.body.standardise.set_from(self.source.pose(poses, betas).tensors.features)

    def progress(self) -> float:
        """Share of the run's time that is used."""
        return min(1.0, self.elapsed_s / (60.0 * self.config.minutes))

    def rate(self) -> float:
        """Learning rate: a linear warm-up, then a cosine over the time the run has."""
        config = self.config
        warm = min(1.0, (self.step_count + 1) / config.warmup_steps)
        cosine = config.final_rate + 0.5 * (config.learning_rate - config.final_rate) * (
            1.0 + math.cos(math.pi * self.progress())
        )
        return self.rate_factor * warm * cosine

    def step(self, clock_s: float = 0.0) -> dict[str, float]:
        """One step at ``clock_s`` of the run; returns its loss parts, or {"skipped": 1} when it was not finite."""
        config = self.config
        if (self.step_count + 1) % config.data.fresh_steps == 0:
            self.wardrobe.refresh(self.rng)
        garment, partition = self.wardrobe.draw(self.rng)
        poses = self.bank.draw(config.batch_size, self.rng)
        betas = draw_betas(config.batch_size, self.body.shape_count, config.data, self.rng)
        batch = self.source.pose(poses, betas)
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        self.optimiser.zero_grad(set_to_none=True)
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=config.autocast):
            posed = self.model(batch.tensors, partition.patches, self.model.garment(partition.features))
        posed = replace(posed, jet=posed.jet.float())
        vertices = losses.garment_vertices(posed, partition, garment, batch.tensors, variant=config.model.variant)
        parts = losses.energy_loss(
            vertices, garment, batch, self.material, share=config.data.contact_share, generator=self.generator
        )
        sample = torch.randperm(vertices.shape[1], generator=self.generator)[:SAMPLE_VERTICES].to(self.device)
        # Per area, so that a dress does not outweigh a tank top.
        area = float(garment.rest.areas.sum())
        contact = losses.soften(parts["contact"] / area, config.contact_knee_j_m2).mean()
        parts = {name: value.mean() for name, value in parts.items()}
        parts["disagreement"] = losses.disagreement(posed, partition, sample)
        elastic = parts["membrane"] + parts["bending"] + parts["gravity"]
        agree = config.disagreement_weight * (EARLY_AGREEMENT + self.progress()) * parts["disagreement"]
        loss = elastic / area + contact + agree
        loss.backward()
        self.elapsed_s = parallel.average_gradients(self.model, clock_s)
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        self.step_count += 1
        self.frame_count += config.batch_size * parallel.world_size()
        # A loss that is not finite has a gradient that is not; the averaged gradient is the same everywhere.
        if not bool(torch.isfinite(norm)):
            return {"skipped": 1.0}
        self.optimiser.step()
        return {name: float(value.detach()) / area for name, value in parts.items() if name != "disagreement"} | {
            "disagreement_mm": 1e3 * math.sqrt(max(float(parts["disagreement"].detach()), 0.0)),
            "gradient_norm": float(norm),
            "loss": float(loss.detach()),
        }

    def state(self) -> dict:
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step_count,
            "frames": self.frame_count,
            "elapsed_s": self.elapsed_s,
            "rate_factor": self.rate_factor,
            "partitions": self.wardrobe.seeds(),
            "torch_random": torch.get_rng_state(),
            "sample_random": self.generator.get_state(),
            "numpy_random": _plain(self.rng.bit_generator.state),
        }

    def restore(self, state: dict) -> None:
        """The state of ``state``; in a parallel run only process 0 continues its random draws exactly."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step_count, self.elapsed_s, self.rate_factor = state["step"], state["elapsed_s"], state["rate_factor"]
        self.frame_count = state.get("frames", state["step"] * self.config.batch_size)
        if parallel.rank():
            self._seed_draws(self.config.seed + self.step_count)
            return
        if "partitions" in state:
            self.wardrobe.restore(state["partitions"])
        torch.set_rng_state(state["torch_random"])
        self.generator.set_state(state["sample_random"])
        self.rng.bit_generator.state = {
            **state["numpy_random"],
            "state": {k: int(v) for k, v in state["numpy_random"]["state"].items()},
        }


def _plain(state: Mapping[str, Any]) -> dict[str, Any]:
    # The 128-bit integers of PCG64 do not fit a tensor file: as text they do.
    return {**state, "state": {key: str(value) for key, value in state["state"].items()}}


def train(trainer: Trainer, out: Path) -> None:
    """Runs until the configured minutes are used; checkpoints in ``out``, curves for TensorBoard beside them."""
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
        frames += config.batch_size * parallel.world_size()
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


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description="Trains the draping network.")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="shipped")
    parser.add_argument("--out", type=Path, default=Path("runs/shipped"))
    parser.add_argument("--resume", type=Path, help="folder of an earlier run to go on with")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--motions", type=Path, nargs="*", help="folders of motion files; default DRAPE_DATA/motions")
    parser.add_argument("--threads", type=int, help="of torch; one is steadier beside other programs")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    out = arguments.resume or arguments.out
    state, config = checkpoint.load(out / "checkpoint.pt") if arguments.resume else (None, PRESETS[arguments.preset]())
    if arguments.minutes is not None:
        config = replace(config, minutes=arguments.minutes)
    if arguments.threads is not None:
        config = replace(config, threads=arguments.threads)
    torch.set_num_threads(config.threads)
    folders = arguments.motions or [f for f in [data_folder("motions")] if f is not None] or [sample_motions()]
    bank = PoseBank(read_clips(folders, held_out=config.data.held_out), config.data)
    device = torch.device(arguments.device)
    parallel.start(device)
    trainer = Trainer(config, bank, device=device)
    weights = sum(p.numel() for p in trainer.model.parameters())
    print(f"{bank.frame_count} poses, {len(trainer.wardrobe.garments)} garments, {weights} weights")
    if state is not None:
        trainer.restore(state)
    train(trainer, out)
    parallel.stop()


def sample_motions() -> Path:
    """The folder of the clips that the product ships."""
    return Path(__file__).resolve().parents[1] / "assets" / "motions"


if __name__ == "__main__":
    main()
