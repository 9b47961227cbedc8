"""The trade of speed for accuracy: what every choice of knobs costs, and how near to physics it is.

    python -m benchmarks.tradeoff
    python -m benchmarks.tradeoff --garments tshirt dress trousers --fabrics jersey denim satin --save
    python -m benchmarks.tradeoff --garments tshirt --quick
    python -m benchmarks.tradeoff --newton /elsewhere/bin/python

Every combination of passes, folds and push-out, which with folds is their lift, drapes the same clips, frame by frame
on the service's own road (``service.stages``), in turn with the others and with the rival: skinning and a SciPy push-
out, of which ``time_ratio`` is the share of processor time. Ends of the axis are rows of that rival (``skinning_push``)
and of the optimum (``physics``), and with ``--newton PYTHON``, of the first garment in the first fabric, of a simulator
(``newton_vbd``: ``newton_rows``). Figures are those of ``benchmarks.folds``, over frames at rest (motion 0) whose
physics was minimised. That physics may pass through itself, which what is served may not: what that costs of gain is
told by the rows that may ("through itself").

``tiers`` of the record are chosen by one rule (``tiers_of``); ``--write`` puts them into the model's manifest, and
``--plot FILE`` draws the front.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import folds
from benchmarks.folds import Bound, Clip, Folded, Referee
from benchmarks.judge.physics import held_by_waist
from benchmarks.measure.intersections import intersection_count
from benchmarks.shared import common
from benchmarks.shared.network import Network
from benchmarks.speed.rivals import NewtonClip, SkinningPush
from drape.artifacts import load_manifest, model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.errors import InputError, ended
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.compute.tiers import NAMES, Tier, read_tiers
from service.settings import Settings
from service.stages import run
from service.stages.batch import Batch, Plan, PoseInput

PASSES, FOLDS = (0, None), (0, 1, 2, 4, 8, 16)
FABRICS = ("jersey", "denim", "satin")
FPS, FRAMES, QUICK_FRAMES = 30.0, 48, 8
CROSSED = 2  # of the frames with an optimum, whose crossings are counted
TAKEN = ("energy_j", "edge_pct", "jitter_ratio", "colliding_pct", "skin_pixels_pct")  # of the referee's figures
ENOUGH = 0.002  # of gain: what gives less is not worth more time
# Steps of a frame and iterations of each: as Newton's examples have it, and the nearest to physics of what was tried.
# With fewer sweeps cloth slides off: 8 steps of 2 iterations and 16 of 2 are worse than skinning.
NEWTON_PACES = ((8, 10), (32, 3))
NEWTON_HELP = "an interpreter that has the package newton"
KNOBS = ("passes", "folds", "push_out", "cloth_contact")
COLUMNS = {
    "tier": "s", "knobs": "s", "garment": "s", "fabric": "s", "clip": "s", "p50_ms": ".2f", "p95_ms": ".2f",
    "cpu_ms": ".2f", "time_ratio": ".2f", "gain": ".3f", "error_mm": ".2f", "edge_pct": ".2f", "detail_share": ".2f",
    "jitter_ratio": ".2f", "colliding_pct": ".2f", "skin_pixels_pct": ".3f", "self_intersections": ".0f",
    "pareto": "d",
}  # fmt: skip
MEANS = ("p50_ms", "p95_ms", "cpu_ms", "time_ratio", "gain", "error_mm", "edge_pct", "detail_share", "jitter_ratio",
         "colliding_pct", "skin_pixels_pct", "self_intersections")  # fmt: skip


@dataclass(frozen=True)
class Knobs:
    """One combination: ``passes`` of the network, None all; steps of ``folds``; whether the push-out runs, and whether
    cloth feels cloth there."""

    passes: int | None
    folds: int
    push_out: bool
    cloth_contact: bool = True

    def options(self, pass_count: int, **others: Any) -> DrapeOptions:
        """As a request says it, of cloth that does not swing; ``pass_count`` are all passes."""
        passes = pass_count if self.passes is None else self.passes
        ways = {"push_out": self.push_out, "cloth_contact": self.cloth_contact, "motion": 0.0}
        return DrapeOptions(passes=passes, folds=self.folds, **ways, **others)

    def __str__(self) -> str:
        passes = "all" if self.passes is None else self.passes
        alone = ", through itself" if self.folds and not self.cloth_contact else ""
        return f"passes {passes}, folds {self.folds}{alone}{', push-out' if self.push_out else ''}"


@dataclass(eq=False)
class Runner:
    """A clip under one plan, a frame at a time; the memory goes along."""

    plan: Plan
    clip: Clip
    betas: np.ndarray
    vertices: np.ndarray
    wall_ms: np.ndarray
    cpu_ms: np.ndarray
    memories: Any = None

    @classmethod
    def of(cls, plan: Plan, clip: Clip, shape_count: int) -> Runner:
        for stage in plan.stages:
            stage.prepare(plan)
        frames = len(clip.poses)
        vertices = np.empty((frames, plan.scene.vertex_count, 3), np.float32)
        return cls(plan, clip, np.zeros(shape_count), vertices, np.empty(frames), np.empty(frames), {})

    def step(self, frame: int) -> Batch:
        """Drapes the next ``frame``."""
        times_s = np.array([frame / self.clip.fps])
        pose = PoseInput(self.clip.poses[frame : frame + 1], np.zeros((1, 3)), self.betas, times_s, self.memories)
        wall, cpu = time.perf_counter(), time.thread_time()
        batch = run(self.plan, [pose])
        self.cpu_ms[frame], self.wall_ms[frame] = (
            1e3 * (time.thread_time() - cpu),
            1e3 * (time.perf_counter() - wall),
        )
        self.vertices[frame], self.memories = batch.world()[0], batch.memories[0]
        return batch


@dataclass(frozen=True, eq=False)
class Case:
    """A garment in a fabric over a clip: its referee and the physics that it is measured by."""

    garment: Garment
    fabric: Fabric
    referee: Referee
    skinned: np.ndarray
    least: Bound

    @classmethod
    def of(cls, garment: Garment, cloth: Fabric, clip: Clip, body: BodyModel, networks: dict[str, Network]) -> Case:
        from_each = folds.starts(garment, cloth, clip, body, networks)
        referee = Referee.of(garment, cloth, clip, body, from_each["skinning"])
        least = folds.bound(referee, from_each)
        seen = clip.measured[least.few]
        few = replace(clip, measured=seen, body_vertices=clip.body_vertices[least.few])
        referee = replace(referee, clip=few, height_m=referee.height_m[least.few])
        return cls(garment, cloth, referee, from_each["skinning"], least)

    def row(self, vertices: np.ndarray, start: np.ndarray) -> dict[str, Any]:
        """What is measured of the clip's ``vertices`` [m] (F, V, 3); jitter against ``start``."""
        found = Folded(vertices, np.zeros(len(vertices)), 0)
        figures = self.referee.figures(found, start)
        plain = self.referee.figures(Folded(self.skinned, found.ms, 0), self.skinned)
        seen = vertices[self.referee.clip.measured].astype(np.float64)
        return {
            "garment": self.garment.name,
            "fabric": self.fabric.name,
            "clip": self.referee.clip.name,
            "gain": metrics.gain(plain["energy_j"], figures["energy_j"], self.least.energy_j),
            "detail_share": metrics.gain(-plain["detail_mm"], -figures["detail_mm"], -self.least.detail_mm),
            "error_mm": 1e3 * float(np.linalg.norm(seen - self.least.vertices, axis=-1).mean()),
            "self_intersections": float(intersection_count(seen[:CROSSED], self.referee.cloth.faces).mean()),
            **{name: figures[name] for name in TAKEN},
        }


def measure(
    case: Case, drapery: DrapeRuntime, knobs: Sequence[Knobs], newton: str | None = None
) -> list[dict[str, Any]]:
    """The rows of ``case``: all ``knobs``, the rival, physics, and a simulator where the interpreter ``newton`` has
    it."""
    clip, body = case.referee.clip, drapery.body
    scene, count = drapery.garments.add(case.garment, "user"), drapery.engine.pass_count
    plans = [drapery.plan(scene, one.options(count, fabric=case.fabric.name)) for one in knobs]
    for plan in plans:
        drapery.add_missing(plan)
    runners = [Runner.of(plan, clip, body.shape_count) for plan in plans]
    rival = SkinningPush(case.garment, body)
    pushed, wall_ms, cpu_ms = np.empty_like(runners[0].vertices), *np.empty((2, len(clip.poses)))
    for frame in range(len(clip.poses)):
        for runner in runners:
            runner.step(frame)
        pose = clip.poses[frame : frame + 1]
        wall, cpu = time.perf_counter(), time.thread_time()
        vertices = rival.push(rival.skin(pose), pose)
        cpu_ms[frame], wall_ms[frame] = 1e3 * (time.thread_time() - cpu), 1e3 * (time.perf_counter() - wall)
        pushed[frame] = vertices[0] + body.joints_template[0]
    start = runners[0].vertices  # the network alone
    rows: list[dict[str, Any]] = []
    for one, runner in zip(knobs, runners, strict=True):
        took = times(runner.wall_ms, runner.cpu_ms)
        rows.append({"tier": "", "knobs": str(one), **asdict(one), **took, **case.row(runner.vertices, start)})
    rows.append({"tier": "skinning_push", "knobs": "", **times(wall_ms, cpu_ms), **case.row(pushed, start)})
    same = case.row(start, start)
    rows.append(
        {name: same[name] for name in ("garment", "fabric", "clip")}
        | {"tier": "physics", "knobs": "", "gain": 1.0, "detail_share": 1.0, "error_mm": 0.0,
           "energy_j": case.least.energy_j, "cpu_ms": 1e3 * case.least.processor_s}
    )  # fmt: skip
    if newton is not None:
        rows += newton_rows(case, body, start, newton)
    for row in rows:
        row["time_ratio"] = row["cpu_ms"] / float(np.median(cpu_ms[1:]))
    return rows


def newton_rows(case: Case, body: BodyModel, start: np.ndarray, newton: str | None) -> list[dict[str, Any]]:
    """A row of Newton's VBD solver for each of ``NEWTON_PACES`` that comes through the clip; says why others do not.

    It starts where the rival has the first frame and simulates the cloth's motion, in which it differs from physics,
    which rests in every frame; it has no contact of cloth with cloth.
    """
    clip, mesh, skinned = case.referee.clip, case.referee.cloth, case.skinned
    scene = NewtonClip(
        mesh, case.garment.vertices.astype(np.float64), skinned[0], case.referee.material, case.fabric.friction,
        body.faces, body.posed_vertices(clip.poses), clip.fps, held_by_waist(case.garment, body, skinned),
    )  # fmt: skip
    found = scene.run(newton, NEWTON_PACES)
    if isinstance(found, str):
        print(f"newton_vbd is left out: {found}", flush=True)
        return []
    rows = []
    for i, (steps, iterations) in enumerate(NEWTON_PACES):
        knobs, vertices = f"{steps} steps, {iterations} iterations", found["vertices"][i]
        if not np.isfinite(vertices).all():
            print(f"newton_vbd, {knobs}, is left out: its cloth flew apart", flush=True)
            continue
        took = times(found["wall_ms"][i], found["cpu_ms"][i])
        rows.append({"tier": "newton_vbd", "knobs": knobs, **took, **case.row(vertices, start)})
    return rows


def times(wall_ms: np.ndarray, cpu_ms: np.ndarray) -> dict[str, float]:
    """Of the frames after the first, which has no past."""
    wall, cpu = wall_ms[1:], cpu_ms[1:]
    return {
        "p50_ms": float(np.median(wall)),
        "p95_ms": float(np.percentile(wall, 95.0)),
        "cpu_ms": float(np.median(cpu)),
    }


def means(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each combination and each end of the axis: the mean over what was measured; ``pareto`` where nothing
    is both as cheap and better, among what feels its own cloth and among what may pass through itself."""
    found: list[dict[str, Any]] = []
    for tier, knobs in dict.fromkeys((row["tier"], row["knobs"]) for row in rows):
        same = [row for row in rows if (row["tier"], row["knobs"]) == (tier, knobs)]
        first = {name: same[0].get(name) for name in ("tier", "knobs", *KNOBS)} | {"cases": len(same)}
        kept = {name: [row[name] for row in same if np.isfinite(row.get(name, np.nan))] for name in MEANS}
        worst = {"gain_p05": float(np.percentile([row["gain"] for row in same], 5.0))}
        found.append(first | {name: float(np.mean(values)) for name, values in kept.items() if values} | worst)
    for row in found:
        alike = [other for other in found if row["cloth_contact"] in (None, other["cloth_contact"])]
        row["pareto"] = not any(
            other["time_ratio"] <= row["time_ratio"] and other["gain"] > row["gain"] for other in alike
        )
    return found


def tiers_of(mean: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row of ``mean`` for each tier, of the combinations that are served: with folds, push-out and cloth contact.

    The least is the cheapest. The last is the cheapest that has all but ``ENOUGH`` of the best one's gain, and the
    middle one the cheapest that has at least half of what the last gains over the least. A tier's folds and passes are
    never less than those of the one below. Times decide by their order only, so that the rule gives the same tiers on
    processors on which the rival is faster or slower than here.
    """
    served = [row for row in mean if row.get("folds") and row["push_out"] and row["cloth_contact"]]
    if not served:
        raise InputError("knobs", expected="combinations with folds", got="none", cure="Measure folds too.")
    by_cost = sorted(served, key=lambda row: row["time_ratio"])
    least, best = by_cost[0], max(row["gain"] for row in served)
    above = [row for row in by_cost if _covers(row, least)]
    last = next((row for row in above if row["gain"] >= best - ENOUGH), max(above, key=lambda row: row["gain"]))
    half = 0.5 * (least["gain"] + last["gain"])
    middle = next(row for row in above if row["gain"] >= half and _covers(last, row))
    return [least, middle, last]


def _covers(row: dict[str, Any], below: dict[str, Any]) -> bool:
    more = row["passes"] is None or (below["passes"] is not None and below["passes"] <= row["passes"])
    return more and row["folds"] >= below["folds"]


def manifest_tiers(chosen: Sequence[dict[str, Any]], where: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of ``service.compute.tiers.Tier`` with their figures; jets get all passes, in the least tier none."""
    kept = ("time_ratio", "cpu_ms", "gain", "gain_p05", "error_mm", "edge_pct", "detail_share", "jitter_ratio")
    return common.finite(
        [
            asdict(Tier(name, row["passes"], row["folds"], None if i else 0, {key: row[key] for key in kept} | where))
            for i, (name, row) in enumerate(zip(NAMES, chosen, strict=True))
        ]
    )


def write_tiers(folder: Path, tiers: list[dict[str, Any]]) -> None:
    """Puts ``tiers`` into the manifest of the model ``folder``; refuses (``ArtifactError``) what the service would."""
    read_tiers(tiers)
    manifest = replace(load_manifest(folder), tiers=tiers)
    (folder / "manifest.json").write_text(manifest.to_json())


def plot(mean: Sequence[dict[str, Any]], chosen: Sequence[dict[str, Any]], path: Path) -> None:
    """Time as a share of the rival's against what is left of the way to physics, both logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8.0, 5.0))
    shown = [row for row in mean if row["gain"] < 1.0 and row["tier"] != "skinning_push"]
    for push in (True, False):
        for passes in PASSES:
            same = [row for row in shown if row["push_out"] is push and row["passes"] == passes]
            line = [row for row in same if row["folds"] is not None and row["cloth_contact"]]
            name = f"{'all' if passes is None else 'no'} corrections{', push-out' if push else ''}"
            axes.plot([row["time_ratio"] for row in line], [1.0 - row["gain"] for row in line],
                      marker="o", label=name, linestyle="-" if push else ":")  # fmt: skip
            for row in line:
                axes.annotate(str(row["folds"]), (row["time_ratio"], 1.0 - row["gain"]), fontsize=8,
                              xytext=(3, 3), textcoords="offset points")  # fmt: skip
    simulated = [row for row in shown if row["tier"] == "newton_vbd"]
    if simulated:
        axes.plot([row["time_ratio"] for row in simulated], [1.0 - row["gain"] for row in simulated],
                  marker="s", color="0.4", linestyle="", label="Newton VBD")  # fmt: skip
    for row in simulated:
        axes.annotate(row["knobs"], (row["time_ratio"], 1.0 - row["gain"]), fontsize=8, ha="right",
                      xytext=(-5, 3), textcoords="offset points")  # fmt: skip
    for name, row in zip(NAMES, chosen, strict=True):
        axes.annotate(name, (row["time_ratio"], 1.0 - row["gain"]), weight="bold",
                      xytext=(-10, -16), textcoords="offset points")  # fmt: skip
    axes.axvline(1.0, color="0.7", linewidth=1.0)
    axes.set(xscale="log", yscale="log", xlabel="processor time of a frame, skinning + SciPy push-out = 1",
             ylabel="1 - gain (0: physics)", title="Numbers at the points: steps of folds")  # fmt: skip
    axes.legend(fontsize=8)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def combinations(steps: Sequence[int]) -> list[Knobs]:
    """What is measured with each number of ``steps``: as served, without push-out, and without that and without cloth
    that feels itself."""
    found = [Knobs(passes, n, push) for push in (False, True) for passes in PASSES for n in steps]
    return found + [Knobs(passes, n, False, cloth_contact=False) for passes in PASSES for n in steps if n]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tradeoff", description="Speed against accuracy.")
    common.add_inputs(parser)
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), metavar="NAME")
    parser.add_argument("--folds", nargs="+", type=int, default=list(FOLDS))
    parser.add_argument("--frames", type=int, help=f"of a clip at most (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--newton", metavar="PYTHON", help=f"{NEWTON_HELP}, for its rows")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the front there")
    parser.add_argument("--write", action="store_true", help="put the tiers into the model's manifest")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or (["tshirt"] if options.quick else ["tshirt", "dress", "trousers"])
    options.motions = options.motions or (["walk"] if options.quick else ["walk", "squat"])
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    if options.quick:
        options.fabrics, options.folds = options.fabrics[:1], [0, 1, 2]
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the tables and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body, folder = load_body(), model_folder(options.model)
    drapery = DrapeRuntime(Settings(models_dir=folder.parent, model=folder.name, threads=options.threads), body=body)
    networks = {
        f"network_{'all' if passes is None else passes}": Network(folder, body, threads=options.threads, passes=passes)
        for passes in PASSES
    }
    knobs = combinations(options.folds)
    rows: list[dict[str, Any]] = []
    if options.newton is None:
        print(f"no rows of newton_vbd: they need --newton PYTHON, {NEWTON_HELP}", flush=True)
    for path in find_motions(options.motions):
        clip = Clip.read(path, FPS, options.frames, body)
        for number, path in enumerate(find_garments(options.garments)):
            garment = fine_garment(open_garment(path, body))  # what the service drapes
            for cloth in map(fabric, options.fabrics):
                first = number == 0 and cloth.name == options.fabrics[0]  # the simulator takes seconds a frame
                newton = options.newton if first else None
                rows += measure(Case.of(garment, cloth, clip, body, networks), drapery, knobs, newton)
                print(f"{garment.name}, {cloth.name}, {clip.name}: done", flush=True)
    drapery.close()
    common.print_table(rows, COLUMNS)
    mean = means(rows)
    chosen = tiers_of(mean)
    for name, row in zip(NAMES, chosen, strict=True):
        row["tier"] = name if not row["tier"] else f"{row['tier']}, {name}"
    print()
    common.print_table(mean, COLUMNS | {"gain_p05": ".3f"})
    tiers = manifest_tiers(chosen, {"machine": common.machine(), "garments": len(options.garments)})
    print(json.dumps(tiers))
    if options.write:
        write_tiers(folder, tiers)
    if options.plot:
        plot(mean, chosen, options.plot)
    return common.finish("tradeoff", rows, options, means=mean, tiers=tiers, frames=options.frames, model=options.model)


if __name__ == "__main__":
    sys.exit(ended(main))
