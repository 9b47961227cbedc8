"""How good the drape is: skinning, network, folds and physics side by side, on hard poses (docs/reference/quality.md).

    python -m benchmarks.quality
    python -m benchmarks.quality --garments tshirt dress --motions walk squat --frames 6
    python -m benchmarks.quality --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save
    python -m benchmarks.quality --patches 2 --out fine.json
    python -m benchmarks.quality --garments tshirt --fabrics jersey poplin --passes 0 --out fabrics.json

A garment is a name under drape/assets/garments, a cache file, a mesh, or a folder of either; a motion is a name under
drape/assets/motions, a file, or a folder. Everything is measured at rest (motion knob 0) on the garment's subdivided
mesh; jitter on continuous windows of the motions. The network is the graph that the service runs on a processor.
``--fabrics`` measures every garment in each of them, with its rest state. Without it, a network that knows fabrics is
measured in jersey, and one that does not in the cloth of before fabrics (``--material``).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.cases import CaseClip, folded_poses
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.jitter import Window, jitter, typical_windows
from benchmarks.measure.judged import Judged, JudgedCloth
from benchmarks.model_drape import ModelDrape, NetworkDrape
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment, was_trained_on
from drape.cloth import metrics
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import DEFAULT_FABRIC, fabric
from drape.cloth.material import DEFAULT_MATERIAL, Material, material
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.garment.fitting import patch_fields, rest_garment
from drape.graph.push_feed import push_feed
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from training.disagreement import disagreement

METHODS = ("skinning", "skinning_push", "network", "network_push", "folds", "physics")
STEPS = 2  # steps of folds
MEASURED = ("edge_pct", "area_pct", "colliding_vertex_pct", "colliding_triangle_pct", "self_intersections", "hang_mm",
            "detail_mm", "dihedral_deg")  # fmt: skip
# Heads are short where the key is longer than its numbers.
COLUMNS = {
    "garment": "s", "set": "s", "fabric": "s", "method": "s", "edge_pct": ".2f", "area_pct": ".2f",
    "edge_over_physics_pp": ("edge_over", ".2f"), "area_over_physics_pp": ("area_over", ".2f"),
    "colliding_vertex_pct": ("vertex_pct", ".3f"), "colliding_triangle_pct": ("triangle_pct", ".3f"),
    "self_intersections": ("self", ".1f"), "chart_gap_p99_mm": ("gap_mm", ".2f"),
    "chart_normal_p99_deg": ("normal_deg", ".2f"), "jitter_ratio": ("jitter", ".2f"), "jitter_worst": ("worst", ".2f"),
    "hang_mm": ".1f", "detail_mm": ".3f", "dihedral_deg": ".1f", "detail_share": ".2f", "energy_j": ".4f",
    "membrane_j": ".4f", "gain": ".3f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bench:
    """What the measurements of all garments share: a ``clip`` of hard poses, ``windows`` of clips for jitter, and the
    networks.

    Garments are made of ``fabric`` or, if it is None, of the cloth ``material``. ``uncorrected`` is the network without
    corrections, which folds start from; without it, or without a fabric, there are no folds. Physics takes at most
    ``step_limit`` steps. Its optima are kept in ``physics_folder``, or nowhere if that is None.
    """

    clip: CaseClip
    network: ModelDrape
    material: Material
    step_limit: int = physics.STEPS
    windows: Sequence[Window] = ()
    physics_folder: Path | None = None
    fabric: Fabric | None = None
    uncorrected: ModelDrape | None = None

    def of_fabric(self, fabric: Fabric) -> Bench:
        """Returns the same bench with all garments of ``fabric``."""
        uncorrected = None if self.uncorrected is None else self.uncorrected.made_of(fabric)
        network = self.network.made_of(fabric)
        return replace(self, fabric=fabric, material=Material.of(fabric), network=network, uncorrected=uncorrected)


def open_bench(options: argparse.Namespace, body: BodyModel) -> Bench:
    """Returns the bench of the command's ``options``, on ``body``, in the cloth of ``--material``."""
    clips = [read_motion(path) for path in find_motions(options.motions)]
    windows = typical_windows(clips)
    network, uncorrected = (ModelDrape.asked(options, body, passes=passes) for passes in (options.passes, 0))
    return Bench(
        clip=CaseClip.hard(hard_poses(clips, body, options.frames), body),
        network=network,
        material=material(options.material or DEFAULT_MATERIAL),
        step_limit=options.steps,
        windows=windows[:1] if options.quick else windows,
        physics_folder=None if options.no_physics_cache else CACHE_DIR,
        uncorrected=uncorrected,
    )


def in_fabrics(bench: Bench, options: argparse.Namespace) -> list[Bench]:
    """Returns ``bench`` once for each of ``--fabrics``, or else once: in the network's default fabric or, with
    ``--material`` and for a network that knows no fabrics, as it is.

    Raises ``NotFound`` for the name of an unknown fabric, and ``InputError`` for fabrics beside ``--material``.
    """
    names = options.fabrics
    if names and options.material is not None:
        raise InputError(
            "--material",
            expected="no --fabrics beside it",
            got=f"fabrics {', '.join(names)}",
            cure="Leave out one of both.",
        )
    if not names:
        names = [DEFAULT_FABRIC] if bench.network.engine.knows_fabrics and options.material is None else []
    chosen = {cloth.name: cloth for cloth in map(fabric, names)}
    return [bench.of_fabric(cloth) for cloth in chosen.values()] or [bench]


def covered(garment: Garment, body: BodyModel, share: float) -> Garment:
    """Returns ``garment`` with new patches, as intake makes them, ``share`` times as many as usual."""
    rest = rest_garment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), body)
    return replace(garment, **patch_fields(rest, share=share, unfold=True))


def measure(garment: Garment, bench: Bench, *, trained: bool) -> list[Row]:
    """Returns a row for each of ``METHODS`` with all measures of ``garment``; a row lacks those that do not apply to
    its method. ``trained`` says whether the network was trained on the garment."""
    cloth = JudgedCloth(garment, bench.clip.body, bench.material, bench.fabric)
    judge = Judged.of(cloth, bench.clip.poses)
    draped = bench.network.drape(garment, bench.clip.poses)
    starts = judge.pushed, draped.vertices
    optimum, was_cached = judge.optimum(starts, bench.physics_folder, bench.step_limit)
    positions = drapes(garment, bench, judge, draped.vertices) | {"physics": optimum.vertices}
    known = {"garment": garment.name, "set": "trained" if trained else "unseen"}
    known |= {} if bench.fabric is None else {"fabric": bench.fabric.name}
    rows: dict[str, Row] = {
        method: known | {"method": method} | judge.figures(vertices, MEASURED) | judge.energies(vertices)
        for method, vertices in positions.items()
    }
    rows["network"] |= chart_figures(garment, draped)
    for method, own in jitter(garment, bench.network, bench.clip.body, bench.windows).items():
        rows[method] |= {"jitter_ratio": own.ratio, "jitter_worst": own.worst, "jitter_by_clip": own.by_clip}
    add_comparisons(rows)
    rows["physics"] |= {
        "residual_n": float(optimum.residual_n.mean()),
        "weight_n": float(bench.material.gravity_m_s2 * cloth.mesh.vertex_mass(bench.material).sum()),
        "converged_pct": 100.0 * float(optimum.converged.mean()),
        "steps": float(optimum.steps.mean()),
        "seconds": optimum.seconds,
        "cached": was_cached,
    }
    rest_crossings = float(intersection_count(cloth.rest, cloth.faces))
    return [row | {"self_intersections_rest": rest_crossings} for row in rows.values()]


def drapes(garment: Garment, bench: Bench, judge: Judged, draped: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the world vertices [m] (F, V, 3) of ``garment`` in the bench's poses by method, all but physics;
    ``draped`` (F, V, 3) are those of the network."""
    body, clip = bench.clip.body, bench.clip
    out = push_out_of_bodies(draped, judge.body_vertices, body_skin(body), push_feed(garment, body))
    by_method = {"skinning": judge.skinned, "skinning_push": judge.pushed, "network": draped, "network_push": out}
    if bench.uncorrected is not None and bench.fabric is not None:
        # The service's default, but for cloth contact, which physics has not, and for the lift off the skin.
        constants = fold_constants(fine_garment(garment), body, bench.fabric)
        start = bench.uncorrected.drape(garment, clip.poses).vertices
        by_method["folds"] = folded_poses(constants, start, clip.skin, FoldEffort(STEPS))
    return by_method


def chart_figures(garment: Garment, draped: NetworkDrape) -> dict[str, float]:
    """Returns how much the overlapping charts of ``draped`` disagree before they are blended (``Disagreement``), as
    99th percentiles: "chart_gap_p99_mm", from a chart to the blended vertex [mm], and "chart_normal_p99_deg", the
    largest angle between the normals of two charts of a vertex [deg]."""
    charts = disagreement(garment, draped.jet, draped.rotation, draped.centre)
    return {
        "chart_gap_p99_mm": 1e3 * float(np.percentile(charts.gap_m, 99.0)),
        "chart_normal_p99_deg": float(np.degrees(np.percentile(charts.normal_rad, 99.0))),
    }


def add_comparisons(rows: dict[str, Row]) -> None:
    """Adds to each of ``rows``, which are by method, "gain", "edge_over_physics_pp" and "area_over_physics_pp", the
    strains minus those of physics [percentage points]. Those of the network and of folds also get "detail_share", NaN
    where physics has no more detail than skinning."""
    best, skin = rows["physics"], rows["skinning_push"]["energy_j"]
    for row in rows.values():
        row["gain"] = metrics.gain(skin, row["energy_j"], best["energy_j"])
        row["edge_over_physics_pp"] = row["edge_pct"] - best["edge_pct"]
        row["area_over_physics_pp"] = row["area_pct"] - best["area_pct"]
    for row in (rows[method] for method in ("network", "network_push", "folds") if method in rows):
        row["detail_share"] = metrics.gain(-rows["skinning"]["detail_mm"], -row["detail_mm"], -best["detail_mm"])


def quality_summary(rows: Sequence[Row]) -> list[Row]:
    """Returns for each set, fabric and method a row of the means over the garments; gain and shares are computed from
    the means."""
    summary: list[Row] = []
    for group in dict.fromkeys((row["set"], row.get("fabric")) for row in rows):
        means = {}
        for method in METHODS:
            own = [row for row in rows if (row["set"], row.get("fabric"), row["method"]) == (*group, method)]
            if not own:
                continue
            named = {key: own[0][key] for key in ("set", "method", "fabric") if key in own[0]}
            numbers = [key for key, value in own[0].items() if isinstance(value, float)]
            mean = {key: float(np.mean([row[key] for row in own])) for key in numbers}
            means[method] = {"garment": "all"} | named | mean
        add_comparisons(means)
        summary += means.values()
    return summary


def _in_fabric(garment: str, fabric_name: str | None) -> str:
    return f"{garment} of {fabric_name}" if fabric_name else garment


@Benchmark(
    "quality",
    "Quality of skinning, network and physics, side by side.",
    COLUMNS,
    *inputs(quick_garments=("tshirt",)),
    Option("--frames", 12, "hard poses", 2),
    Option("--set", None, "what garments are (default: what the model's manifest says)", choices=("trained", "unseen")),
    Option("--patches", None, "cover garments anew, by this many over the usual number", kind=float),
    Option("--fabrics", (), "measure in each (drape.cloth.fabric_table)"),
    Option("--material", None, "measure in a cloth of before fabrics (drape.cloth.material)"),
    Option("--passes", None, "corrections of the network that run (default all)", kind=int),
    Option("--steps", physics.STEPS, "most steps of physics", 30),
    Option("--no-physics-cache", False, "minimise again instead of taking stored drapes, store none"),
)
def main(run: Run) -> None:
    """Adds to ``run`` the rows of every garment in every fabric, and their means."""
    options, body = run.options, load_body()
    bench = open_bench(options, body)
    benches = in_fabrics(bench, options)
    known = bench.network.manifest.training.get("garments", ())
    refused: dict[str, str] = {}
    for path in find_garments(options.garments):  # one after the other, so that only one is in memory
        try:
            garment = open_garment(path, body)
            garment = covered(garment, body, options.patches) if options.patches else garment
        except InputError as error:
            # One bad file of a folder must not cost the table; it is named below and in the record.
            refused[error.name] = str(error)
            continue
        print(f"{garment.name}: drapes and the physics optimum, minutes where it is not stored", flush=True)
        trained = options.set == "trained" if options.set else was_trained_on(garment, known)
        for own in benches:
            name = _in_fabric(garment.name, own.fabric.name if own.fabric else None)
            try:
                rows = measure(garment, own, trained=trained)
            except InputError as error:  # one garment without an optimum must not cost it either
                refused[_in_fabric(error.name, own.fabric.name if own.fabric else None)] = str(error)
                continue
            run.rows += rows
            last, stored = rows[-1], ", stored" if rows[-1]["cached"] else ""
            print(f"{name}: physics {last['steps']:.0f} steps, {last['seconds']:.0f} s{stored}", flush=True)
            run.notes.append(
                f"physics {name}: residual {last['residual_n']:.3f} N of {last['weight_n']:.2f} N weight, "
                f"{last['converged_pct']:.0f} % of the poses at rest ({100.0 * physics.TOLERANCE:g} % of the weight)"
            )
    if not run.rows:
        raise InputError("garments", expected="at least one usable", got=str(refused), cure="Check the files.")
    if not bench.windows:
        run.notes.append("no jitter: no clip has a second without a glitch")
    run.notes += [f"refused: {message}" for message in refused.values()]
    run.summary = quality_summary(run.rows)
    run.extra |= {
        "summary": run.summary,
        "frames": list(bench.clip.labels),
        "windows": [window.label for window in bench.windows],
        "model": options.model,
        **bench.network.record(),
        "passes": bench.network.passes,
        "fabric": [own.fabric.name for own in benches if own.fabric],
        "knows_fabrics": bench.network.engine.knows_fabrics,
        "refused": refused,
        "patch_share": options.patches or 1.0,
    }


if __name__ == "__main__":
    main.command()
