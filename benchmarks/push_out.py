"""The push-out beside none and beside the nearest vertex, on the network's drapes (docs/decisions/0009-push-out.md).

    python -m benchmarks.push_out
    python -m benchmarks.push_out --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save

Quality on the garments' subdivided meshes in hard poses, jitter on one window of the first motion that has one;
times are one frame of each garment as delivered, of the service's push-out and of the k-d tree: wall-clock median,
and the processor's time, which other work on the machine moves little.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.measure.jitter import Window, typical_windows
from benchmarks.shared import common
from benchmarks.shared.kd_tree_push import Collider
from benchmarks.shared.network import Network, add_precision
from benchmarks.speed.setup import timed
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment, was_trained_on
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin, posed_table
from drape.errors import ended
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import push_feed
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from service.graphs.push import Pusher

NEAREST_CLEARANCE_M = 0.002  # of the baseline (docs/reference/quality.md)
METHODS = ("none", "nearest_vertex", "own_and_other")
FRAMES, QUICK_FRAMES = 4, 1
SECONDS, QUICK_SECONDS = 4.0, 0.5
COLUMNS = {
    "garment": "s", "set": "s", "method": "s", "colliding_triangle_pct": ".3f", "edge_pct": ".2f",
    "edge_added_pp": ".2f", "area_added_pp": ".2f", "energy_j": ".3f", "membrane_j": ".3f", "jitter_ratio": ".2f",
    "p50_ms": ".2f", "processor_ms": ".2f",
}  # fmt: skip

Push = Callable[[np.ndarray, np.ndarray], np.ndarray]  # vertices (F, V, 3) and poses (F, 24, 3) to vertices


@dataclass(frozen=True, eq=False)
class Setting:
    """The bodies and drapes that all garments share."""

    body: BodyModel
    contact: BodyContact
    network: Network
    poses: np.ndarray
    window: Window | None


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.push_out", description="Push-outs, side by side.")
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments = options.garments or ["tank"]
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    return options


def pushes(garment: Garment, body: BodyModel, contact: BodyContact) -> dict[str, Push]:
    """The methods as functions on all vertices of ``garment``."""
    skin, feed = body_skin(body), push_feed(garment, body)

    def nearest(vertices: np.ndarray, poses: np.ndarray) -> np.ndarray:
        posed = body.posed_vertices(poses)
        return nearest_vertex_push(vertices, posed, np.asarray(contact.normals(posed)), NEAREST_CLEARANCE_M)

    return {
        "none": lambda vertices, poses: vertices,
        "nearest_vertex": nearest,
        "own_and_other": lambda vertices, poses: push_out_of_bodies(vertices, body.posed_vertices(poses), skin, feed),
    }


def measure(garment: Garment, setting: Setting, *, trained: bool) -> list[dict[str, Any]]:
    """One row per method, less its times."""
    body, poses = setting.body, setting.poses
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth, cloth_material = ClothMesh.from_rest(rest, faces), material()
    drapes, posed = setting.network.drape(garment, poses).vertices, body.posed_vertices(poses)
    weights = garment.skin_weights.astype(np.float64)
    skinned = skin_points(np.broadcast_to(rest, drapes.shape), weights, *body.bones(poses))
    height = metrics.mean_height(skinned, cloth)
    moving = setting.network.drape(garment, setting.window.poses).vertices if setting.window else None
    rows: list[dict[str, Any]] = []
    for method, push in pushes(garment, body, setting.contact).items():
        vertices = push(drapes, poses)
        parts = metrics.static_parts(vertices, cloth, cloth_material, setting.contact, posed, height_m=height)
        row = {
            "garment": garment.name,
            "set": "trained" if trained else "unseen",
            "method": method,
            "colliding_triangle_pct": float(metrics.colliding_triangle_pct(vertices, posed, body.faces).mean()),
            "edge_pct": float(metrics.edge_strain_pct(vertices, rest, faces).mean()),
            "area_pct": float(metrics.area_strain_pct(vertices, rest, faces).mean()),
            "energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean()),
            "membrane_j": float(parts["membrane"].mean()),
        }
        row["edge_added_pp"] = row["edge_pct"] - (rows[0] if rows else row)["edge_pct"]
        row["area_added_pp"] = row["area_pct"] - (rows[0] if rows else row)["area_pct"]
        if moving is not None and setting.window is not None:
            base = metrics.third_difference_square(moving)
            square = metrics.third_difference_square(push(moving, setting.window.poses))
            row["jitter_ratio"] = float(np.sqrt(square / base))
        rows.append(row)
    return rows


def times(garment: Garment, network: Network, body: BodyModel, *, seconds: float) -> dict[str, dict[str, Any]]:
    """Milliseconds per method of one frame of the delivered vertices; the posed skin is given, as by the network."""
    poses, betas = np.zeros((1, 24, 3)), np.zeros(body.shape_count)
    rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    vertices = (rest - body.rest_joints()[0])[None].astype(np.float32)
    collider, pusher = Collider(body), Pusher(network.engine, body)
    pusher.add(garment.name, garment_feed(garment), rest, garment.faces)
    skin = posed_table(body, poses, betas)
    calls: dict[str, Callable[[], object]] = {
        "nearest_vertex": lambda: collider.push(vertices, poses, betas, NEAREST_CLEARANCE_M),
        "own_and_other": lambda: pusher.push([garment.name], vertices, skin),
    }
    return {name: _timed(call, seconds) for name, call in calls.items()}


def _timed(call: Callable[[], object], seconds: float) -> dict[str, Any]:
    found = timed(call, seconds=seconds)
    spent = []
    for _ in range(found.calls):
        start = time.process_time()
        call()
        spent.append(1e3 * (time.process_time() - start))
    return {"p50_ms": found.p50_ms, "min_ms": found.min_ms, "processor_ms": float(np.median(spent))}


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the garments of each set, one row per method."""
    found = []
    for kind in dict.fromkeys(row["set"] for row in rows):
        for method in METHODS:
            own = [row for row in rows if row["set"] == kind and row["method"] == method]
            keys = [key for key, value in own[0].items() if isinstance(value, float)]
            means = {key: float(np.mean([row[key] for row in own])) for key in keys}
            found.append({"garment": f"mean of {len(own)}", "set": kind, "method": method, **means})
    return found


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    body = load_body()
    clips = [read_motion(path) for path in find_motions(options.motions)]
    poses = hard_poses(clips, body, options.frames)
    windows = [] if options.quick else typical_windows(clips)
    network = Network(model_folder(options.model), body, threads=options.threads, precision=options.precision)
    window = windows[0] if windows else None
    setting = Setting(body, BodyContact(body.faces, body.vertex_count), network, poses.poses, window)
    known = network.manifest.training.get("garments", ())
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        garment = open_garment(path, body)
        measured = measure(garment, setting, trained=was_trained_on(garment, known))
        taken = times(garment, network, body, seconds=QUICK_SECONDS if options.quick else SECONDS)
        rows += [row | {"vertices": garment.vertex_count} | taken.get(row["method"], {}) for row in measured]
        print(f"{garment.name}: measured", flush=True)
    print()
    common.print_table([*rows, *summary(rows)], COLUMNS)
    return common.finish(
        "push_out",
        rows,
        options,
        summary=summary(rows),
        frames=list(poses.labels),
        window=window.label if window else None,
        model=options.model,
        **network.record(),
    )


if __name__ == "__main__":
    sys.exit(ended(main))
