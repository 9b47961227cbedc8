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
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR, stored_minimum
from benchmarks.papers.representation_drape import (
    Bench,
    Drapes,
    drape,
    frame_spaces,
    open_bench,
    static_parts,
    total_j,
)
from benchmarks.papers.representation_minimise import STEP_LIMIT
from benchmarks.papers.representation_space import (
    REPRESENTATIONS,
    PatchSpace,
    VertexSpace,
    charts,
    repartitioned,
)
from benchmarks.shared import common
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.material import material
from drape.errors import InputError, ended
from drape.garment.partition import patch_count_for
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

GARMENTS = ("tshirt", "trousers", "dress")
COLUMNS = {
    "garment": "s", "method": "s", "patches": "d", "numbers": "d", "membrane_j": ".4f", "energy_j": ".4f",
    "edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".3f", "gain": ".3f", "steps": ".0f",
    "change": ".1e", "residual_j": ".1e", "seconds": ".0f",
}  # fmt: skip


def measure(bench: Bench, options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per method, skinning first, ``free`` last."""
    rows = [figures(bench, "skinning", bench.skinned), figures(bench, "skinning_push", bench.pushed)]
    by_rule = patch_count_for(float(bench.rest.areas.sum()))
    best: Drapes | None = None
    for percent in options.patches:
        garment = bench.garment
        if percent != 100:
            garment = repartitioned(garment, bench.rest, round(by_rule * percent / 100.0))
        found = charts(garment, bench.cloth, bench.material)
        for form in (REPRESENTATIONS[name] for name in options.forms):
            if percent != 100 and (form.skinned or form.turns):
                continue
            drapes = drape(bench, frame_spaces(bench, form, found), step_limit=options.steps)
            rows.append(figures(bench, form.name, drapes.vertices, form.number_count, drapes, percent))
            if best is None or total_j(bench, drapes.vertices) < total_j(bench, best.vertices):
                best = drapes
    optimum = house_optimum(bench, options)
    rows.append(figures(bench, "physics", optimum.vertices) | {"steps": float(optimum.steps.mean())})
    start = optimum.vertices
    if best is not None and total_j(bench, best.vertices) < total_j(bench, start):
        start = best.vertices
    stiffness = physics.vertex_stiffness(bench.cloth, bench.material)
    free = drape(bench, [VertexSpace(frame, stiffness) for frame in start], step_limit=2 * options.steps)
    rows.append(figures(bench, "free", free.vertices, drapes=free))
    for row in rows:
        row["gain"] = metrics.gain(rows[1]["energy_j"], row["energy_j"], rows[-1]["energy_j"])
    return rows


def house_optimum(bench: Bench, options: argparse.Namespace) -> physics.Optimum:
    """The physics optimum as benchmarks.quality minimises it, from the folder of stored ones where it is there."""
    task = physics.Task.of_garment(
        bench.garment,
        options.body,
        bench.cloth,
        bench.material,
        contact=bench.contact,
        body_vertices=bench.body_vertices,
        skinned=bench.skinned,
        starts=(bench.pushed,),
    )
    limit = min(physics.STEPS, options.steps)
    return stored_minimum(task, limit, options.physics_folder)[0]


def figures(
    bench: Bench,
    method: str,
    vertices: np.ndarray,
    number_count: int | None = None,
    drapes: Drapes | None = None,
    percent: int | None = None,
) -> dict[str, Any]:
    """The row of a method, printed as it comes."""
    rest, faces = bench.rest.vertices, bench.rest.faces
    row: dict[str, Any] = {"garment": bench.garment.name, "method": method}
    if drapes is not None and isinstance(drapes.spaces[0], PatchSpace):
        row |= {"patches": drapes.spaces[0].charts.patch_count, "numbers": number_count, "percent": percent}
    row |= {f"{name}_j": float(value.mean()) for name, value in static_parts(bench, vertices).items()}
    row |= {
        "energy_j": total_j(bench, vertices),
        "edge_pct": float(metrics.edge_strain_pct(vertices, rest, faces).mean()),
        "area_pct": float(metrics.area_strain_pct(vertices, rest, faces).mean()),
        "colliding_vertex_pct": float(
            metrics.colliding_vertex_pct(vertices, bench.body_vertices, bench.body_normals).mean()
        ),
    }
    if drapes is not None:
        row |= {
            "steps": float(np.mean([m.steps for m in drapes.minima])),
            "change": max(m.change for m in drapes.minima),
            "residual_j": float(np.mean([m.residual_j for m in drapes.minima])),
            "seconds": drapes.seconds,
        }
    print(f"{row['garment']} {method} {percent or ''}: {row['energy_j']:.4f} J", flush=True)
    return row


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.papers.representation", description="What each form of patch can reach at best."
    )
    parser.add_argument("--garments", nargs="+", help=f"names, files or folders (default {' '.join(GARMENTS)})")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help="hard poses (default 2, quick 1)")
    parser.add_argument("--patches", type=int, nargs="+", help="patch counts in %% of the rule (default 100 50 200)")
    parser.add_argument("--forms", nargs="+", choices=REPRESENTATIONS, help="forms of patch (default: all)")
    parser.add_argument("--steps", type=int, help=f"most steps per frame (default {STEP_LIMIT}, quick 60)")
    parser.add_argument("--no-physics-cache", action="store_true", help="neither read nor store physics optima")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    quick = options.quick
    options.garments = options.garments or (["tshirt"] if quick else list(GARMENTS))
    options.frames = options.frames or (1 if quick else 2)
    options.patches = options.patches or ([100] if quick else [100, 50, 200])
    options.forms = options.forms or (["paper", "rigid_2"] if quick else list(REPRESENTATIONS))
    options.steps = options.steps or (60 if quick else STEP_LIMIT)
    if min(options.patches) <= 0:
        raise InputError("--patches", expected="shares above 0 %", got=str(options.patches), cure="Give 100, say.")
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body = load_body()
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    options.body, options.poses = body, poses.poses
    options.physics_folder = None if options.no_physics_cache else CACHE_DIR
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        rows += measure(open_bench(open_garment(path, body), body, poses.poses, material()), options)
    print()
    common.print_table(rows, COLUMNS)
    return common.finish("representation", rows, options, frames=list(poses.labels), steps=options.steps)


if __name__ == "__main__":
    sys.exit(ended(main))
