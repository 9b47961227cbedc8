"""How well each form of patch could drape at best: the ceiling that no network passes.

    python -m benchmarks.representation
    python -m benchmarks.representation --garments tshirt --frames 4 --patches 50 100 200 --save
    python -m benchmarks.representation --quick

Every frame's energy (membrane, bending, gravity, contact with the posed body) is minimised over the free
numbers of the patches, from the skinned start, by L-BFGS (benchmarks/representation_minimise.py); what a
form is stands in benchmarks/representation_space.py. ``--patches`` are shares [%] of the count by rule.

How far overlapping charts can agree is measured on ``rigid_2``: ``agreeing`` with heavier and heavier penalties,
``refit`` after consensus (benchmarks/representation_consensus.py; of the network ``network_refit``), ``through``
with consensus between the numbers and the vertices while they are minimised. ``refits`` counts its rounds. ``free``,
every vertex for itself, starts from the better of the physics optimum of benchmarks.quality and the best
form, and ends the scale of the gain.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import common, physics
from benchmarks.network import Network
from benchmarks.physics_cache import CACHE_DIR, cache_key, cached
from benchmarks.representation_agree import drape_agreeing, gain_at_gap
from benchmarks.representation_consensus import Refit
from benchmarks.representation_drape import (
    Bench,
    Drapes,
    after,
    drape,
    frame_spaces,
    network_drapes,
    open_bench,
    static_parts,
    total_j,
)
from benchmarks.representation_minimise import STEP_LIMIT
from benchmarks.representation_plot import plot
from benchmarks.representation_space import REPRESENTATIONS, Charts, PatchSpace, VertexSpace, charts, repartitioned
from drape.artifacts import DEFAULT_MODEL, model_folder
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.material import material
from drape.commands import ended
from drape.errors import InputError
from drape.garment.partition import patch_count_for
from drape.geometry import jets
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

GARMENTS = ("tshirt", "trousers", "dress")
AGREEING = "rigid_2"
AGREE_WEIGHTS = (4e3, 4e4, 4e5)  # the first is training's
ROUNDS = (1, 3)
GAPS_MM = (2.0, 3.0, 4.0, 10.0)
FULL_COUNT = 3 * jets.HEIGHT_COUNT  # numbers of a patch whose three polynomials are of order 4
PHYSICS_STEPS = 2000  # as benchmarks.quality
COLUMNS = {
    "garment": "s",
    "method": "s",
    "patches": "d",
    "numbers": "d",
    "membrane_j": ".4f",
    "energy_j": ".4f",
    "edge_pct": ".2f",
    "area_pct": ".2f",
    "colliding_vertex_pct": ".3f",
    "gain": ".3f",
    "disagreement_weight": ".0e",
    "refits": "d",
    "chart_gap_p99_mm": ".2f",
    "chart_gap_rms_mm": ".2f",
    "chart_normal_p99_deg": ".1f",
    "steps": ".0f",
    "change": ".1e",
    "residual_j": ".1e",
    "seconds": ".0f",
}


def measure(bench: Bench, options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row per method, skinning first, ``free`` last."""
    rows = [figures(bench, "skinning", bench.skinned), figures(bench, "skinning_push", bench.pushed)]
    by_rule = patch_count_for(float(bench.rest.areas.sum()))
    best: Drapes | None = None
    for percent in options.patches:
        garment = bench.garment
        if percent != 100:
            garment = repartitioned(garment, bench.rest, round(by_rule * percent / 100.0))
        found = charts(garment, bench.cloth, bench.material, sharpness=options.sharpness)
        made: dict[str, Drapes] = {}
        for form in (REPRESENTATIONS[name] for name in options.forms):
            if percent != 100 and (form.skinned or form.turns):
                continue
            drapes = made[form.name] = drape(bench, frame_spaces(bench, form, found), step_limit=options.steps)
            rows.append(figures(bench, form.name, drapes.vertices, form.number_count, drapes, percent))
            if best is None or total_j(bench, drapes.vertices) < total_j(bench, best.vertices):
                best = drapes
        if percent in options.agree_at:
            rows += agreeing(bench, found, made.get(AGREEING), percent, options)
    optimum = house_optimum(bench, options)
    rows.append(
        figures(bench, "physics", optimum.vertices)
        | {"steps": float(optimum.steps.mean()), "change": float(optimum.change.max())}
    )
    start = optimum.vertices
    if best is not None and total_j(bench, best.vertices) < total_j(bench, start):
        start = best.vertices
    stiffness = physics.vertex_stiffness(bench.cloth, bench.material)
    free = drape(bench, [VertexSpace(frame, stiffness) for frame in start], step_limit=2 * options.steps)
    rows.append(figures(bench, "free", free.vertices, drapes=free))
    for row in rows:
        row["gain"] = metrics.gain(rows[1]["energy_j"], row["energy_j"], rows[-1]["energy_j"])
    return rows


def agreeing(
    bench: Bench, found: Charts, freely: Drapes | None, percent: int, options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Rows of charts that are made to agree: by a penalty, by consensus afterwards, by both at once."""
    rows = []
    form = REPRESENTATIONS[AGREEING]
    refits = [Refit(found), Refit(found, plane_order=jets.HEIGHT_ORDER)]
    refits += [Refit(found, rounds=n, plane_order=jets.HEIGHT_ORDER) for n in options.rounds if n > 1]

    def row(method: str, drapes: Drapes, refit: Refit | None = None, weight: float | None = None) -> None:
        number_count = form.number_count if refit is None else refit.number_count
        found_row = figures(bench, method, drapes.vertices, number_count, drapes, percent)
        extra = {"refits": 0 if refit is None else refit.rounds, "disagreement_weight": weight}
        rows.append(found_row | {key: value for key, value in extra.items() if value is not None})

    def rows_after(method: str, drapes: Drapes, weight: float | None = None) -> None:
        for refit in refits:
            row(method, after(drapes, refit), refit, weight)

    if options.network is not None and percent == 100:
        drapes = network_drapes(bench, form, found, options.network.drape(bench.garment, options.poses))
        row("network", drapes)
        rows_after("network_refit", drapes)
    if freely is not None:
        rows_after("refit", freely)
    for weight, drapes in drape_agreeing(bench, form, found, options.agree, step_limit=options.steps):
        row("agreeing", drapes, weight=weight)
        if weight == options.agree[0]:
            rows_after("agreeing_refit", drapes, weight)
    for refit in refits[: 2 if options.agree else 0]:
        drapes = drape(bench, frame_spaces(bench, form, found, refit=refit), step_limit=options.steps)
        row("through", drapes, refit, 0.0)
    for weight, drapes in drape_agreeing(bench, form, found, options.agree, step_limit=options.steps, refit=refits[1]):
        row("through", drapes, refits[1], weight)
    return rows


def agreement(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The gain that is left where charts agree to within ``GAPS_MM``, by a penalty alone and through consensus.

    None where no measured penalty gets there.
    """
    curves: dict[tuple[str, int, str], list[tuple[float, float]]] = {}
    for row in rows:
        means = {AGREEING: "penalty", "agreeing": "penalty", "through": "consensus"}.get(row["method"])
        if means == "penalty" or (means and row["numbers"] == FULL_COUNT):
            curve = curves.setdefault((row["garment"], row["percent"], means), [])
            curve.append((row["chart_gap_p99_mm"], row["gain"]))
    return [
        {"garment": garment, "percent": percent, "means": means, "gap_mm": gap, "gain": gain_at_gap(curve, gap)}
        for (garment, percent, means), curve in curves.items()
        if len(curve) > 1
        for gap in GAPS_MM
    ]


def house_optimum(bench: Bench, options: argparse.Namespace) -> physics.Optimum:
    """The physics optimum as benchmarks.quality minimises it, from the folder of stored ones where it is there."""

    def run() -> physics.Optimum:
        return physics.minimise(
            bench.cloth,
            bench.material,
            bench.pushed,
            bench.contact,
            bench.body_vertices,
            step_limit=limit,
            name=bench.garment.name,
        )

    limit = min(PHYSICS_STEPS, 4 * options.steps)
    key = cache_key(bench.garment, options.body, options.poses, bench.material, limit, physics.TOLERANCE)
    return cached(key, run, options.physics_folder)[0]


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
        found = vars(drapes.charts).items()
        row |= {f"chart_{name}": value for name, value in found if np.isfinite(value)}
    if drapes is not None and drapes.minima:
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
        prog="python -m benchmarks.representation", description="What each form of patch can reach at best."
    )
    parser.add_argument("--garments", nargs="+", help=f"names, files or folders (default {' '.join(GARMENTS)})")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help="hard poses (default 2, quick 1)")
    parser.add_argument("--patches", type=int, nargs="+", help="patch counts in %% of the rule (default 100 50 200)")
    parser.add_argument("--forms", nargs="+", choices=REPRESENTATIONS, help="forms of patch (default: all)")
    parser.add_argument("--sharpness", type=float, default=1.0, help="power of the blend's weights (default 1)")
    parser.add_argument("--agree", type=float, nargs="*", help="weights of disagreement [J/m^2 per m^2], ascending")
    parser.add_argument("--agree-at", type=int, nargs="+", help="patch counts under them, in %% (default 100)")
    parser.add_argument("--rounds", type=int, nargs="+", default=list(ROUNDS), help="of consensus (default 1 3)")
    parser.add_argument("--model", default=DEFAULT_MODEL, help="folder under assets/models, or none")
    parser.add_argument("--steps", type=int, help=f"most steps per frame (default {STEP_LIMIT}, quick 60)")
    parser.add_argument("--no-physics-cache", action="store_true", help="neither read nor store physics optima")
    parser.add_argument("--plot", type=Path, help="draw the trade of energy against numbers into this PNG")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    quick = options.quick
    options.garments = options.garments or (["tshirt"] if quick else list(GARMENTS))
    options.frames = options.frames or (1 if quick else 2)
    options.patches = options.patches or ([100] if quick else [100, 50, 200])
    options.forms = options.forms or (["paper", "rigid_2"] if quick else list(REPRESENTATIONS))
    options.agree = ([] if quick else list(AGREE_WEIGHTS)) if options.agree is None else sorted(options.agree)
    options.agree_at = options.agree_at or [100]
    options.steps = options.steps or (60 if quick else STEP_LIMIT)
    if options.sharpness <= 0.0:
        raise InputError("--sharpness", expected="a power above 0", got=str(options.sharpness), cure="Give 1 or more.")
    if min(options.rounds) < 1:
        raise InputError("--rounds", expected="1 or more", got=str(options.rounds), cure="Give 1, say.")
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
    options.network = None
    if options.model != "none":
        options.network = Network(model_folder(options.model), body, threads=options.threads)
    options.physics_folder = None if options.no_physics_cache else CACHE_DIR
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        rows += measure(open_bench(open_garment(path, body), body, poses.poses, material()), options)
    print()
    common.print_table(rows, COLUMNS)
    trade = agreement(rows)
    for entry in trade:
        gain = "cannot be had" if entry["gain"] is None else f"gain {entry['gain']:.3f}"
        print("{garment} {percent} %, {means}: charts within {gap_mm:g} mm (p99):".format(**entry), gain)
    record = common.finish(
        "representation", rows, options, frames=list(poses.labels), steps=options.steps, agreement=trade
    )
    if options.plot:
        plot(rows, options.plot)
    return record


if __name__ == "__main__":
    sys.exit(ended(main))
