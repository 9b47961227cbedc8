"""Ways to bring cloth out of the body, side by side on the network's drapes (docs/decisions/0009-push-out.md).

    python -m benchmarks.push_out
    python -m benchmarks.push_out --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --frames 4 --save

Quality on the garments' subdivided meshes in hard poses, jitter on one window of the first motion that has one;
times are one frame of each garment as delivered, by ONNX Runtime but for the k-d tree: wall-clock median, and the
processor's time, which other work on the machine moves little.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from torch import nn

from benchmarks import common, push_rivals
from benchmarks.kd_tree_push import Collider
from benchmarks.latency_setup import timed
from benchmarks.network import Network
from benchmarks.quality_jitter import Window, typical_windows
from drape.artifacts import DEFAULT_MODEL, model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, is_shipped, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact
from drape.cloth.contact import push_out as nearest_vertex_push_out
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.cloth.push.out import CLEARANCE_M, push_out_of_bodies
from drape.cloth.push.skin import body_skin
from drape.commands import ended
from drape.feeds import garment_feed
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from drape.push_packing import feed_arrays, pack_push, push_feed
from drape.subnormals import flushed
from model_export.export import write_push_out
from service.subgraph import cut

NEAREST_CLEARANCE_M = 0.002  # of the baseline (docs/quality.md)
METHODS = ("none", "nearest_vertex", "rest_candidates", "capsules", "distance_grids", "own_and_other")
FRAMES, QUICK_FRAMES = 4, 1
SECONDS, QUICK_SECONDS = 4.0, 0.5
QUICK_CELLS = 12
COLUMNS = {
    "garment": "s",
    "set": "s",
    "method": "s",
    "colliding_triangle_pct": ".3f",
    "edge_pct": ".2f",
    "edge_added_pp": ".2f",
    "area_added_pp": ".2f",
    "energy_j": ".3f",
    "membrane_j": ".3f",
    "jitter_ratio": ".2f",
    "p50_ms": ".2f",
    "processor_ms": ".2f",
}

Push = Callable[[np.ndarray, np.ndarray], np.ndarray]  # vertices (F, V, 3) and poses (F, 24, 3) to vertices


@dataclass(frozen=True, eq=False)
class Setting:
    """The bodies and drapes that all garments share."""

    body: BodyModel
    contact: BodyContact
    network: Network
    poses: np.ndarray
    window: Window | None
    cells: int = push_rivals.CELLS


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.push_out", description="Push-outs, side by side.")
    parser.add_argument("--garments", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"name under assets/models, or a folder (default {DEFAULT_MODEL})"
    )
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments = options.garments or ["tank"]
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    return options


def pushes(garment: Garment, body: BodyModel, contact: BodyContact, cells: int) -> dict[str, Push]:
    """The methods as functions on all vertices of ``garment``."""
    skin, rest = body_skin(body), garment.vertices.astype(np.float64)
    feed = push_feed(garment, body)

    def nearest(vertices: np.ndarray, poses: np.ndarray) -> np.ndarray:
        posed = body.posed_vertices(poses)
        return nearest_vertex_push_out(vertices, posed, np.asarray(contact.normals(posed)), NEAREST_CLEARANCE_M)

    def by_torch(module: nn.Module) -> Push:
        def run(vertices: np.ndarray, poses: np.ndarray) -> np.ndarray:
            rotations, translations = (torch.from_numpy(x.astype(np.float32)) for x in body.bones(poses))
            frames = torch.from_numpy(vertices.astype(np.float32))
            with torch.no_grad():
                parts = zip(frames.split(1), rotations.split(1), translations.split(1), strict=True)
                return torch.cat([module(*part) for part in parts]).double().numpy()

        return run

    return {
        "none": lambda vertices, poses: vertices,
        "nearest_vertex": nearest,
        **{name: by_torch(module) for name, module in rivals(body, rest, cells).items()},
        "own_and_other": lambda vertices, poses: push_out_of_bodies(vertices, body.posed_vertices(poses), skin, feed),
    }


def rivals(body: BodyModel, rest: np.ndarray, cells: int) -> dict[str, nn.Module]:
    """The torch modules for a garment whose vertices are ``rest`` (V, 3); grids of ``cells`` a side."""
    return {
        "rest_candidates": rest_candidates(body, rest),
        "capsules": push_rivals.Capsules(body, CLEARANCE_M),
        "distance_grids": _grids(body, cells),
    }


def rest_candidates(body: BodyModel, rest: np.ndarray, clearance_m: float = CLEARANCE_M) -> nn.Module:
    """``push_rivals.RestCandidates`` on the samples of ``body`` for vertices ``rest`` (V, 3)."""
    skin = body_skin(body)
    moments = [skin.operator @ (body.weights * body.v_template[:, i : i + 1]) for i in range(3)]
    rows = np.stack([*moments, skin.operator @ body.weights], axis=-1).reshape(3 * skin.count, -1)
    return push_rivals.RestCandidates(skin, rows, rest, clearance_m)


@lru_cache(maxsize=1)
def _grids(body: BodyModel, cells: int) -> nn.Module:
    return push_rivals.DistanceGrids(body, CLEARANCE_M, cells=cells)


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
    for method, push in pushes(garment, body, setting.contact, setting.cells).items():
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


@flushed()
def times(
    garment: Garment, body: BodyModel, folder: Path, *, threads: int, seconds: float, cells: int
) -> dict[str, dict[str, Any]]:
    """Milliseconds per method of one frame of the delivered vertices."""
    count = garment.vertex_count
    poses, rest = np.zeros((1, 24, 3)), garment.vertices[:count].astype(np.float64)
    rotations, translations = (x.astype(np.float32) for x in body.bones(poses))
    arrays = {"vertices": rest[None].astype(np.float32), "bone_rotation": rotations, "bone_translation": translations}
    collider, betas = Collider(body), np.zeros(body.shape_count)
    root = body.rest_joints()[0].astype(np.float32)
    calls: dict[str, Callable[[], object]] = {
        "nearest_vertex": lambda: collider.push(arrays["vertices"] - root, poses, betas, NEAREST_CLEARANCE_M)
    }
    for name, module in rivals(body, rest, cells).items():
        path = folder / f"{name}.onnx"
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")  # the exporter's own deprecation notices
            tensors = tuple(torch.from_numpy(array) for array in arrays.values())
            program = torch.onnx.export(module, tensors, input_names=list(arrays), dynamo=True, verbose=False)
        assert program is not None
        program.save(str(path))
        calls[name] = _call(path, arrays, threads)
    path = folder / "push_out.onnx"
    write_push_out(path)
    path.write_bytes(cut(path.read_bytes(), ["pushed"]))  # as the service runs it for vertices
    bones = body_skin(body).on_bones(body)
    constants = feed_arrays(pack_push(garment_feed(garment), rest, body_skin(body)))
    own = arrays | constants | {"skin_rows": bones.rows, "skin_bones": bones.bones}
    calls["own_and_other"] = _call(path, own | {"clearance": np.full(1, CLEARANCE_M, dtype=np.float32)}, threads)
    return {name: _timed(call, seconds) for name, call in calls.items()}


def _call(path: Path, arrays: dict[str, np.ndarray], threads: int) -> Callable[[], object]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    feed = {tensor.name: np.ascontiguousarray(arrays[tensor.name]) for tensor in session.get_inputs()}
    return lambda: session.run(None, feed)


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
    torch.set_num_threads(options.threads)
    body = load_body()
    clips = [read_motion(path) for path in find_motions(options.motions)]
    poses = hard_poses(clips, body, options.frames)
    windows = [] if options.quick else typical_windows(clips)
    network = Network(model_folder(options.model), body, threads=options.threads)
    setting = Setting(
        body=body,
        contact=BodyContact(body.faces, body.vertex_count),
        network=network,
        poses=poses.poses,
        window=windows[0] if windows else None,
        cells=QUICK_CELLS if options.quick else push_rivals.CELLS,
    )
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="push-out-") as folder:
        for path in find_garments(options.garments):
            garment = open_garment(path, body)
            measured = measure(garment, setting, trained=is_shipped(path))
            seconds = QUICK_SECONDS if options.quick else SECONDS
            taken = times(garment, body, Path(folder), threads=options.threads, seconds=seconds, cells=setting.cells)
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
        window=windows[0].label if windows else None,
        model=options.model,
        model_digest=network.manifest.digest,
    )


if __name__ == "__main__":
    sys.exit(ended(main))
