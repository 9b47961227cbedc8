"""The packed graph in int8 beside the one in float32: what it saves, and what rounding does to the drape.

    python -m benchmarks.int8 [--garments tshirt dress] [--motions ...] [--threads 1] [--save]

Both drape the same frames in turn, so that other work on the machine slows both. Quality on hard poses and, jitter, on
windows of the clips: energy, strain and third differences of what each makes, and how far they are apart.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import common
from benchmarks.quality_jitter import typical_windows
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.errors import ended
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.graph.packing import pack_body
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from service.engine import Engine
from service.packing import Packer, ScenePlan
from service.runtime import Device

FORMS = {"float32": False, "int8": True}
FRAMES_PER_CALL = 10
COLUMNS = {
    "garment": "s", "form": "s", "p50_ms": ".2f", "min_ms": ".2f", "batch_ms": ".2f", "energy_j": ".4f",
    "edge_pct": ".2f", "area_pct": ".2f", "jitter": ".3f", "apart_mm": ".3f", "apart_p99_mm": ".2f",
}  # fmt: skip


def draped(packer: Packer, key: str, poses: np.ndarray) -> np.ndarray:
    """Vertices [m] (F, V, 3) at ``poses`` (F, 24, 3) [rad]."""
    shape, found = pack_body(load_body()), []
    for start in range(0, len(poses), FRAMES_PER_CALL):
        part = poses[start : start + FRAMES_PER_CALL]
        results = packer.run(ScenePlan(), shape.rows(part), [(key, row) for row in range(len(part))])
        found += [result.arrays["vertices"].astype(np.float64) for result in results]
    return np.stack(found) + shape.root


def clocks(packers: dict[str, Packer], key: str, poses: np.ndarray, rounds: int) -> dict[str, dict[str, float]]:
    """Milliseconds of one frame and, per frame, of a call of many, of each packer; they take turns."""
    shape = pack_body(load_body())
    taken: dict[str, list[list[float]]] = {form: [[], []] for form in packers}
    for turn in range(rounds):
        one = shape.rows(poses[turn % len(poses)][None])
        many = shape.rows(np.resize(poses, (FRAMES_PER_CALL, 24, 3)))
        for form, packer in packers.items():
            for column, (rows, count) in enumerate(((one, 1), (many, FRAMES_PER_CALL))):
                started = time.perf_counter()
                packer.run(ScenePlan(), rows, [(key, row) for row in range(count)])
                taken[form][column].append(1e3 * (time.perf_counter() - started) / count)
    warm = max(1, rounds // 10)  # the first calls open sessions
    return {
        form: {
            "p50_ms": float(np.median(single[warm:])),
            "min_ms": float(min(single[warm:])),
            "batch_ms": float(np.median(batch[warm:])),
        }
        for form, (single, batch) in taken.items()
    }


def rows_of(
    garment: Garment, packers: dict[str, Packer], poses: np.ndarray, windows: list[np.ndarray], rounds: int
) -> list[dict[str, Any]]:
    """One row per form of the graph."""
    body, key = load_body(), garment.name
    for packer in packers.values():
        packer.add(key, garment)
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth, contact = ClothMesh.from_rest(rest, faces), BodyContact(body.faces, body.vertex_count)
    skin, weights = body.posed_vertices(poses), garment.skin_weights.astype(np.float64)
    moved = [skin_points(np.broadcast_to(rest, (len(w), *rest.shape)), weights, *body.bones(w)) for w in windows]
    rough = sum(metrics.third_difference_square(vertices) for vertices in moved)
    height = metrics.mean_height(
        skin_points(np.broadcast_to(rest, (len(poses), *rest.shape)), weights, *body.bones(poses)), cloth
    )
    times, made = clocks(packers, key, poses, rounds), {form: draped(p, key, poses) for form, p in packers.items()}
    rows = []
    for form, packer in packers.items():
        parts = metrics.static_parts(made[form], cloth, material(), contact, skin, height_m=height)
        own = sum(metrics.third_difference_square(draped(packer, key, window)) for window in windows)
        apart = 1e3 * np.linalg.norm(made[form] - made["float32"], axis=-1)
        rows.append(
            {
                "garment": key,
                "form": form,
                **times[form],
                "energy_j": float(sum(value.mean() for value in parts.values())),
                "edge_pct": float(metrics.edge_strain_pct(made[form], rest, faces).mean()),
                "area_pct": float(metrics.area_strain_pct(made[form], rest, faces).mean()),
                "jitter": float(np.sqrt(own / rough)),
                "apart_mm": float(apart.mean()),
                "apart_p99_mm": float(np.percentile(apart, 99.0)),
            }
        )
    for packer in packers.values():
        packer.remove(key)
    return rows


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and one line of JSON, and returns what that holds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.int8", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--model", type=Path, default=MODELS_DIR / "onefit")
    parser.add_argument("--garments", nargs="+", default=["tshirt", "dress"], help="names, files or folders")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders")
    parser.add_argument("--frames", type=int, default=8)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    body, clips = load_body(), [read_motion(path) for path in find_motions(options.motions)]
    engines = {
        form: Engine(options.model, device=Device(threads=options.threads), int8=int8) for form, int8 in FORMS.items()
    }
    packers = {form: Packer(engine, body) for form, engine in engines.items() if form == "float32" or engine.int8}
    frames, rounds = (2, 10) if options.quick else (options.frames, 120)
    poses = hard_poses(clips, body, frames)
    windows = [window.poses for window in typical_windows(clips)][: 1 if options.quick else None]
    rows = []
    for path in find_garments(options.garments[:1] if options.quick else options.garments):
        rows += rows_of(open_garment(path, body), packers, poses.poses, windows, rounds)
    common.print_table(rows, COLUMNS)
    return common.finish("int8", rows, options, frames=list(poses.labels), model=engines["float32"].manifest.digest)


if __name__ == "__main__":
    sys.exit(ended(main))
