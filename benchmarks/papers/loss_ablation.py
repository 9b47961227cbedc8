"""What each loss does: one small network trained with each set of losses, in the form of the paper's table 4.

    python -m benchmarks.papers.loss_ablation --minutes 15 --save
    python -m benchmarks.papers.loss_ablation --steps 8000 --save     # the same number of steps each
    python -m benchmarks.papers.loss_ablation --losses house paper --variant paper --minutes 15

``paper`` are all terms of equation 10, ``no_TERM`` leaves one out: ``edges`` is their L_mesh_inext, ``metric`` their
L_inext, ``collision`` their L_col. Beside them stand the figures of OneFit's table 4, of another tank top, another body
and other motion: what may be compared is in which direction a term moves a column. All runs share configuration, seed,
first weights and the order of garments, partitions and poses; they differ in the loss alone (losses.py;
``house`` is training.run's own). Judged on hard poses of clips that were held out, on the shipped garment of the same
design. Inertia has nothing to do here, as the network is static. A run
that is already finished under ``--runs`` is not trained again.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from benchmarks.harness import ROOT, Benchmark, Option, Run
from benchmarks.measure.judged import Judged
from benchmarks.papers import losses as paper_losses
from benchmarks.papers.held_out import figures, judged, training_clips
from benchmarks.papers.losses import ChartSamples, ChartSurface
from drape.body.assets import load_body
from drape.cloth.contact import plane_distance
from drape.cloth.material import material
from drape.errors import ArtifactError
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.geometry.meshes import edge_lengths, unique_edges
from drape.motion.hard_poses import hard_poses
from training import checkpoint, losses
from training.collider import nearest_rows
from training.config import DataConfig, ModelConfig, TrainConfig, as_published
from training.data import BodyBatch, Partition, TrainingGarment
from training.disagreement import disagreement
from training.evaluate import held_out_clips, posed_patches
from training.garment_design import DESIGNS, cut_garment
from training.model import OneFit, Posed
from training.poses import PoseBank
from training.run import train
from training.trainer import SAMPLE_VERTICES, Draped, Objective, Trainer

EPOCHS = 100.0  # what a run counts as, for k_ext: its full value is reached at the end
METRIC_WEIGHT = 14.0  # [J/m^2 per m^2] beside the house energy: 1 % stretch of a T-shirt costs what its membrane does
# OneFit, table 4, on their tank top: edge strain [%], area strain [%], colliding vertices [%]. The copy at hand is
# damaged: of the first column some digits cannot be read, and stand for nothing here.
PUBLISHED: dict[str, tuple[float | None, float, float]] = {
    "paper": (7.8, 13.02, 0.227),
    "no_edges": (13.175, 24.011, 0.203),
    "no_metric": (None, 12.76, 1.641),
    "no_collision": (8.004, 13.373, 0.387),
}
COLUMNS = {
    "loss": "s", "steps": "d", "edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".3f",
    "published_edge_pct": ".1f", "published_area_pct": ".1f", "published_colliding_pct": ".3f", "energy_j": ".4f",
    "membrane_j": ".4f", "bending_j": ".4f", "contact_j": ".4f", "share": ".3f", "chart_gap_p99_mm": ".2f",
    "chart_normal_p99_deg": ".1f",
}  # fmt: skip


@dataclass(frozen=True)
class LossSet:
    """Terms that are summed: ``house``, the energy and the disagreement of training.run; ``metric``, equation 3 beside
    it; ``paper``, terms of equation 10."""

    name: str
    house: bool = False
    metric: bool = False
    paper: tuple[str, ...] = ()


PAPER_TERMS = ("collision", "metric", "edges", "boundary", "gravity")
LOSS_SETS = {
    found.name: found
    for found in (
        LossSet("house", house=True),
        LossSet("house_metric", house=True, metric=True),
        LossSet("paper", paper=PAPER_TERMS),
        *(LossSet(f"no_{term}", paper=tuple(t for t in PAPER_TERMS if t != term)) for term in PAPER_TERMS),
    )
}


class LossTrainer(Trainer):
    """The trainer with another loss. Everything else, the random draws included, is training.run's.

    With ``steps`` the run's time is counted in steps: it ends after so many, whatever the clock says.
    """

    def __init__(
        self, config: TrainConfig, bank: PoseBank, chosen: LossSet, *, device: torch.device, steps: int | None = None
    ) -> None:
        super().__init__(config, bank, device=device)
        self.steps = steps
        self.chosen = chosen
        self._rest_jets: WeakKeyDictionary[Partition, Tensor] = WeakKeyDictionary()
        self._edges: dict[str, tuple[Tensor, Tensor]] = {}
        self._gradients: dict[str, Tensor] = {}

    def step(self, clock_s: float = 0.0) -> dict[str, float]:
        """One step; with ``steps`` the clock shows what share of them is done."""
        if self.steps:
            clock_s = 60.0 * self.config.minutes * (self.step_count + 1) / self.steps
        return super().step(clock_s)

    def objective(self) -> Objective:
        """The weighted terms of ``self.chosen`` on a batch that is drawn now, means over it; the loss is their sum."""
        garment, partition, batch = self._draw()
        draped = self.drape(batch, garment, partition, passes=self._passes())
        draped = replace(draped, posed=replace(draped.posed, jet=draped.posed.jet.float()))
        terms = (self._house if self.chosen.house else self._paper)(draped, garment, partition, batch)
        with torch.no_grad():
            charts = self._disagreement(draped.coefficients, partition)
        return Objective(torch.stack(list(terms.values())).sum(), terms, charts)

    def _paper(
        self, draped: Draped, garment: TrainingGarment, partition: Partition, batch: BodyBatch
    ) -> dict[str, Tensor]:
        vertices, posed = draped.vertices, draped.posed
        count, share = vertices.shape[1], self.config.data.contact_share
        near = torch.randperm(count, generator=self.generator)[: max(1, round(share * count))].to(self.device)
        depth = self._depth(vertices, near, batch)
        samples, surface = self._charts(posed, garment, partition, batch, near[:SAMPLE_VERTICES])
        edges, lengths = self._mesh_edges(garment)
        found = {
            # The sum over all points, from a share of them.
            "collision": paper_losses.collision(depth) * (count / len(near)),
            "metric": self._metric(surface, samples, depth[:, :SAMPLE_VERTICES]),
            "edges": paper_losses.edge_inextensibility(vertices, edges, lengths),
            "boundary": paper_losses.boundary(surface, samples.weight),
            "gravity": paper_losses.gravity(vertices, garment.cloth, self.material),
        }
        return {name: paper_losses.WEIGHTS[name] * found[name].mean() for name in self.chosen.paper}

    def _house(
        self, draped: Draped, garment: TrainingGarment, partition: Partition, batch: BodyBatch
    ) -> dict[str, Tensor]:
        """The loss of ``Trainer``, by term, with the changes that were chosen."""
        vertices, posed = draped.vertices, draped.posed
        config = self.config
        parts = self._energy(vertices, garment, self._planes(vertices, batch))
        terms = {"contact": losses.soften(parts["contact"], config.contact_knee_j_m2).mean()}
        terms |= {name: parts[name].mean() for name in ("membrane", "bending", "gravity")}
        share = config.early_agreement + (1.0 - config.early_agreement) * self.progress()
        terms["disagreement"] = config.disagreement_weight * share * self._disagreement(draped.coefficients, partition)
        if self.chosen.metric:
            sample = torch.randperm(vertices.shape[1], generator=self.generator)[:SAMPLE_VERTICES].to(self.device)
            samples, surface = self._charts(posed, garment, partition, batch, sample)
            terms["metric"] = (
                METRIC_WEIGHT * self._metric(surface, samples, self._depth(vertices, sample, batch)).mean()
            )
        return terms

    def _depth(self, vertices: Tensor, sample: Tensor, batch: BodyBatch) -> Tensor:
        """How far (F, n) [m] the sampled vertices lie below their distance from the posed body."""
        points = vertices.index_select(1, sample)
        index = nearest_rows(points.detach().cpu().numpy(), batch.collider)
        frame = np.arange(len(index))[:, None]
        point, normal = (
            torch.from_numpy(array[frame, index].astype(np.float32)).to(self.device)
            for array in (batch.collider, batch.collider_normals)
        )
        return paper_losses.collision_depth(plane_distance(points, point, normal), self.material.contact_gap_m)

    def _charts(
        self, posed: Posed, garment: TrainingGarment, partition: Partition, batch: BodyBatch, vertex: Tensor
    ) -> tuple[ChartSamples, ChartSurface]:
        if partition not in self._rest_jets:
            self._rest_jets[partition] = paper_losses.rest_jets(partition)
        samples = paper_losses.chart_samples(partition, self._rest_jets[partition], vertex)
        if self.config.model.variant != "paper":
            return samples, paper_losses.chart_surface(posed, samples)
        if garment.name not in self._gradients:
            gradients = paper_losses.weight_gradients(garment.rest).astype(np.float32)
            self._gradients[garment.name] = torch.from_numpy(gradients).to(self.device)
        skin = paper_losses.Skin.at(vertex, garment.skin_weights, self._gradients[garment.name], batch.tensors)
        return samples, paper_losses.chart_surface(posed, samples, skin=skin)

    def _metric(self, surface: ChartSurface, samples: ChartSamples, depth: Tensor) -> Tensor:
        stretch = paper_losses.allowed_stretch(depth.detach(), EPOCHS * self.progress())
        return paper_losses.metric_inextensibility(surface.metric, samples.rest_metric, stretch, samples.weight)

    def _mesh_edges(self, garment: TrainingGarment) -> tuple[Tensor, Tensor]:
        if garment.name not in self._edges:
            edges = unique_edges(garment.rest.faces)
            lengths = edge_lengths(garment.rest.vertices, edges).astype(np.float32)
            found = torch.from_numpy(np.ascontiguousarray(edges.T)), torch.from_numpy(lengths)
            self._edges[garment.name] = found[0].to(self.device), found[1].to(self.device)
        return self._edges[garment.name]


def small_config(options: argparse.Namespace) -> TrainConfig:
    """What all runs share: one garment, four partitions, the network of the shipped model or the paper's heads."""
    # Without what makes charts agree by itself: what the losses do to them is to be seen.
    model = ModelConfig(agreed_base=False, corrections=0, closing_fit=False, feels_body=False)
    model = as_published(model) if options.variant == "paper" else model
    data = DataConfig(garments=(options.garment,), partitions=4, variants=0)
    return TrainConfig(model=model, data=data, minutes=options.minutes, warmup_steps=50, threads=options.threads)


def trained(
    chosen: LossSet, config: TrainConfig, bank: PoseBank, folder: Path, *, steps: int | None = None
) -> LossTrainer:
    """The run of ``chosen``: the finished one in ``folder`` if it has this configuration, else a new one."""
    trainer = LossTrainer(config, bank, chosen, device=torch.device("cpu"), steps=steps)
    path = folder / "checkpoint.pt"
    if path.is_file():
        try:
            state, before = checkpoint.load(path)
        except ArtifactError as error:
            print(f"{chosen.name}: {error}", flush=True)
        else:
            ended = state["step"] == steps if steps else state["elapsed_s"] >= 60.0 * config.minutes
            if before == config and ended:
                trainer.restore(state)
                return trainer
    train(trainer, folder)
    return trainer


def charts_of(posed: Posed, garment: Garment) -> dict[str, float]:
    """How much the posed charts of ``garment`` disagree, at the 99th percentile."""
    rotation = posed.rotation.expand(*posed.centre.shape, 3).numpy()
    charts = disagreement(garment, posed.jet.numpy(), rotation, posed.centre.numpy())
    return {
        "chart_gap_p99_mm": 1e3 * float(np.percentile(charts.gap_m, 99.0)),
        "chart_normal_p99_deg": float(np.degrees(np.percentile(charts.normal_rad, 99.0))),
    }


def judge_network(model: OneFit, judge: Judged, poses: np.ndarray, trainer: Trainer) -> dict[str, float]:
    """Strains, collisions, energies and the charts' disagreement of ``model`` at ``poses`` (F, 24, 3)."""
    model.eval()
    vertices, posed = posed_patches(model, judge.cloth.garment, trainer.source, poses)
    return figures(judge, vertices) | charts_of(posed, judge.cloth.garment)


@Benchmark(
    "loss_ablation",
    "One small network, trained with each set of losses.",
    COLUMNS,
    Option("--minutes", 15.0, "per run", 0.05),
    Option("--steps", None, "steps per run, instead of minutes", kind=int),
    Option("--garment", "tank", "a design", choices=sorted(DESIGNS)),
    Option("--losses", tuple(LOSS_SETS), "sets of losses", ("house", "paper"), choices=LOSS_SETS),
    Option("--variant", "vector", "form of the patches", choices=("vector", "paper")),
    Option("--frames", 6, "held-out poses", 1),
    Option("--runs", ROOT / "runs" / "loss_ablation", "folder of the runs", kind=Path),
)
def main(run: Run) -> None:
    """A row for each set of losses, below those of skinning."""
    options, body = run.options, load_body()
    config, held_out = small_config(options), data_folder("motions") is not None
    bank = PoseBank(training_clips(config), config.data)
    poses = hard_poses(held_out_clips(config, []), body, options.frames)
    judge = judged(cut_garment(DESIGNS[options.garment], body), body, poses.poses, material())
    run.rows = [{"loss": "skinning", **figures(judge, judge.skinned)}]
    run.rows.append({"loss": "skinning_push", **figures(judge, judge.pushed)})
    for name in options.losses:
        trainer = trained(LOSS_SETS[name], config, bank, options.runs / options.variant / name, steps=options.steps)
        found = judge_network(trainer.model, judge, poses.poses, trainer)
        run.rows.append({"loss": name, "steps": trainer.step_count, **found})
        print(f"{name}: {trainer.step_count} steps, {found['energy_j']:.4f} J", flush=True)
    heads = ("published_edge_pct", "published_area_pct", "published_colliding_pct")
    for row in run.rows:
        row |= dict(zip(heads, PUBLISHED.get(row["loss"], ()), strict=False))
        row["share"] = row["energy_j"] / run.rows[1]["energy_j"]
    if not held_out:
        run.notes.append("trained on the shipped clips, which the poses come from as well: set DRAPE_DATA")
    run.extra |= {"minutes": None if options.steps else options.minutes, "garment": options.garment}
    run.extra |= {"variant": options.variant, "held_out": held_out, "frames": list(poses.labels)}


if __name__ == "__main__":
    main.command()
