"""Folds of clips: energies, strain, detail, jitter and time, by steps of folds and by the drape they start from.

    python -m benchmarks.folds
    python -m benchmarks.folds --garments tshirt --motions walk squat $DRAPE_DATA/motions/cmu_02_04.npz --save
    python -m benchmarks.folds --garments tshirt --fabrics satin --fps 15 --frames 900 --sweeps 2

Folds start from skinning with the nearest-vertex push, and from the network after none and all of its corrections.
``ms`` is the median processor time of a frame's folds on one thread. Energies are those of physics, over frames spread
over the clip and without push-out. Jitter is against the start; skin is counted in pictures from four sides.
``--physics`` adds ``gain`` and ``detail_share`` against the optimum of up to six frames of the clip, which takes
minutes. ``--apart`` adds ``gain_apart``, against cloth that does not pass through itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.judge import ipc_optimum
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.judged import Cloth, Judged, jitter_ratio
from benchmarks.network import Network
from benchmarks.scenes import FPS, Folding, Scene, fabrics_option, read_clips, scenes
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.geometry import meshes
from drape.live.fold_step import FoldEffort

OPTIMA = 6  # frames of a clip, at most, whose optimum is looked for
PASSES = {"network_0": 0, "network_all": None}  # starts of folds besides skinning
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "fps": ".0f", "method": "s", "sweeps": "d", "ms": ".2f",
    "energy_j": ".4f", "gain": ".3f", "gain_apart": ".3f", "edge_pct": ".2f", "edge_p999": ".3f",
    "detail_mm": ".2f", "detail_share": ".2f", "dihedral_deg": ".1f", "jitter_ratio": ".2f", "colliding_pct": ".2f",
    "skin_pixels_pct": ".3f", "self_intersections": ".0f", "resets": "d",
}  # fmt: skip


def judged(scene: Scene, plain: np.ndarray) -> Judged:
    """The judge of drapes of the scene's measured frames; heights count from ``plain`` [m] (F, V, 3)."""
    cloth = Cloth.of(scene.garment, scene.body, scene.fabric)
    return Judged(cloth, scene.clip.body_vertices, plain[scene.clip.measured].astype(np.float64))


def figures(judge: Judged, vertices: np.ndarray, start: np.ndarray, measured: np.ndarray) -> Row:
    """The measures of ``vertices`` [m] (F, V, 3) in the frames ``measured``; jitter, against ``start``, is of all."""
    seen = vertices[measured].astype(np.float64)
    edges = meshes.unique_edges(judge.cloth.faces)
    lengths = (meshes.edge_lengths(x, edges) for x in (vertices.astype(np.float64), judge.cloth.rest))
    slow = judge.few.figures(seen[judge.spread], ("colliding_triangle_pct", "skin_pixels_pct", "self_intersections"))
    return {
        **judge.energies(seen),
        **judge.figures(seen, ("edge_pct", "detail_mm", "dihedral_deg")),
        "edge_p999": float(np.percentile(np.divide(*lengths), 99.9)),
        "jitter_ratio": jitter_ratio(vertices, start),
        "colliding_pct": slow.pop("colliding_triangle_pct"),
        **slow,
    }


def measure(scene: Scene, networks: Mapping[str, Network], options: argparse.Namespace) -> list[Row]:
    """The rows of a scene: a start, so many steps of folds on it, in cloth that feels itself or not."""
    starts = scene.starts(dict(networks))
    judge = judged(scene, starts["skinning"])
    rows: list[Row] = []
    contacts = (False, True) if options.cloth_contact else (False,)
    knobs = [(n, contact) for n in options.sweeps for contact in contacts if n or not contact]
    for (method, start), (sweeps, contact) in product(starts.items(), knobs):
        folding = Folding(scene.constants, FoldEffort(sweeps, cloth_contact=contact), scene.clip.fps)
        vertices = folding.frames(start, scene.clip.skin) if sweeps else start
        ms = folding.ms or [0.0, 0.0]
        told = {"fps": scene.clip.fps, "method": method, "sweeps": sweeps, "cloth_contact": contact}
        took = {"ms": float(np.median(ms[1:])), "first_ms": ms[0], "resets": folding.resets, "frames": len(start)}
        rows.append(scene.name | told | took | figures(judge, vertices, start, scene.clip.measured))
    plain = next(row for row in rows if row["method"] == "skinning" and not row["sweeps"])
    if options.physics:
        least = bound(scene, starts)
        for row in rows:
            row |= least.compare(row, plain)
        rows.append(scene.name | {"fps": scene.clip.fps} | least.row())
    if options.apart:
        least = bound(scene, starts, keeps_apart=True)
        crossings = float(intersection_count(least.vertices, judge.cloth.faces).mean())
        for row in rows:
            gain = metrics.gain(plain["energy_j"], row["energy_j"], least.energy_j)
            row |= {"gain_apart": gain, "self_intersections_apart": crossings}
    return rows


@dataclass(frozen=True, eq=False)
class Bound:
    """Physics of n of a clip's measured frames, their numbers among those ``few`` (n,): ``vertices`` [m] (n, V, 3),
    mean energy and detail, and the processor time of a frame. ``judge`` judges drapes of these frames."""

    few: np.ndarray
    judge: Judged
    vertices: np.ndarray
    energy_j: float
    detail_mm: float
    processor_s: float

    def compare(self, row: Row, plain: Row) -> Row:
        """``gain`` and ``detail_share`` of ``row``: 0 for the row ``plain`` of skinning, 1 for physics."""
        share = metrics.gain(-plain["detail_mm"], -row["detail_mm"], -self.detail_mm)
        return {"gain": metrics.gain(plain["energy_j"], row["energy_j"], self.energy_j), "detail_share": share}

    def row(self) -> Row:
        """The columns that physics has; ``ms`` is the processor time of one of its frames."""
        known = {"method": "physics", "sweeps": 0, "ms": 1e3 * self.processor_s, "energy_j": self.energy_j}
        found = self.judge.figures(self.vertices, ("edge_pct", "self_intersections"))
        return known | {"gain": 1.0, "detail_mm": self.detail_mm, "detail_share": 1.0} | found


def bound(scene: Scene, starts: Mapping[str, np.ndarray], *, keeps_apart: bool = False) -> Bound:
    """The optimum of ``OPTIMA`` of the measured frames, from the first and the last of ``starts`` [m] (F, V, 3).

    Of cloth that ``keeps_apart`` from itself, it is the optimum near the last start.
    """
    measured = scene.clip.measured
    few = np.linspace(0, len(measured) - 1, min(OPTIMA, len(measured))).astype(int)
    plain, *_, last = (start[measured[few]].astype(np.float64) for start in starts.values())
    judge = Judged(Cloth.of(scene.garment, scene.body, scene.fabric), scene.clip.body_vertices[few], plain)
    if keeps_apart:
        optimum, _ = ipc_optimum.stored_minimum(judge.task((last,)), CACHE_DIR)
    else:
        optimum, _ = judge.optimum((plain, last), CACHE_DIR)
    energy_j = judge.energies(optimum.vertices)["energy_j"]
    detail_mm = judge.figures(optimum.vertices, ("detail_mm",))["detail_mm"]
    return Bound(few, judge, optimum.vertices, energy_j, detail_mm, float(optimum.processor_s.mean()))


def open_networks(options: argparse.Namespace, body: BodyModel) -> dict[str, Network]:
    """The network after none and after all of its corrections."""
    return {name: Network.asked(options, body, passes=passes) for name, passes in PASSES.items()}


@Benchmark(
    "folds",
    "What folds make of a clip.",
    COLUMNS,
    *inputs(("tshirt", "dress"), ("walk", "squat"), quick_garments=("tshirt",), quick_motions=("walk",)),
    fabrics_option("jersey", "denim", "satin", "poplin"),
    Option("--sweeps", (0, 1, 2, 4, 8), "steps of folds"),
    Option("--fps", FPS, "frames a second"),
    Option("--frames", 120, "of a clip at most", 12),
    Option("--cloth-contact", False, "also cloth that feels itself"),
    Option("--physics", False, "also gain and share of detail, slow"),
    Option("--apart", False, "also gain beside cloth that keeps apart from itself, slow"),
)
def main(run: Run) -> None:
    """Rows of every scene."""
    options, body = run.options, load_body()
    networks = open_networks(options, body)
    for scene in scenes(options, read_clips(options, body, options.fps), body):
        run.add(measure(scene, networks, options))
    run.extra |= {"frames": options.frames, "model": options.model}


if __name__ == "__main__":
    main.command()
