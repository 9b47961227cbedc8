"""Networks of training judged on hard poses of clips that were held out, without export."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.harness import Option
from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.judged import Cloth, Judged
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material, material
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.motion.clip import MotionClip
from drape.motion.hard_poses import HardPoses, hard_poses
from training.config import TrainConfig
from training.data import BodySource
from training.evaluate import CPU, held_out_clips, posed_patches
from training.model import OneFit
from training.poses import read_clips
from training.run import sample_motions

FIGURES = ("edge_pct", "area_pct", "colliding_vertex_pct")
JUDGING = (
    Option("--frames", 4, "hard poses", 1),
    Option("--steps", physics.STEPS, "most steps of physics", 30),
)


def training_clips(config: TrainConfig) -> list[MotionClip]:
    """The clips that a run of ``config`` learns from: those of the data folder, or the shipped ones."""
    return read_clips([data_folder("motions") or sample_motions()], held_out=config.data.held_out)


def judged(garment: Garment, body: BodyModel, poses: np.ndarray, cloth: Material | None = None) -> Judged:
    """``garment`` in ``cloth``, or in its own fabric, over ``poses``; contact is that of training."""
    made = fabric(garment.fabric)
    found = Cloth(garment, body, Material.of(made), made, metrics.nearest_distance)
    if cloth is not None:
        found = Cloth(garment, body, cloth, distance=metrics.nearest_distance)
    return Judged.of(found, poses)


def figures(judge: Judged, vertices: np.ndarray) -> dict[str, float]:
    """Strains [%], colliding vertices [%] and energies [J] of ``vertices`` [m] (n, V, 3)."""
    return judge.figures(vertices, FIGURES) | judge.energies(vertices)


class HeldOut:
    """Hard poses of held-out clips, and for each garment the physics that a gain is measured by.

    Cloth is the garment's fabric where networks of ``config`` know fabrics, else that of before fabrics. The clips are
    those that ``config`` holds out, or the shipped ones.
    """

    def __init__(self, config: TrainConfig, body: BodyModel, frames: int, steps: int) -> None:
        self.body, self.source = body, BodySource(body, device=CPU)
        self.poses: HardPoses = hard_poses(held_out_clips(config, []), body, frames)
        self._steps = steps
        self._cloth = None if config.model.fabric else material()
        self._known: dict[str, tuple[Judged, float]] = {}

    def physics(self, garment: Garment) -> tuple[Judged, float]:
        """The judge of drapes of ``garment``, and the energy [J] of its physics optimum."""
        if garment.name not in self._known:
            judge = judged(garment, self.body, self.poses.poses, self._cloth)
            optimum, _ = judge.optimum((judge.pushed,), CACHE_DIR, self._steps)
            self._known[garment.name] = judge, judge.energies(optimum.vertices)["energy_j"]
        return self._known[garment.name]

    def figures(self, model: OneFit, garment: Garment) -> dict[str, float]:
        """The figures of the network's drape of ``garment``, and its gain."""
        judge, optimum_j = self.physics(garment)
        model.eval()
        vertices, _ = posed_patches(model, garment, self.source, self.poses.poses)
        found, baseline_j = figures(judge, vertices), judge.energies(judge.pushed)["energy_j"]
        return found | {"gain": metrics.gain(baseline_j, found["energy_j"], optimum_j)}

    def gains(self, model: OneFit, garments: Sequence[Garment]) -> dict[str, float]:
        """The gain of the network's drape by garment."""
        return {garment.name: self.figures(model, garment)["gain"] for garment in garments}
