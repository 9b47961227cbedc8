"""Recovery of own patterns: a base that is off by 5 to 10 % finds back the pattern that a target was draped from.

The target is draped by our own simulator from a known pattern, so that every control point has an error. A base is that
pattern with its panels 5 to 10 % off in width and height: the truth is within its reach, and whether the search gets
there is measured. The target's triangles are those of the same mesher at the same length, unless another is asked for;
its fabric may be another than the base's.

    python -m benchmarks.recovery [--quick] [--seeds 5] [--edge-length 0.05] [--save]
    python -m benchmarks.recovery --target-edge-length 0.02 --meshes 0.05 0.03 0.022
    python -m benchmarks.recovery --target-edge-length 0.016 --meshes 0.05 0.03 0.017 --first-seed 1 --seeds 1 --save
    python -m benchmarks.recovery --fabrics crisp limp --free-cloth
    python -m benchmarks.recovery --ablation --garments skirt --seeds 5 --save
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.recovery.compare import off, pattern_error
from benchmarks.tables import Row, text_table
from drape.body.assets import load_body
from drape.cloth.material import DEFAULT_MATERIAL, FABRICS
from recovery.drape.pipeline import Draped, DrapeOptions, drape_pattern
from recovery.fit.objective import Weights
from recovery.fit.optimise import FitOptions, Fitted
from recovery.fit.pipeline import ROUNDS, recover_pattern
from recovery.fit.recovered import Recovered
from recovery.pattern import geometry
from recovery.pattern.bases import skirt, tshirt
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern

GARMENTS = {"tshirt": tshirt, "skirt": skirt}
# What is left out, as in table 3 of Yu, Cordier and Seo (2024); their full model, and two things that are ours.
VARIANTS: dict[str, dict[str, Any]] = {
    "all": {},
    "no contours": {"weights": Weights(contours=0.0)},
    "no curvature weights": {"weights": Weights(folds=0.0)},
    "no seams": {"weights": Weights(seams=0.0)},
    "no grading": {"grading": False},
    "no material": {"fabrics": (), "free_cloth": False},
    "no reach": {"weights": Weights(reach_m=float("inf"))},
    "one mesh": {"rounds": 1},
}
ABLATION_FABRIC = "crisp"  # of its targets, so that the material has something to tell
COLUMNS = {
    "garment": "s", "fabric": "s", "variant": "s", "seed": "d", "nodes": "d", "base_mm": ".1f", "graded_mm": ".2f",
    "first_mm": ".2f", "mean_mm": ".2f", "max_mm": ".2f", "area_err": ".2f", "area_max": ".2f", "surface_mm": ".3f",
    "minutes": ".2f",
}  # fmt: skip
ROUND_COLUMNS = {
    "garment": "s", "seed": "d", "round": "d", "nodes": "d", "mean_mm": ".2f", "max_mm": ".2f", "area_err": ".2f",
    "surface_mm": ".3f", "steps": "d", "drapes": "d", "minutes": ".2f", "processor_minutes": ".2f",
}  # fmt: skip
PAIR_COLUMNS = {
    "garment": "s", "fabrics": "s", "seed": "d", "mean_mm": ".2f", "area_mean_pct": ".2f", "area_max_pct": ".2f",
    "edge_mean_pct": ".2f", "edge_max_pct": ".2f",
}  # fmt: skip
SPREAD_COLUMNS = {
    "garment": "s", "variant": "s", "seeds": "d", "mean_mm": ".2f", "mean_mm_sd": ".2f", "area_err": ".2f",
    "area_err_sd": ".2f", "surface_mm": ".3f", "surface_mm_sd": ".3f",
}  # fmt: skip


def target_of(garment: str, drape: DrapeOptions) -> tuple[Pattern, Draped]:
    """The true pattern of a garment, and what it drapes to."""
    body = load_body()
    truth = GARMENTS[garment](measure(body))
    return truth, drape_pattern(truth, body, drape)


def errors(fitted: Fitted, truth: Pattern) -> Row:
    """Errors of control points [mm], of areas [%] and of the surface [mm] of what a search found, at its best step."""
    error, history = pattern_error(fitted.pattern, truth), fitted.history
    areas = 100.0 * np.abs(error.areas)
    return {
        "mean_mm": 1e3 * float(error.controls_m.mean()),
        "max_mm": 1e3 * float(error.controls_m.max()),
        "area_err": float(areas.mean()),
        "area_max": float(areas.max()),
        "surface_mm": 1e3 * float(np.sqrt(0.5 * history[history[:, 0].argmin(), 1])),
    }


def recover(
    truth: Pattern, target: Draped, seed: int, drape: DrapeOptions, fit: FitOptions, **options: Any
) -> tuple[Recovered, Row]:
    """One recovery by ``recover_pattern`` with ``options``, and its errors."""
    base = off(truth, seed)
    started = time.perf_counter(), time.process_time()
    found = recover_pattern(
        target.nodes, target.mesh.faces, base, load_body(), drape=drape, fit=fit, progress=True, **options
    )
    minutes, processor = (
        (now - then) / 60.0 for now, then in zip((time.perf_counter(), time.process_time()), started, strict=True)
    )
    earlier = {"base": base, "graded": found.graded.pattern, "first": found.rounds[0].fitted.pattern}
    return found, {
        "seed": seed,
        "nodes": found.start.mesh.node_count,
        "target_nodes": target.mesh.node_count,
        **{f"{name}_mm": 1e3 * float(pattern_error(one, truth).controls_m.mean()) for name, one in earlier.items()},
        **errors(found.fitted, truth),
        "steps": sum(len(one.fitted.history) - 1 for one in found.rounds),
        "rounds": len(found.rounds),
        "nearest": found.fabric.describe(),
        "target_at_rest": target.at_rest,
        "minutes": minutes,
        "processor_minutes": processor,
    }


def by_round(found: Recovered, truth: Pattern) -> list[Row]:
    """Errors and times of every round of a recovery; the pattern of a round is the best of it."""
    return [
        {
            "round": number,
            "nodes": one.start.mesh.node_count,
            **errors(one.fitted, truth),
            "steps": len(one.fitted.history) - 1,
            "drapes": one.search.forward.drapes,
            "minutes": one.seconds / 60.0,
            "processor_minutes": one.processor_s / 60.0,
        }
        for number, one in enumerate(found.rounds, start=1)
    ]


def compare(found: dict[tuple[str, str, int], Recovered]) -> list[Row]:
    """How far patterns recovered from targets of different fabrics are from each other (figure 5 of the paper)."""
    pairs = []
    for (garment, fabric, seed), one in found.items():
        for (other_garment, other_fabric, other_seed), other in found.items():
            if (garment, seed) == (other_garment, other_seed) and fabric < other_fabric:
                error = pattern_error(one.fitted.pattern, other.fitted.pattern)
                edges = [lengths(of.fitted.pattern) for of in (one, other)]
                off_pct = 100.0 * np.abs(edges[0] / edges[1] - 1.0)
                pairs.append(
                    {
                        "garment": garment,
                        "fabrics": f"{fabric}, {other_fabric}",
                        "seed": seed,
                        "mean_mm": 1e3 * float(error.controls_m.mean()),
                        "area_mean_pct": 100.0 * float(np.abs(error.areas).mean()),
                        "area_max_pct": 100.0 * float(np.abs(error.areas).max()),
                        "edge_mean_pct": float(off_pct.mean()),
                        "edge_max_pct": float(off_pct.max()),
                    }
                )
    return pairs


def lengths(pattern: Pattern) -> np.ndarray:
    """Lengths [m] of all edges of all panels."""
    return np.array([geometry.edge_length(panel, edge) for panel in pattern.panels for edge in range(len(panel.edges))])


def spread(rows: list[Row]) -> list[Row]:
    """Mean and standard deviation over the seeds, by garment and variant."""
    found = []
    for garment, variant in dict.fromkeys((row["garment"], row["variant"]) for row in rows):
        mine = [row for row in rows if (row["garment"], row["variant"]) == (garment, variant)]
        line: Row = {"garment": garment, "variant": variant, "seeds": len(mine)}
        for key in ("mean_mm", "area_err", "surface_mm"):
            values = np.array([row[key] for row in mine])
            line[key] = float(values.mean())
            line[f"{key}_sd"] = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        found.append(line)
    return found


@Benchmark(
    "recovery",
    "Recovery of own patterns from bases of another size.",
    COLUMNS,
    Option("--garments", ("tshirt",), "which", choices=sorted(GARMENTS)),
    Option("--seeds", 5, "how many disturbed bases", 1),
    Option("--first-seed", 0, "number of the first of them"),
    Option("--edge-length", 0.05, "of the mesh [m]"),
    Option("--target-edge-length", None, "of the target's mesh [m] (default the same)", kind=float),
    Option("--meshes", (), "edge lengths [m] of the rounds (default three equal ones)", kind=float),
    Option("--grid", 0.02, "spacing of the body's distance [m]"),
    Option("--adam", FitOptions().iterations, "steps of Adam"),
    Option("--closing", FitOptions().closing, "steps of Gauss and Newton after it"),
    Option("--fabrics", (), "of the targets; the base has jersey's", choices=sorted(FABRICS)),
    Option("--free-cloth", False, "choose the fabric and free its constants"),
    Option("--ablation", False, "leave out one thing at a time, as in table 3"),
)
def main(run: Run) -> None:
    """Rows of every garment, fabric, variant and base."""
    options = run.options
    drape = DrapeOptions(edge_length_m=options.edge_length, grid_m=options.grid)
    fit = FitOptions(iterations=options.adam, closing=options.closing)
    meshes = list(options.meshes) or [options.edge_length] * ROUNDS
    cloth = {"fabrics": tuple(FABRICS), "free_cloth": True} if options.free_cloth or options.ablation else {}
    fabrics = options.fabrics or [ABLATION_FABRIC if options.ablation else DEFAULT_MATERIAL]
    rounds_of: list[Row] = []
    found: dict[tuple[str, str, int], Recovered] = {}
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for garment, fabric in product(options.garments, fabrics):
        there = replace(drape, fabric=fabric, edge_length_m=options.target_edge_length or options.edge_length)
        truth, target = target_of(garment, there)
        for variant, seed in product(VARIANTS if options.ablation else ["all"], seeds):
            own = {"rounds": len(meshes), **cloth, **VARIANTS[variant]}
            own["meshes_m"] = meshes[: own.pop("rounds")]
            one, row = recover(truth, target, seed, drape, fit, **own)
            run.rows.append({"garment": garment, "fabric": fabric, "variant": variant, **row})
            found[garment, fabric, seed] = one
            rounds_of += [{"garment": garment, "seed": seed, **line} for line in by_round(one, truth)]
    tables: dict[str, tuple[list[Row], dict[str, str]]] = {}
    if options.meshes:
        tables["by_round"] = rounds_of, ROUND_COLUMNS
    if len(fabrics) > 1:
        tables["pairs"] = compare(found), PAIR_COLUMNS
    if options.ablation:
        tables["spread"] = spread(run.rows), SPREAD_COLUMNS
    run.extra |= {name: rows for name, (rows, _) in tables.items()}
    run.notes += [text_table(rows, columns) for rows, columns in tables.values()]
    run.name = "recovery_ablation" if options.ablation else "recovery_fabrics" if len(fabrics) > 1 else "recovery"
    if not options.ablation and (options.meshes or options.target_edge_length is not None):
        run.name += "_rounds" if options.meshes else "_other_mesh"


if __name__ == "__main__":
    main.command()
