"""Error of float32 against float64 per stage, the budget of every encoding, and what subnormals cost.

    python -m benchmarks.precision [--frames 24]

``stage`` rows drape the same poses in both precisions; ``encoding`` rows are the rounding of numbers that go over the
line, of a garment in a box of 2 m (a patch of 0.1 m); ``place`` rows what float32 world coordinates round at a
distance from the origin. ``p99_mm`` and ``max_mm`` are distances of points. ``ratio`` is the processor's time of a
product of subnormals over that of normal numbers, as it is and with ``drape.arrays.subnormals.flushed``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.shared import common
from drape.arrays.subnormals import flushed
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from drape.catalog import find_garments, open_garment
from drape.contact.skin import posed_table
from drape.errors import ended
from drape.garment.cache import Garment
from drape.geometry import jets, rigid, skinning
from drape.geometry.rotations import (
    matrix_to_quaternion,
    quaternion_to_matrix,
    rotvec_to_matrix,
    rotvec_to_quaternion,
)
from drape.graph.packing import pack_body
from drape.live.fold_constants import FoldConstants, worn_cloth
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, pack_jets, unpack_jets
from service.engine import Engine
from service.packing import Packer, ScenePlan

FRAMES, QUICK_FRAMES = 24, 4
GARMENT = "tshirt"
BOX_M, PATCH_M = 2.0, 0.1
PLACES_M = (1.0, 1e2, 1e4, 1e6)
COLUMNS = {"kind": "s", "name": "s", "p99_mm": ".5f", "max_mm": ".5f", "ratio": ".1f"}


def encoding_errors_mm(*, size_m: float, seed: int = 0, count: int = 500) -> dict[str, float]:
    """The largest error [mm] of each encoding for positions in a box of ``size_m``, where a patch of the JETS message
    has a twentieth of it. ``jets_turn`` is at a patch's rim; what coefficients lose is in ``benchmarks.speed.wire``,
    for it depends on the drape."""
    rng = np.random.default_rng(seed)
    positions = (size_m * rng.uniform(-0.5, 0.5, (count, 3))).astype(np.float32)
    exact, rim_m = positions.astype(np.float64), size_m * PATCH_M / BOX_M
    frame = wire.unpack_frame(wire.pack_frame(wire.Frame(0, 0.0, 0.0, np.zeros(3), positions)))
    rotation = rotvec_to_matrix(rng.normal(size=(count, 3)))
    jet = 0.3 * rng.normal(size=(count, jets.FULL_COUNT)).astype(np.float32)
    said = JetFrame(0, 0.0, 0.0, np.zeros(3), jet, rotation.astype(np.float32), positions)
    got = unpack_jets(pack_jets(said))

    def largest_mm(difference_m: np.ndarray) -> float:
        return 1e3 * float(np.linalg.norm(difference_m, axis=-1).max())

    with np.errstate(over="ignore"):
        half = positions.astype(np.float16).astype(np.float64)
    return {
        "frame": largest_mm(frame.positions - exact),
        "jets_centre": largest_mm(got.centre - exact),
        "jets_turn": 1e3 * rim_m * float(np.linalg.norm(got.rotation - rotation, axis=(1, 2)).max()),
        "float32": largest_mm(0.5 * np.spacing(np.abs(positions)).astype(np.float64)),
        "float16": largest_mm(half - exact),
    }


def stage_rows(body: BodyModel, garment: Garment, poses: np.ndarray) -> list[dict[str, Any]]:
    """Float32 against float64 (int8 against float32 of the network), stage by stage, for ``poses`` (F, 24, 3)."""
    single = poses.astype(np.float32)
    lever = np.array([0.5, 0.5, 0.5])  # metres: a limb's far end
    rows = [
        _row(
            "stage", "rotation vector to matrix, at 0.9 m", (rotvec_to_matrix(single) - rotvec_to_matrix(poses)) @ lever
        )
    ]
    turns = [quaternion_to_matrix(rotvec_to_quaternion(one)) for one in (single, poses)]
    rows.append(_row("stage", "by quaternion, at 0.9 m", (turns[0] - turns[1]) @ lever))
    back = [quaternion_to_matrix(matrix_to_quaternion(one)) for one in turns]
    rows.append(_row("stage", "matrix to quaternion and back, at 0.9 m", (back[0] - back[1]) @ lever))
    rows.append(_row("stage", "posed body", _skinned(body, poses, np.float32) - _skinned(body, poses, np.float64)))
    rng = np.random.default_rng(0)
    points, jet = rng.uniform(-1.0, 1.0, (2000, 2)), 0.3 * rng.normal(size=(2000, jets.JET_COUNT))
    surface = [PATCH_M * jets.evaluate(jet.astype(t), points.astype(t)) for t in (np.float32, np.float64)]
    rows.append(_row("stage", "jets, patches of 0.1 m", surface[0] - surface[1]))
    draped = [_networked(body, garment, poses, int8=int8) for int8 in (True, False)]
    rows.append(_row("stage", "network: int8 against float32", draped[0] - draped[1]))
    for fps in (30.0, 5.0):
        found = [_folded(body, garment, draped[1], poses, fps, t) for t in (np.float32, np.float64)]
        rows.append(_row("stage", f"folds, {fps:g} frames a second", found[0] - found[1]))
    return rows


def place_rows(vertices: np.ndarray) -> list[dict[str, Any]]:
    """What ``vertices`` (F, V, 3) [m] lose as float32 world coordinates, and as coordinates from the root."""
    exact = vertices.astype(np.float64)
    rows = []
    for place_m in PLACES_M:
        root = place_m * np.array([1.0, 0.1, -1.0]) + 0.123456789
        rows.append(_row("place", f"world, root at {place_m:g} m", (exact + root).astype(np.float32) - root - exact))
    rows.append(_row("place", "root, anywhere", vertices.astype(np.float32) - exact))
    return rows


def subnormal_rows(*, size: int = 1 << 16, runs: int = 30) -> list[dict[str, Any]]:
    """Time of products with subnormal results over that of normal ones, as it is and flushed."""
    normal, small = (np.full(size, value, np.float32) for value in (1e-3, 1e-25))
    factor = np.full(size, 1e-15, np.float32)

    def taken_s(values: np.ndarray) -> float:
        out, times = np.empty_like(values), []
        for _ in range(runs):
            start = time.thread_time()
            for _ in range(20):
                np.multiply(values, factor, out=out)
            times.append(time.thread_time() - start)
        return min(times)

    rows = [{"kind": "subnormal", "name": "as it is", "ratio": taken_s(small) / taken_s(normal)}]
    with flushed():
        rows.append({"kind": "subnormal", "name": "flushed", "ratio": taken_s(small) / taken_s(normal)})
    return rows


def _row(kind: str, name: str, difference_m: np.ndarray) -> dict[str, Any]:
    off = 1e3 * np.linalg.norm(np.asarray(difference_m, dtype=np.float64), axis=-1)
    return {"kind": kind, "name": name, "p99_mm": float(np.percentile(off, 99)), "max_mm": float(off.max())}


def _skinned(body: BodyModel, poses: np.ndarray, dtype: type[np.floating]) -> np.ndarray:
    joints = np.broadcast_to(body.joints_template, (len(poses), 24, 3)).astype(dtype)
    rotations, translations = rigid.bone_transforms(rotvec_to_matrix(poses.astype(dtype)), joints, PARENTS)
    rest = np.broadcast_to(body.v_template, (len(poses), body.vertex_count, 3)).astype(dtype)
    return skinning.skin_points(rest, body.weights.astype(dtype), rotations, translations)


def _networked(body: BodyModel, garment: Garment, poses: np.ndarray, *, int8: bool) -> np.ndarray:
    engine = Engine(MODELS_DIR / DEFAULT_MODEL, int8=int8)
    packer = Packer(engine, body)
    packer.add(garment.digest, garment)
    rows = pack_body(body).rows(poses)
    if engine.dynamic:
        rows["dynamic_code"] = np.zeros((len(poses), engine.code_size), np.float32)
    results = packer.run(ScenePlan(), rows, [(garment.digest, i) for i in range(len(poses))])
    return np.stack([result.arrays["vertices"] for result in results])


def _folded(
    body: BodyModel, garment: Garment, vertices: np.ndarray, poses: np.ndarray, fps: float, dtype: type[np.floating]
) -> np.ndarray:
    made, memory, found = FoldConstants.of(worn_cloth(garment, body), dtype=dtype), None, []
    skin = posed_table(body, poses, np.zeros(body.shape_count))
    for number, drape in enumerate(vertices):
        one = Frame(drape.astype(dtype), skin[number].reshape(-1, 8), number / fps)
        x, memory, _ = fold(made, memory, one, FoldEffort(steps=2))
        found.append(x)
    return np.stack(found).astype(np.float64)


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.precision", description="Rounding, stage by stage.")
    parser.add_argument("--frames", type=int, help=f"frames (default {FRAMES}, quick {QUICK_FRAMES})")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    body = load_body()
    garment = open_garment(find_garments([GARMENT])[0], body)
    time_s = np.arange(frames)[:, None, None] / 30.0
    spread = np.random.default_rng(0).uniform(-0.4, 0.4, (2, 24, 3))
    poses = spread[0] * np.sin(2.0 * time_s) + spread[1]
    rows = stage_rows(body, garment, poses)
    encoded = encoding_errors_mm(size_m=BOX_M)
    rows += [{"kind": "encoding", "name": name, "max_mm": error} for name, error in encoded.items()]
    rows += place_rows(garment.vertices[None, : garment.vertex_count]) + subnormal_rows()
    common.print_table(rows, COLUMNS)
    return common.finish("precision", rows, options, frames=frames, garment=GARMENT, model=DEFAULT_MODEL)


if __name__ == "__main__":
    sys.exit(ended(main))
