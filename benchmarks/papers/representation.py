"""How well each form of patch could drape at best: the ceiling that no network passes.

    python -m benchmarks.papers.representation
    python -m benchmarks.papers.representation --garments tshirt --frames 4 --patches 50 100 200 --save
    python -m benchmarks.papers.representation --quick

Every frame's energy (membrane, bending, gravity, contact with the posed body) is minimised over the free
numbers of the patches, from the skinned start, by L-BFGS (representation_minimise.py); what a
form is stands in representation_space.py. ``--patches`` are shares [%] of the count by rule. ``free``, every vertex
for itself, starts from the better of the physics optimum of benchmarks.quality and the best form, and ends the scale
of the gain.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.papers.held_out import figures
from benchmarks.papers.representation_drape import Bench, Drapes, drape, frame_spaces
from benchmarks.papers.representation_minimise import STEP_LIMIT
from benchmarks.papers.representation_space import REPRESENTATIONS, VertexSpace, charts, repartitioned
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.material import material
from drape.errors import InputError
from drape.garment.partition import patch_count_for
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

GARMENTS = ("tshirt", "trousers", "dress")
COLUMNS = {
    "garment": "s", "method": "s", "patches": "d", "numbers": "d", "membrane_j": ".4f", "energy_j": ".4f",
    "edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".3f", "gain": ".3f", "steps": ".0f",
    "change": ".1e", "residual_j": ".1e", "seconds": ".0f",
}  # fmt: skip


def measure(bench: Bench, options: argparse.Namespace) -> list[Row]:
    """One row per method, skinning first, ``free`` last."""
    judge, folder = bench.judge, None if options.no_physics_cache else CACHE_DIR
    cloth = judge.cloth
    rows = [row_of(bench, "skinning", judge.skinned), row_of(bench, "skinning_push", judge.pushed)]
    by_rule = patch_count_for(float(bench.rest.areas.sum()))
    best: tuple[float, np.ndarray] = np.inf, judge.skinned
    for percent in options.patches:
        garment = cloth.garment
        if percent != 100:
            garment = repartitioned(garment, bench.rest, round(by_rule * percent / 100.0))
        found = charts(garment, cloth.mesh, cloth.material)
        for form in (REPRESENTATIONS[name] for name in options.forms):
            if percent != 100 and (form.skinned or form.turns):
                continue
            drapes = drape(bench, frame_spaces(bench, form, found), step_limit=options.steps)
            size = {"patches": found.patch_count, "numbers": form.number_count, "percent": percent}
            rows.append(size | row_of(bench, form.name, drapes.vertices, drapes))
            best = min(best, (rows[-1]["energy_j"], drapes.vertices), key=lambda one: one[0])
    optimum, _ = judge.optimum((judge.pushed,), folder, min(physics.STEPS, options.steps))
    rows.append(row_of(bench, "physics", optimum.vertices) | {"steps": float(optimum.steps.mean())})
    start = min(best, (rows[-1]["energy_j"], optimum.vertices), key=lambda one: one[0])[1]
    stiffness = physics.vertex_stiffness(cloth.mesh, cloth.material)
    free = drape(bench, [VertexSpace(frame, stiffness) for frame in start], step_limit=2 * options.steps)
    rows.append(row_of(bench, "free", free.vertices, free))
    for row in rows:
        row["gain"] = metrics.gain(rows[1]["energy_j"], row["energy_j"], rows[-1]["energy_j"])
    return rows


def row_of(bench: Bench, method: str, vertices: np.ndarray, drapes: Drapes | None = None) -> Row:
    """The row of a method, printed as it comes."""
    row = {"garment": bench.judge.cloth.garment.name, "method": method} | figures(bench.judge, vertices)
    if drapes is not None:
        row |= {
            "steps": float(np.mean([m.steps for m in drapes.minima])),
            "change": max(m.change for m in drapes.minima),
            "residual_j": float(np.mean([m.residual_j for m in drapes.minima])),
            "seconds": drapes.seconds,
        }
    print(f"{row['garment']} {method}: {row['energy_j']:.4f} J", flush=True)
    return row


@Benchmark(
    "representation",
    "What each form of patch can reach at best.",
    COLUMNS,
    Option("--garments", GARMENTS, "names, files or folders", GARMENTS[:1]),
    Option("--motions", (), "names, files or folders"),
    Option("--frames", 2, "hard poses", 1),
    Option("--patches", (100, 50, 200), "patch counts in % of the rule", (100,)),
    Option("--forms", tuple(REPRESENTATIONS), "forms of patch", ("paper", "rigid_2"), choices=REPRESENTATIONS),
    Option("--steps", STEP_LIMIT, "most steps per frame", 60),
    Option("--no-physics-cache", False, "neither read nor store physics optima"),
)
def main(run: Run) -> None:
    """Rows of every garment."""
    options, body = run.options, load_body()
    if min(options.patches) <= 0:
        raise InputError("--patches", expected="shares above 0 %", got=str(options.patches), cure="Give 100, say.")
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    for path in find_garments(options.garments):
        run.rows += measure(Bench.of(open_garment(path, body), body, poses.poses, material()), options)
    run.extra |= {"frames": list(poses.labels), "steps": options.steps}


if __name__ == "__main__":
    main.command()
