"""The trade of speed for accuracy: what every choice of knobs costs, and how near to physics it is.

    python -m benchmarks.tradeoff
    python -m benchmarks.tradeoff --garments tshirt dress trousers --fabrics jersey denim satin --save
    python -m benchmarks.tradeoff --garments tshirt --quick

Every combination of passes and folds, of the fine cloth or a coarse one, drapes the same clips through the stages of
the service, clip after clip, and so does the rival: skinning and a SciPy push-out. ``time_ratio`` is processor time
over the rival's, ``curvature`` the total Gaussian curvature over that of physics. The rival (``skinning_push``) and the
optimum (``physics``) have rows too, as ends of the axis.
Figures are over frames at rest (motion 0) whose physics was minimised: cloth that does not pass through itself, as
served cloth does not.

``tiers`` of the record are chosen by one rule (``tiers_of``); ``--write`` puts them into the model's manifest.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseScene, read_case_clips, scenes
from benchmarks.harness import Benchmark, Option, Run, finite, inputs, machine
from benchmarks.measure import physics_bound
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.physics_bound import Bound
from benchmarks.model_drape import ModelDrape
from benchmarks.served import Stream
from benchmarks.speed.skinning_push import SkinningPush
from benchmarks.stills import looks_of
from benchmarks.stopwatch import Clock
from benchmarks.tables import Row, text_table
from drape.artifacts import load_manifest, model_folder
from drape.body.assets import load_body
from drape.errors import InputError
from drape.stages.tiers import NAMES, Tier, read_tiers
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

PASSES = (0, 1, None)
# Passes of the networks whose drapes physics starts from, besides skinning.
STARTS = {"network_0": 0, "network_all": None}
CROSSED = 2  # crossings are counted in so many of the frames with an optimum
FIGURES = ("energy_j", "edge_pct", "jitter_ratio", "colliding_pct", "skin_pixels_pct")  # those of physics_bound
DETAIL_MOST = 1.2  # times physics' detail: more is a texture that physics does not have, and gain does not see it
SMOOTHER = 0.75  # share of the way from the curvature of ``fast`` to that of ``accurate``, for ``balanced``
AS_CHEAP = 1.05  # ratio of two times: those of one run are no surer than that
LIFTED = 0.4  # share that ``instant`` has of what all corrections gain over none, without folds
KNOBS = ("passes", "folds", "coarse")
COLUMNS = {
    "tier": "s", "knobs": "s", "garment": "s", "fabric": "s", "clip": "s", "p50_ms": ".2f", "p95_ms": ".2f",
    "cpu_ms": ".2f", "time_ratio": ".2f", "gain": ".3f", "curvature": ".2f", "error_mm": ".2f", "edge_pct": ".2f",
    "detail_share": ".2f", "jitter_ratio": ".2f", "colliding_pct": ".2f", "skin_pixels_pct": ".3f",
    "self_intersections": ".0f", "pareto": "d",
}  # fmt: skip
MEANS = ("p50_ms", "p95_ms", "cpu_ms", "time_ratio", "gain", "curvature", "error_mm", "edge_pct", "detail_share",
         "jitter_ratio", "colliding_pct", "skin_pixels_pct", "self_intersections")  # fmt: skip


@dataclass(frozen=True)
class Knobs:
    """A choice of what runs: ``passes`` of the network, all if None; steps of ``folds``, for 0 the lift alone; and
    whether a ``coarse`` cloth takes these."""

    passes: int | None
    folds: int
    coarse: bool

    def options(self, pass_count: int, **others: Any) -> DrapeOptions:
        """Returns the options of a request with these knobs and ``others``, for cloth that does not swing.

        ``pass_count`` is the number of passes that the model has.
        """
        passes = pass_count if self.passes is None else self.passes
        if not self.folds:
            return DrapeOptions(tier="instant", motion=0.0, advanced=Advanced(passes=passes), **others)
        chosen = Advanced(passes=passes, folds=self.folds, coarse=self.coarse)
        return DrapeOptions(motion=0.0, advanced=chosen, **others)

    def __str__(self) -> str:
        passes = "all" if self.passes is None else self.passes
        return f"passes {passes}, folds {self.folds}{' coarse' if self.folds and self.coarse else ''}"


@dataclass(frozen=True, eq=False)
class Case:
    """A scene with the two ends of the axis on which its drapes are measured: ``skinned`` [m] (F, V, 3), skinning with
    the nearest-vertex push, and ``least``, physics."""

    scene: CaseScene
    skinned: np.ndarray
    least: Bound

    @classmethod
    def of(cls, scene: CaseScene, networks: dict[str, ModelDrape], *, keeps_apart: bool = True) -> Case:
        """Returns ``scene`` with its physics, which is found in the cache or computed: with ``keeps_apart`` from the
        drape of the last of ``networks``, for cloth that does not pass through itself, otherwise also from skinning."""
        starts = scene.starts(networks)
        return cls(scene, starts["skinning"], physics_bound.bound(scene, starts, keeps_apart=keeps_apart))

    def row(self, vertices: np.ndarray, start: np.ndarray) -> Row:
        """Returns the row of a drape ``vertices`` [m] (F, V, 3) of the clip: the name of the scene, and figures in the
        frames that physics is known of.

        They are "gain" and "detail_share"; "curvature" over that of physics; "error_mm", the mean distance from
        physics; "self_intersections", pairs of triangles that cross, in the first ``CROSSED`` of these frames; and
        ``FIGURES`` of ``physics_bound.figures``, of which the jitter is that of all frames over that of ``start`` (F,
        V, 3).
        """
        judge, measured = self.least.judge, self.scene.clip.measured[self.least.few]
        figures, drapes = physics_bound.figures(judge, vertices, start, measured), vertices[measured].astype(np.float64)
        looks = looks_of(self.scene.garment)
        return {
            **self.scene.name,
            **self.least.compare(figures, self.plain),
            "curvature": float((looks.curvature(drapes) / looks.curvature(self.least.vertices)).mean()),
            "error_mm": 1e3 * float(np.linalg.norm(drapes - self.least.vertices, axis=-1).mean()),
            "self_intersections": float(intersection_count(drapes[:CROSSED], judge.cloth.faces).mean()),
            **{name: figures[name] for name in FIGURES},
        }

    @cached_property
    def plain(self) -> Row:
        """The ``physics_bound.figures`` of skinning with its push, whose gain is 0."""
        return physics_bound.figures(
            self.least.judge, self.skinned, self.skinned, self.scene.clip.measured[self.least.few]
        )


def measure_knobs(case: Case, drapery: DrapeRuntime, knobs: Sequence[Knobs]) -> list[Row]:
    """Returns the rows of ``case``, each with ``times`` and ``Case.row``: one for each of ``knobs``, one for the rival
    (``SkinningPush``), and one for physics, which has fewer keys."""
    clip, body, garment = case.scene.clip, case.scene.body, case.scene.garment
    scene, count = drapery.garments.add(garment, "user"), drapery.engine.pass_count
    plans = [drapery.plan(scene, choice.options(count, fabric=case.scene.fabric.name)) for choice in knobs]
    for plan in plans:
        drapery.add_missing(plan)
    streams = [Stream(plan, body.shape_count) for plan in plans]
    rival, clock = SkinningPush(garment, body), Clock()
    vertices: list[list[np.ndarray]] = [[] for _ in range(len(plans) + 1)]
    for stream, drapes in zip(streams, vertices, strict=False):
        for frame, pose in enumerate(clip.poses):
            drapes.append(stream.pose(pose, frame / clip.fps).world()[0])
    for pose in clip.poses:
        with clock:
            pushed = rival.push(rival.skin(pose[None]), pose[None])
        vertices[-1].append(pushed[0] + body.joints_template[0])
    start = np.stack(vertices[0])  # the network and its lift
    names: list[Row] = [{"tier": "", "knobs": str(choice), **asdict(choice)} for choice in knobs]
    names.append({"tier": "skinning_push", "knobs": ""})
    clocks = [*(stream.clock for stream in streams), clock]
    rows = [
        name | times(own) | case.row(np.stack(drapes), start)
        for name, own, drapes in zip(names, clocks, vertices, strict=True)
    ]
    physics = {"gain": 1.0, "curvature": 1.0, "detail_share": 1.0, "error_mm": 0.0, "energy_j": case.least.energy_j}
    took = {"tier": "physics", "knobs": "", "cpu_ms": 1e3 * case.least.processor_s}
    rows.append(case.scene.name | took | physics)
    for row in rows:
        row["time_ratio"] = row["cpu_ms"] / times(clock)["cpu_ms"]
    return rows


def times(clock: Clock) -> dict[str, float]:
    """Returns three times [ms] of a frame: "p50_ms" and "p95_ms", the median and the 95th percentile of its wall time,
    and "cpu_ms", the median of its processor time. The first frame, which has no past, does not count."""
    wall, cpu = clock.wall_ms[1:], clock.cpu_ms[1:]
    return {
        "p50_ms": float(np.median(wall)),
        "p95_ms": float(np.percentile(wall, 95.0)),
        "cpu_ms": float(np.median(cpu)),
    }


def means(rows: Sequence[Row]) -> list[Row]:
    """Returns a row for each combination of knobs, for the rival and for physics: the means of ``rows``, the number of
    "cases", "gain_p05", the 5th percentile of gain, and "pareto", which is true where nothing else has a higher gain in
    as little time."""
    summary: list[Row] = []
    for tier, knobs in dict.fromkeys((row["tier"], row["knobs"]) for row in rows):
        same = [row for row in rows if (row["tier"], row["knobs"]) == (tier, knobs)]
        first = {name: same[0].get(name) for name in ("tier", "knobs", *KNOBS)} | {"cases": len(same)}
        known = {name: [row[name] for row in same if np.isfinite(row.get(name, np.nan))] for name in MEANS}
        worst = {"gain_p05": float(np.percentile([row["gain"] for row in same], 5.0))}
        summary.append(first | {name: float(np.mean(values)) for name, values in known.items() if values} | worst)
    for row in summary:
        row["pareto"] = not any(
            other["time_ratio"] <= row["time_ratio"] and other["gain"] > row["gain"] for other in summary
        )
    return summary


def tiers_of(mean: Sequence[Row]) -> list[Row]:
    """Returns four rows of ``mean``, one for each tier from the least to the most. Raises ``InputError`` where ``mean``
    has none with folds or none without.

    ``instant`` is the cheapest without folds that has ``LIFTED`` of the most that rows without folds gain over the
    cheapest of these, ``fast`` the cheapest with folds. ``accurate`` folds all vertices and has no more detail than
    ``DETAIL_MOST``, because gain does not see fine folds and crossings; it gains the most of these, or the most of all
    with folds where no row is so. ``balanced`` is the cheapest that goes at least half of the
    way from the gain of ``fast`` to that of ``accurate``, and ``SMOOTHER`` of the way between their curvatures, which
    the eye sees first; among those at most ``AS_CHEAP`` times as dear it is the one with the least curvature. A tier's
    folds, and its passes under folds, are never less than those of the one below, and none is coarse above a fine one.
    Times are compared with each other alone, so that the rule gives the same tiers on processors on which the rival is
    faster or slower.
    """
    by_order = sorted(mean, key=lambda row: row["time_ratio"])
    lifted = [row for row in by_order if row.get("folds") == 0]
    served = [row for row in by_order if row.get("folds")]
    if not served or not lifted:
        raise InputError("knobs", expected="combinations with folds and without", got="none", cure="Measure folds too.")
    least, above = served[0], [row for row in served if _covers(row, served[0])]
    fine = [row for row in above if not row["coarse"] and row["detail_share"] <= DETAIL_MOST] or above
    last = max(fine, key=lambda row: row["gain"])
    shares = {"gain": 0.5, "curvature": SMOOTHER}
    gain, curvature = (least[name] + share * (last[name] - least[name]) for name, share in shares.items())
    good = [row for row in above if row["gain"] >= gain and row["curvature"] <= curvature]
    good = [row for row in good if _covers(last, row)] or [last]
    cheap = [row for row in good if row["time_ratio"] <= AS_CHEAP * good[0]["time_ratio"]]
    middle = min(cheap, key=lambda row: row["curvature"])
    enough = (1.0 - LIFTED) * lifted[0]["gain"] + LIFTED * max(row["gain"] for row in lifted)
    return [next(row for row in lifted if row["gain"] >= enough), least, middle, last]


def _covers(row: Row, below: Row) -> bool:
    more = row["passes"] is None or (below["passes"] is not None and below["passes"] <= row["passes"])
    return more and row["folds"] >= below["folds"] and below["coarse"] >= row["coarse"]


def manifest_tiers(chosen: Sequence[Row], where: dict[str, Any]) -> list[Row]:
    """Returns the tiers of a manifest, fields of ``drape.stages.tiers.Tier`` by name, for the rows ``chosen`` of
    ``tiers_of``. The figures of each are those of its row and ``where``, more figures by name. ``alone`` is the passes
    of the least row in the two least tiers, and None, for all passes, in the others. With folds the least tier has the
    passes of the one above it."""
    alone, above = (row["passes"] for row in chosen[:2])
    figures = (
        "time_ratio",
        "cpu_ms",
        "gain",
        "gain_p05",
        "curvature",
        "error_mm",
        "edge_pct",
        "detail_share",
        "jitter_ratio",
    )
    return finite(
        [
            asdict(
                Tier(
                    name,
                    row["passes"] if i else above,
                    row["folds"],
                    None if i > 1 else alone,
                    {key: row[key] for key in figures} | where,
                    row["coarse"],
                )
            )
            for i, (name, row) in enumerate(zip(NAMES, chosen, strict=True))
        ]
    )


def write_tiers(folder: Path, tiers: list[Row]) -> None:
    """Writes ``tiers`` into the manifest of the model ``folder``. Raises ``ArtifactError`` where the service would not
    take them."""
    read_tiers(tiers)
    manifest = replace(load_manifest(folder), tiers=tiers)
    (folder / "manifest.json").write_text(manifest.to_json())


def combinations(steps: Sequence[int]) -> list[Knobs]:
    """Returns the combinations of ``PASSES`` with no folds, and with each number of ``steps`` of folds on the coarse
    cloth and on the fine one."""
    lifted = [Knobs(passes, 0, coarse=True) for passes in PASSES]
    return lifted + [Knobs(passes, n, coarse) for coarse in (True, False) for passes in PASSES for n in steps]


@Benchmark(
    "tradeoff",
    "Speed against accuracy.",
    COLUMNS,
    *inputs(("tshirt", "dress", "trousers"), ("walk", "squat"), quick_garments=("tshirt",), quick_motions=("walk",)),
    Option("--fabrics", ("jersey", "denim", "satin"), "what garments are made of", ("jersey",)),
    Option("--folds", (2, 4, 5), "steps of folds", (1, 2)),
    Option("--frames", 48, "of a clip at most", 8),
    Option("--write", False, "put the tiers into the model's manifest"),
)
def main(run: Run) -> None:
    """Adds to ``run`` the rows of every scene, and to its record their means and the tiers; with ``--write`` puts the
    tiers into the model's manifest."""
    options, body = run.options, load_body()
    folder = model_folder(options.model)
    drapery = DrapeRuntime(Settings(model=str(folder), threads=options.threads), body=body)
    networks = {name: ModelDrape.asked(options, body, passes=passes) for name, passes in STARTS.items()}
    knobs = combinations(options.folds)
    for scene in scenes(options, read_case_clips(options, body), body):
        run.rows += measure_knobs(Case.of(scene, networks), drapery, knobs)
        print(f"{', '.join(scene.name.values())}: done", flush=True)
    drapery.close()
    mean = means(run.rows)
    chosen = tiers_of(mean)
    for name, row in zip(NAMES, chosen, strict=True):
        row["tier"] = name if not row["tier"] else f"{row['tier']}, {name}"
    tiers = manifest_tiers(chosen, {"machine": machine(), "garments": len(options.garments)})
    run.notes += ["", text_table(mean, COLUMNS | {"gain_p05": ".3f"}), json.dumps(tiers)]
    if options.write:
        write_tiers(folder, tiers)
    run.extra |= {"means": mean, "tiers": tiers, "frames": options.frames, "model": options.model}


if __name__ == "__main__":
    main.command()
