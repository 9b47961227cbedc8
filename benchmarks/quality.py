"""How good the drape is: skinning, network and physics side by side, on hard poses (docs/quality.md).

    python -m benchmarks.quality
    python -m benchmarks.quality --garments tshirt dress --motions walk squat --frames 6
    python -m benchmarks.quality --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save
    python -m benchmarks.quality --patches 2 --out fine.json

A garment is a name under assets/garments, a cache file, a mesh, or a folder of either; a
motion is a name under assets/motions, a file, or a folder. Everything is measured at rest
(motion knob 0) on the garment's subdivided mesh; jitter on continuous windows of the motions.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from benchmarks import common, physics
from benchmarks.network import Network
from benchmarks.physics_cache import CACHE_DIR
from benchmarks.quality_jitter import typical_windows
from benchmarks.quality_measures import Bench, measure, summary
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, is_shipped, open_garment
from drape.cloth.contact import BodyContact
from drape.cloth.material import material
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.fitting import patch_fields, rest_garment
from drape.garment.partition import patch_count_for
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

SETS = ("trained", "unseen")
FRAMES, QUICK_FRAMES = 12, 2
STEPS, QUICK_STEPS = 2000, 150
COLUMNS = {
    "garment": "s",
    "set": "s",
    "method": "s",
    "edge_pct": ".2f",
    "area_pct": ".2f",
    "edge_over_physics_pp": ".2f",
    "area_over_physics_pp": ".2f",
    "colliding_vertex_pct": ".3f",
    "colliding_triangle_pct": ".3f",
    "self_intersections": ".1f",
    "chart_gap_p99_mm": ".2f",
    "chart_normal_p99_deg": ".2f",
    "jitter_ratio": ".2f",
    "jitter_worst": ".2f",
    "energy_j": ".4f",
    "membrane_j": ".4f",
    "gain": ".3f",
}
# The table's head, where the key is longer than its numbers; the record keeps the keys.
HEADS = {
    "edge_over_physics_pp": "edge_over",
    "area_over_physics_pp": "area_over",
    "colliding_vertex_pct": "vertex_pct",
    "colliding_triangle_pct": "triangle_pct",
    "self_intersections": "self",
    "chart_gap_p99_mm": "gap_mm",
    "chart_normal_p99_deg": "normal_deg",
    "jitter_ratio": "jitter",
    "jitter_worst": "worst",
}


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality", description="Quality of skinning, network and physics, side by side."
    )
    parser.add_argument("--garments", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--model", default=DEFAULT_MODEL, help=f"name under assets/models (default {DEFAULT_MODEL})")
    parser.add_argument(
        "--set", choices=SETS, help="what the garments are (default: shipped ones trained, files unseen)"
    )
    parser.add_argument("--patches", type=float, help="cover garments anew, by this many over the usual number")
    parser.add_argument("--material", default="jersey", help="cloth (drape.cloth.material)")
    parser.add_argument("--steps", type=int, help=f"most physics steps (default {STEPS}, quick {QUICK_STEPS})")
    parser.add_argument(
        "--no-physics-cache", action="store_true", help="minimise again instead of taking stored optima, store none"
    )
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments = options.garments or ["tshirt"]
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    options.steps = options.steps or (QUICK_STEPS if options.quick else STEPS)
    return options


def open_bench(options: argparse.Namespace, body: BodyModel) -> Bench:
    """Motions, posed bodies and network as ``options`` ask."""
    clips = [read_motion(path) for path in find_motions(options.motions)]
    poses = hard_poses(clips, body, options.frames)
    contact = BodyContact(body.faces, body.vertex_count)
    body_vertices = body.posed_vertices(poses.poses)
    windows = typical_windows(clips)
    return Bench(
        body=body,
        poses=poses,
        contact=contact,
        body_vertices=body_vertices,
        body_normals=np.asarray(contact.normals(body_vertices)),
        network=Network(MODELS_DIR / options.model, body, threads=options.threads),
        material=material(options.material),
        step_limit=options.steps,
        windows=windows[:1] if options.quick else windows,
        physics_folder=None if options.no_physics_cache else CACHE_DIR,
    )


def covered(garment: Garment, body: BodyModel, share: float) -> Garment:
    """``garment`` covered anew, as intake does it, by ``share`` of the usual number of patches."""
    rest = rest_garment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), body)
    count = round(share * patch_count_for(float(rest.areas.sum())))
    return replace(garment, **patch_fields(rest, count=count, unfold=True))


def print_table(rows: list[dict[str, Any]]) -> None:
    """The rows under short heads."""
    named = [{HEADS.get(key, key): value for key, value in row.items()} for row in rows]
    common.print_table(named, {HEADS.get(key, key): form for key, form in COLUMNS.items()})


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body = load_body()
    bench = open_bench(options, body)
    rows: list[dict[str, Any]] = []
    refused: dict[str, str] = {}
    for path in find_garments(options.garments):  # one after the other, so that only one is in memory
        try:
            garment = open_garment(path, body)
            garment = covered(garment, body, options.patches) if options.patches else garment
        except InputError as error:
            # One bad file of a folder must not cost the table; it is named below and in the record.
            refused[error.name] = str(error)
            continue
        trained = options.set == "trained" if options.set else is_shipped(path)
        rows += measure(garment, bench, trained=trained)
        stored = ", stored" if rows[-1]["cached"] else ""
        print(f"{garment.name}: physics {rows[-1]['steps']:.0f} steps, {rows[-1]['seconds']:.0f} s{stored}", flush=True)
    if not rows:
        raise InputError("garments", expected="at least one usable", got=str(refused), cure="Check the files.")
    print()
    print_table([*rows, *summary(rows)])
    for row in (row for row in rows if row["method"] == "physics"):
        print(
            f"physics {row['garment']}: residual {row['residual_n']:.3f} N of {row['weight_n']:.2f} N weight, "
            f"energy changed by {row['change']:.1e} of its gain in the last {physics.CHECK_STEPS} steps"
        )
    if not bench.windows:
        print("no jitter: no clip has a second without a glitch")
    for message in refused.values():
        print(f"refused: {message}")
    return common.finish(
        "quality",
        rows,
        options,
        summary=summary(rows),
        frames=list(bench.poses.labels),
        windows=[window.label for window in bench.windows],
        model=options.model,
        model_digest=bench.network.manifest.digest,
        refused=refused,
        patch_share=options.patches or 1.0,
    )


if __name__ == "__main__":
    main()
