"""Recovery of own patterns: a base that is off by 5 to 10 % finds back the pattern that a target was draped from.

The target is draped by our own simulator from a known pattern, so that every control point has an error. A base is that
pattern with its panels 5 to 10 % off in width and height: the truth is within its reach, and whether the search gets
there is measured. The target's triangles are those of the same mesher at the same length, unless another is asked for;
its fabric may be another than the base's.

    python -m benchmarks.recovery [--quick] [--seeds 5] [--edge-length 0.05] [--save]
    python -m benchmarks.recovery --target-edge-length 0.02 --meshes 0.05 0.03 0.022
    python -m benchmarks.recovery --target-edge-length 0.016 --meshes 0.05 0.03 0.017 --first-seed 1 --seeds 1 --save
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
from recovery.fit.optimise import FitOptions, Fitted
from recovery.fit.pipeline import ROUNDS, recover_pattern
from recovery.fit.recovered import Recovered
from recovery.pattern.bases import skirt, tshirt
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern

GARMENTS = {"tshirt": tshirt, "skirt": skirt}
COLUMNS = {
    "garment": "s", "fabric": "s", "seed": "d", "nodes": "d", "base_mm": ".1f", "graded_mm": ".2f",
    "first_mm": ".2f", "mean_mm": ".2f", "max_mm": ".2f", "area_err": ".2f", "area_max": ".2f", "surface_mm": ".3f",
    "minutes": ".2f",
}  # fmt: skip
ROUND_COLUMNS = {
    "garment": "s", "seed": "d", "round": "d", "nodes": "d", "mean_mm": ".2f", "max_mm": ".2f", "area_err": ".2f",
    "surface_mm": ".3f", "steps": "d", "drapes": "d", "minutes": ".2f", "processor_minutes": ".2f",
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
)
def main(run: Run) -> None:
    """Rows of every garment, fabric and base."""
    options = run.options
    drape = DrapeOptions(edge_length_m=options.edge_length, grid_m=options.grid)
    fit = FitOptions(iterations=options.adam, closing=options.closing)
    meshes = list(options.meshes) or [options.edge_length] * ROUNDS
    fabrics = options.fabrics or [DEFAULT_MATERIAL]
    rounds_of: list[Row] = []
    for garment, fabric in product(options.garments, fabrics):
        there = replace(drape, fabric=fabric, edge_length_m=options.target_edge_length or options.edge_length)
        truth, target = target_of(garment, there)
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            found, row = recover(truth, target, seed, drape, fit, meshes_m=meshes)
            run.rows.append({"garment": garment, "fabric": fabric, **row})
            rounds_of += [{"garment": garment, "seed": seed, **line} for line in by_round(found, truth)]
    if options.meshes:
        run.extra["by_round"] = rounds_of
        run.notes.append(text_table(rounds_of, ROUND_COLUMNS))
    run.name = "recovery_fabrics" if len(fabrics) > 1 else "recovery"
    if options.meshes or options.target_edge_length is not None:
        run.name += "_rounds" if options.meshes else "_other_mesh"


if __name__ == "__main__":
    main.command()
