"""How good the drape is: skinning, network and physics side by side, on hard poses (docs/reference/quality.md).

    python -m benchmarks.quality
    python -m benchmarks.quality --garments tshirt dress --motions walk squat --frames 6
    python -m benchmarks.quality --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save
    python -m benchmarks.quality --patches 2 --out fine.json
    python -m benchmarks.quality --precision float32
    python -m benchmarks.quality --garments tshirt --fabrics jersey poplin --passes 0 --out fabrics.json

A garment is a name under assets/garments, a cache file, a mesh, or a folder of either; a
motion is a name under assets/motions, a file, or a folder. Everything is measured at rest
(motion knob 0) on the garment's subdivided mesh; jitter on continuous windows of the motions. The network is
the graph that the service runs on a CPU, in int8 unless ``--precision`` says otherwise.
``--fabrics`` measures every garment in each of them, with its rest state; of a network that knows fabrics, jersey is
what it is otherwise measured in. Of one that does not, it is the cloth of before fabrics (``--material``).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.jitter import typical_windows
from benchmarks.measure.measures import Bench, measure, summary
from benchmarks.shared import common
from benchmarks.shared.network import Network, add_precision
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment, was_trained_on
from drape.cloth.contact import BodyContact
from drape.cloth.fabric_table import DEFAULT_FABRIC, fabric
from drape.cloth.material import DEFAULT_MATERIAL, material
from drape.errors import InputError, ended
from drape.garment.cache import Garment
from drape.garment.fitting import patch_fields, rest_garment
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

SETS = ("trained", "unseen")
FRAMES, QUICK_FRAMES = 12, 2
QUICK_STEPS = 30
COLUMNS = {
    "garment": "s", "set": "s", "fabric": "s", "method": "s", "edge_pct": ".2f", "area_pct": ".2f",
    "edge_over_physics_pp": ".2f", "area_over_physics_pp": ".2f", "colliding_vertex_pct": ".3f",
    "colliding_triangle_pct": ".3f", "self_intersections": ".1f", "chart_gap_p99_mm": ".2f",
    "chart_normal_p99_deg": ".2f", "jitter_ratio": ".2f", "jitter_worst": ".2f", "hang_mm": ".1f", "detail_mm": ".3f",
    "dihedral_deg": ".1f", "detail_share": ".2f", "energy_j": ".4f", "membrane_j": ".4f", "gain": ".3f",
}  # fmt: skip
# The table's head, where the key is longer than its numbers; the record keeps the keys.
HEADS = {
    "edge_over_physics_pp": "edge_over", "area_over_physics_pp": "area_over", "colliding_vertex_pct": "vertex_pct",
    "colliding_triangle_pct": "triangle_pct", "self_intersections": "self", "chart_gap_p99_mm": "gap_mm",
    "chart_normal_p99_deg": "normal_deg", "jitter_ratio": "jitter", "jitter_worst": "worst",
}  # fmt: skip


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality", description="Quality of skinning, network and physics, side by side."
    )
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument(
        "--set", choices=SETS, help="what the garments are (default: shipped ones trained, files unseen)"
    )
    parser.add_argument("--patches", type=float, help="cover garments anew, by this many over the usual number")
    cloth = parser.add_mutually_exclusive_group()
    cloth.add_argument("--fabrics", nargs="+", metavar="NAME", help="measure in each (drape.cloth.fabric_table)")
    cloth.add_argument(
        "--material",
        help=f"the cloth of before fabrics (drape.cloth.material; default {DEFAULT_MATERIAL}, where the network does "
        "not know fabrics)",
    )
    parser.add_argument("--passes", type=int, help="corrections of the network that run (default: all)")
    parser.add_argument("--steps", type=int, help=f"most physics steps (default {physics.STEPS}, quick {QUICK_STEPS})")
    parser.add_argument(
        "--no-physics-cache",
        action="store_true",
        help="minimise again instead of taking stored drapes, store none",
    )
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments = options.garments or ["tshirt"]
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    options.steps = options.steps or (QUICK_STEPS if options.quick else physics.STEPS)
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
        network=Network(
            model_folder(options.model),
            body,
            threads=options.threads,
            precision=options.precision,
            passes=options.passes,
        ),
        material=material(options.material or DEFAULT_MATERIAL),
        step_limit=options.steps,
        windows=windows[:1] if options.quick else windows,
        physics_folder=None if options.no_physics_cache else CACHE_DIR,
        uncorrected=Network(
            model_folder(options.model), body, threads=options.threads, precision=options.precision, passes=0
        ),
    )


def in_fabrics(bench: Bench, options: argparse.Namespace) -> list[Bench]:
    """``bench`` in each of ``--fabrics``, or in what the network drapes by default.

    Refuses (``NotFound``) what is no fabric.
    """
    names = options.fabrics
    if names is None:
        names = [DEFAULT_FABRIC] if bench.network.engine.knows_fabrics and options.material is None else []
    chosen = {made.name: made for made in map(fabric, names)}
    return [bench.of_fabric(made) for made in chosen.values()] or [bench]


def covered(garment: Garment, body: BodyModel, share: float) -> Garment:
    """``garment`` covered anew, as intake does it, by ``share`` of the usual number of patches."""
    rest = rest_garment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), body)
    return replace(garment, **patch_fields(rest, share=share, unfold=True))


def print_table(rows: list[dict[str, Any]]) -> None:
    """The rows under short heads."""
    named = [{HEADS.get(key, key): value for key, value in row.items()} for row in rows]
    columns = {key: form for key, form in COLUMNS.items() if key != "fabric" or any(key in row for row in rows)}
    common.print_table(named, {HEADS.get(key, key): form for key, form in columns.items()})


def _named(row: dict[str, Any]) -> str:
    return _in_fabric(row["garment"], row.get("fabric"))


def _in_fabric(garment: str, fabric_name: str | None) -> str:
    return f"{garment} of {fabric_name}" if fabric_name else garment


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body = load_body()
    bench = open_bench(options, body)
    benches = in_fabrics(bench, options)
    known = bench.network.manifest.training.get("garments", ())
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
        print(f"{garment.name}: drapes and the physics optimum, minutes where it is not stored", flush=True)
        trained = options.set == "trained" if options.set else was_trained_on(garment, known)
        for made in benches:
            try:
                rows += measure(garment, made, trained=trained)
            except InputError as error:  # nor one garment without an optimum
                refused[_in_fabric(error.name, made.fabric.name if made.fabric else None)] = str(error)
                continue
            row = rows[-1]
            stored = ", stored" if row["cached"] else ""
            print(f"{_named(row)}: physics {row['steps']:.0f} steps, {row['seconds']:.0f} s{stored}", flush=True)
    if not rows:
        raise InputError("garments", expected="at least one usable", got=str(refused), cure="Check the files.")
    print()
    print_table([*rows, *summary(rows)])
    for row in (row for row in rows if row["method"] == "physics"):
        print(
            f"physics {_named(row)}: residual {row['residual_n']:.3f} N of {row['weight_n']:.2f} N weight, "
            f"{row['converged_pct']:.0f} % of the poses at rest ({100.0 * physics.TOLERANCE:g} % of the weight)"
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
        **bench.network.record(),
        passes=bench.network.passes,
        fabric=[made.fabric.name for made in benches if made.fabric],
        knows_fabrics=bench.network.engine.knows_fabrics,
        refused=refused,
        patch_share=options.patches or 1.0,
    )


if __name__ == "__main__":
    sys.exit(ended(main))
