"""The state of a training run and one step of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import DEFAULT_FABRIC, fabric
from drape.cloth.material import Material, material
from drape.errors import ArtifactError
from training import losses, parallel
from training.batches import BodyBatch, BodySource, Partition, TrainingGarment
from training.config import TrainConfig
from training.fabrics import FabricBank, stretch_share
from training.onefit import OneFit, Posed, posed_coefficients
from training.poses import PoseBank, draw_betas, rows_of_three
from training.targets import SettledBank, distance
from training.wardrobe import Wardrobe

SAMPLE_VERTICES = 384  # so many in a step measure the disagreement of charts


@dataclass(frozen=True, eq=False)
class BatchLoss:
    """What a batch costs: the ``loss`` [J/m^2] (), its ``parts`` () by name, [J/m^2] where the name has no unit, and
    the mean squared disagreement of ``charts`` [m^2] ()."""

    loss: Tensor
    parts: dict[str, Tensor]
    charts: Tensor

    def report(self) -> dict[str, float]:
        """Returns the parts, "disagreement_mm" (a root mean square) and "loss" as numbers by name."""
        numbers = {name: float(value.detach()) for name, value in self.parts.items()}
        numbers["disagreement_mm"] = 1e3 * math.sqrt(max(float(self.charts.detach()), 0.0))
        return numbers | {"loss": float(self.loss.detach())}


@dataclass(frozen=True, eq=False)
class DrapedBatch:
    """A garment draped on F bodies: its posed patches, their ``posed_coefficients`` (F, K, 19, 3), and its vertices [m]
    (F, V, 3) relative to the root joint."""

    posed: Posed
    coefficients: Tensor
    vertices: Tensor


class BaseTrainer:
    """The state of a run: model, optimiser, random sources, progress. A subclass says what it learns from.

    ``weights``: those of a model to start from.
    """

    def __init__(
        self, config: TrainConfig, *, device: torch.device, weights: Mapping[str, Tensor] | None = None
    ) -> None:
        self.config, self.device = config, device
        torch.manual_seed(config.seed)
        self._seed_draws(config.seed)
        self.body = load_body()
        self.source = BodySource(self.body, device=device)
        self.fabrics = FabricBank(config.data.held_out_fabrics) if config.model.fabric else None
        self.fabric = fabric(DEFAULT_FABRIC) if config.model.fabric else None  # a step draws another
        self.material = material() if self.fabric is None else Material.of(self.fabric)
        self.wardrobe = Wardrobe(
            config.data,
            self.body,
            seed=config.seed + 3,
            device=device,
            process=parallel.rank(),
            fabrics=config.model.fabric,
        )
        self.model = OneFit(config.model).to(device)
        self.model.autocast = config.autocast
        if weights is not None:
            take_weights(self.model, weights)
        self._set_statistics()
        if weights is not None:
            take_weights(self.model, weights)  # with the statistics they were trained on
        parallel.share(self.model)  # statistics are of this process's garments: all take those of the first
        self.optimiser = torch.optim.Adam(self._learning(), lr=config.learning_rate, fused=True)
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
        """Sets the statistics of the network's inputs."""
        raise NotImplementedError

    def objective(self) -> BatchLoss:
        """Draws a batch and returns its loss."""
        raise NotImplementedError

    def draw_fabric(self) -> None:
        """Draws the fabric that all garments are made of from now on; none for a network that knows no fabrics."""
        if self.fabrics is not None:
            self._wear(self.fabrics.draw(self.rng))

    def _wear(self, made_of: Fabric) -> None:
        self.fabric, self.material = made_of, Material.of(made_of)

    def _learning(self) -> list[nn.Parameter]:
        """The weights that learn."""
        return list(self.model.parameters())

    def progress(self) -> float:
        """Returns the share of the run's time that is used, from 0 to 1."""
        return min(1.0, self.elapsed_s / (60.0 * self.config.minutes))

    def rate(self) -> float:
        """Returns the learning rate of the next step: a linear warm-up times a cosine over the time of the run."""
        config = self.config
        warm = min(1.0, (self.step_count + 1) / config.warmup_steps)
        cosine = config.final_rate + 0.5 * (config.learning_rate - config.final_rate) * (
            1.0 + math.cos(math.pi * self.progress())
        )
        return self.rate_factor * warm * cosine

    @flushed()
    def step(self, clock_s: float = 0.0) -> dict[str, float]:
        """Takes one step of the optimiser at ``clock_s`` of the run. Returns ``BatchLoss.report`` and "gradient_norm",
        or {"skipped": 1} and leaves the weights where the gradient was not finite."""
        config = self.config
        if (self.step_count + 1) % config.data.fresh_steps == 0:
            self.wardrobe.refresh(self.rng)
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        self.draw_fabric()
        self.optimiser.zero_grad(set_to_none=True)
        objective = self.objective()
        objective.loss.backward()
        self.elapsed_s = parallel.average_gradients(self.model, clock_s)
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        self.step_count += 1
        self.frame_count += config.frames_per_step * parallel.world_size()
        # A loss that is not finite has a gradient that is not; the averaged gradient is the same everywhere.
        if not bool(torch.isfinite(norm)):
            return {"skipped": 1.0}
        self.optimiser.step()
        return objective.report() | {"gradient_norm": float(norm)}

    def drape(
        self,
        batch: BodyBatch,
        garment: TrainingGarment,
        partition: Partition,
        dynamic_code: Tensor | None = None,
        passes: int | None = None,
    ) -> DrapedBatch:
        """Returns the drape of ``garment``, with the patches of ``partition``, on the bodies of ``batch``.
        ``dynamic_code`` and ``passes`` are those of ``OneFit``."""
        embedding = self.model.garment(partition.encoder_inputs(self.fabric))
        posed = self.model(
            batch.tensors, partition.patches, embedding, dynamic_code, charts=partition.consensus, passes=passes
        )
        coefficients, variant = posed_coefficients(posed, partition.patches.scale), self.config.model.variant
        vertices = losses.garment_vertices(coefficients, partition, garment, batch.tensors, variant=variant)
        return DrapedBatch(posed, coefficients, vertices)

    def _planes(self, vertices: Tensor, batch: BodyBatch) -> losses.SampledPlanes:
        """Planes that some of ``vertices`` [m] (F, V, 3), drawn now, touch."""
        return losses.contact_planes(vertices, batch, share=self.config.data.contact_share, generator=self.generator)

    def _energy(self, vertices: Tensor, garment: TrainingGarment, planes: losses.SampledPlanes) -> dict[str, Tensor]:
        """Energy (F,) of the cloth by part, in units of ``_unit``."""
        parts = losses.energy_loss(vertices, garment, planes, self.material)
        return {name: value / self._unit(garment) for name, value in parts.items()}

    def _unit(self, garment: TrainingGarment) -> float:
        """Area [m^2], so that a dress does not outweigh a tank top, times the stretch of the fabric, so that a denim
        does not outweigh a jersey."""
        return float(garment.rest.areas.sum()) * self._stretch_share

    @property
    def _stretch_share(self) -> float:
        return 1.0 if self.fabric is None else stretch_share(self.fabric)

    def _disagreement(self, coefficients: Tensor, partition: Partition) -> Tensor:
        """``losses.chart_disagreement`` [m^2] at some vertices drawn now."""
        count = partition.chart_patch.shape[0]
        sample = torch.randperm(count, generator=self.generator)[:SAMPLE_VERTICES].to(self.device)
        return losses.chart_disagreement(coefficients, partition, sample)

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
        """Puts the run into ``state``, which ``BaseTrainer.state`` returned.

        In a parallel run only process 0 continues its random draws exactly.
        """
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step_count, self.elapsed_s, self.rate_factor = state["step"], state["elapsed_s"], state["rate_factor"]
        self.frame_count = state.get("frames", state["step"] * self.config.frames_per_step)
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


def take_weights(model: OneFit, weights: Mapping[str, Tensor]) -> None:
    """Loads ``weights`` into ``model``. Weights of a static model leave the recurrent encoder as it is.

    Raises ``ArtifactError`` where they are those of another network.
    """
    try:
        missing, unknown = model.load_state_dict(weights, strict=False)
    except RuntimeError as error:
        missing, unknown = [], [" ".join(str(error).split())[:200]]
    strange = [*unknown, *(name for name in missing if not name.startswith("dynamic."))]
    if strange:
        raise ArtifactError(
            "weights to start from",
            expected="those of a network of this size",
            got=", ".join(strange[:3]),
            cure="Take a checkpoint of the same architecture.",
        )


class Trainer(BaseTrainer):
    """The trainer of the static drape, in the poses of ``bank``. Steps without corrections learn ``settled`` drapes, if
    any are given."""

    def __init__(
        self,
        config: TrainConfig,
        bank: PoseBank,
        *,
        device: torch.device,
        weights: Mapping[str, Tensor] | None = None,
        settled: SettledBank | None = None,
    ) -> None:
        self.bank, self.settled = bank, settled
        super().__init__(config, device=device, weights=weights)

    def _set_statistics(self) -> None:
        garments = self.wardrobe.garments
        self.model.garment.standardise.set_from(torch.cat([p.features for g in garments for p in g.partitions]))
        poses = self.bank.draw(512, np.random.default_rng(self.config.seed + 1))
        betas = draw_betas(512, self.body.shape_count, self.config.data, np.random.default_rng(self.config.seed + 2))
        self.model.body.standardise.set_from(self.source.pose(poses, betas).tensors.features)

    def _passes(self) -> int | None:
        """Passes of corrections in this step: the same in all processes, whose gradients are averaged."""
        rng = np.random.default_rng((self.config.seed, self.step_count))
        drawn = rng.random()
        if drawn < self.config.full_share:
            return None
        if drawn < self.config.full_share + self.config.bare_share:
            return 0
        return int(rng.integers(self.config.model.corrections + 1))

    def _smooth(self) -> bool:
        """Whether this step's poses come three in a row; the same in all processes."""
        rng = np.random.default_rng((self.config.seed, self.step_count, 1))
        return bool(rng.random() < self.config.smooth_share)

    def _draw(self, *, in_a_row: bool = False) -> tuple[TrainingGarment, Partition, BodyBatch]:
        """A garment, one of its partitions and a batch of posed bodies, ``in_a_row`` by threes."""
        config = self.config
        garment, partition = self.wardrobe.draw(self.rng)
        count = max(1, config.batch_size // 3) if in_a_row else config.batch_size
        poses = self.bank.draw(count, self.rng)
        betas = draw_betas(count, self.body.shape_count, config.data, self.rng)
        if in_a_row:
            poses, betas = rows_of_three(poses, config.smooth_step_rad, self.rng), np.repeat(betas, 3, axis=0)
        return garment, partition, self.source.pose(poses, betas)

    def _toward(self, bank: SettledBank) -> BatchLoss:
        """The loss of drapes without corrections beside settled ones."""
        config = self.config
        garment, target = bank.draw(self.wardrobe.garments, self.rng)
        self._wear(target.fabric)
        partition = garment.partitions[int(self.rng.integers(len(garment.partitions)))]
        batch = self.source.pose(target.poses, target.betas)
        draped = self.drape(batch, garment, partition, passes=0)
        vertices = draped.vertices
        parts = self._energy(vertices, garment, self._planes(vertices, batch))
        contact = losses.soften(parts.pop("contact"), config.contact_knee_j_m2).mean()
        energy = torch.stack(list(parts.values())).sum(dim=0).mean()
        apart, charts = distance(vertices, target, garment.cloth), self._disagreement(draped.coefficients, partition)
        # The mean of a cloth that folds on the skin lies below it: contact counts in full.
        loss = config.settled_weight * apart + config.settled_energy * energy + contact
        means = {"settled_mm": 1e3 * apart.sqrt(), "settled_energy": energy, "settled_contact": contact}
        lost = self._lost_area(vertices, garment, means)
        return BatchLoss(loss + config.disagreement_weight * charts + lost, means, charts)

    def _lost_area(self, vertices: Tensor, garment: TrainingGarment, means: dict[str, Tensor]) -> Tensor | float:
        """What lost area adds to the loss; its mean root joins ``means``."""
        if not self.config.area_weight:
            return 0.0
        lost = losses.lost_area(vertices, garment.cloth).mean()
        means["lost_area_pct"] = 1e2 * lost.sqrt()
        return self.config.area_weight * lost

    def objective(self) -> BatchLoss:
        """Draws a batch and returns its loss: the energy of its drapes, the disagreement of charts, and what the
        configuration adds."""
        config = self.config
        passes, smooth = self._passes(), self._smooth()
        if passes == 0 and self.settled is not None:
            return self._toward(self.settled)
        garment, partition, batch = self._draw(in_a_row=smooth)
        draped = self.drape(batch, garment, partition, passes=passes)
        vertices = draped.vertices
        parts = self._energy(vertices, garment, self._planes(vertices, batch))
        parts["waistband"] = losses.waistband_energy(draped.coefficients, partition, garment) / self._unit(garment)
        contact = losses.soften(parts["contact"], config.contact_knee_j_m2)
        energy = (parts["membrane"] + parts["bending"] + parts["gravity"] + contact + parts["waistband"]).mean()
        charts = self._disagreement(draped.coefficients, partition)
        # Charts that must agree from the start learn slower.
        share = config.early_agreement + (1.0 - config.early_agreement) * self.progress()
        agree = config.disagreement_weight * share * charts
        means = {name: value.mean() for name, value in parts.items()}
        loss = energy + agree + self._lost_area(vertices, garment, means)
        if not smooth:
            return BatchLoss(loss, means, charts)
        bend = losses.second_difference(vertices)
        means["second_difference_mm"] = 1e3 * bend.sqrt()
        return BatchLoss(loss + config.smooth_weight * bend, means, charts)


def _plain(state: Mapping[str, Any]) -> dict[str, Any]:
    # The 128-bit integers of PCG64 do not fit a tensor file: as text they do.
    return {**state, "state": {key: str(value) for key, value in state["state"].items()}}
