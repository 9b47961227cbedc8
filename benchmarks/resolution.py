"""One garment at many resolutions and in two triangulations: what the drape owes to the mesh (OneFit, figure 4).

    python -m benchmarks.resolution [--garment tshirt] [--save]

The rest garment is decimated and subdivided, and its diagonals are flipped; each mesh is fitted and draped by the same
model. The error is the distance of its vertices from the surface that the mesh of ``REFERENCE`` gives at the same
pose; "rest" is that distance before draping, which decimation alone costs. Times are those of the packed graph.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import igl
import numpy as np

from benchmarks import common
from benchmarks.latency_setup import timed
from benchmarks.network import Network
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.errors import ended
from drape.garment.cache import Garment
from drape.garment.fitting import fit_garment
from drape.geometry import meshes
from drape.geometry.closest import closest_point
from drape.graph.packing import pack_body
from drape.motion.hard_poses import HardPoses, hard_poses
from drape.motion.readers import read_motion
from service.engine import Engine
from service.packing import Packer, ScenePlan
from service.runtime import Device

REFERENCE = 20_000
SIZES = (1_000, 5_000, 20_000, 80_000)
COLUMNS = {"mesh": "s", "vertices": "d", "patches": "d", "rest_mm": ".2f", "mean_mm": ".2f", "p95_mm": ".2f",
           "edge_pct": ".2f", "p50_ms": ".2f"}  # fmt: skip


def at_size(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with about ``count`` vertices: subdivided until it has enough, then decimated where it has far more."""
    while len(vertices) < 0.8 * count:
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    if len(vertices) <= 1.25 * count:
        return vertices, faces
    target = round(len(faces) * count / len(vertices))
    made, made_faces, *_ = igl.qslim(np.asfortranarray(vertices), np.asfortranarray(faces.astype(np.int32)), target)
    return np.ascontiguousarray(made), np.ascontiguousarray(made_faces)


def flipped(vertices: np.ndarray, faces: np.ndarray, *, share: float = 0.5, seed: int = 0) -> np.ndarray:
    """``faces`` with up to ``share`` of the inner edges replaced by the other diagonal of their two triangles.

    A triangle takes part once; diagonals that would fold the pair or stretch a corner beyond 150 degrees are left.
    """
    faces = faces.copy()
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for row, face in enumerate(faces):
        for k in range(3):
            a, b = int(face[k]), int(face[(k + 1) % 3])
            edges.setdefault((min(a, b), max(a, b)), []).append((row, k))
    inner = [pair for pair in edges.values() if len(pair) == 2]
    taken = np.zeros(len(faces), dtype=bool)
    order = np.random.default_rng(seed).permutation(len(inner))
    left = round(share * len(inner))
    for (row, k), (other, j) in (inner[i] for i in order):
        if left == 0 or taken[row] or taken[other]:
            continue
        a, b, c = (int(faces[row][(k + n) % 3]) for n in range(3))
        d = int(faces[other][(j + 2) % 3])
        if (min(c, d), max(c, d)) in edges or _widest([(a, d, c), (d, b, c)], vertices) > np.deg2rad(150.0):
            continue
        faces[row], faces[other] = (a, d, c), (d, b, c)
        taken[row] = taken[other] = True
        left -= 1
    return faces


def _widest(triangles: list[tuple[int, int, int]], vertices: np.ndarray) -> float:
    """The widest corner [rad] of ``triangles``; pi where their normals point apart."""
    normals, widest = [], 0.0
    for triangle in triangles:
        corners = vertices[list(triangle)]
        normals.append(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        for k in range(3):
            u, v = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
            widest = max(widest, float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)))
    return widest if normals[0] @ normals[1] > 0.0 else float(np.pi)


def fitted(vertices: np.ndarray, faces: np.ndarray, name: str, body: BodyModel) -> Garment:
    """The garment of a rest mesh, as the shipped ones are made."""
    return fit_garment(
        name=name, vertices=vertices, vertex_count=len(vertices), faces=faces, fine_faces=faces,
        uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3)), material_names=("cloth",), face_material=np.zeros(len(faces)),
        body=body, digest=hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest(), manifest={},
    )  # fmt: skip


def rows_of(
    made: dict[str, tuple[np.ndarray, np.ndarray]],
    network: Network,
    packer: Packer,
    poses: np.ndarray,
    *,
    reference: str,
    seconds: float,
) -> list[dict[str, Any]]:
    """One row per rest mesh of ``made``, against the mesh named ``reference``."""
    body = network.body
    garments = {name: fitted(*mesh, name, body) for name, mesh in made.items()}
    draped = {name: network.drape(garment, poses).vertices for name, garment in garments.items()}
    rest, faces = made[reference]
    shape, rows = pack_body(body), []
    for name, garment in garments.items():
        vertices, own_faces = made[name]
        away = np.concatenate([_distance(draped[name][f], draped[reference][f], faces) for f in range(len(poses))])
        packer.add(name, garment)
        turn = iter(np.resize(np.arange(len(poses)), 1 << 20))

        def call(name: str = name, turn: Any = turn) -> None:
            frame = next(turn)
            packer.run(ScenePlan(), shape.rows(poses[frame : frame + 1]), [(name, 0)])

        rows.append(
            {
                "mesh": name,
                "vertices": len(vertices),
                "patches": garment.patch_count,
                "rest_mm": 1e3 * float(_distance(vertices, rest, faces).mean()),
                "mean_mm": 1e3 * float(away.mean()),
                "p95_mm": 1e3 * float(np.percentile(away, 95.0)),
                "edge_pct": float(metrics.edge_strain_pct(draped[name], vertices, own_faces).mean()),
                **timed(call, seconds=seconds).row(),
            }
        )
        packer.remove(name)
    return rows


def _distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return closest_point(points, vertices, faces).distance


def held_out(motions: Sequence[str], body: BodyModel, count: int) -> HardPoses:
    """Hard poses of ``motions``, of the shipped clips by default."""
    return hard_poses([read_motion(path) for path in find_motions(motions)], body, count)


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and one line of JSON, and returns what that holds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.resolution", description=__doc__)
    parser.add_argument("--model", type=Path, default=MODELS_DIR / "onefit")
    parser.add_argument("--garment", default="tshirt", help="a name, file or cache")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders")
    parser.add_argument("--frames", type=int, default=8)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    body = load_body()
    sizes, frames, seconds = ((1_000, 2_000), 2, 0.2) if options.quick else (SIZES, options.frames, 2.0)
    base = open_garment(find_garments([options.garment])[0], body)
    vertices, faces = base.vertices.astype(np.float64), base.fine_faces.astype(np.int64)
    made = {f"{size:,}": at_size(vertices, faces, size) for size in sizes}
    same = f"{sizes[1]:,}"
    made[f"{same}, diagonals flipped"] = made[same][0], flipped(*made[same])
    reference = f"{REFERENCE if REFERENCE in sizes else sizes[-1]:,}"
    engine = Engine(options.model, device=Device(threads=options.threads))
    network = Network(options.model, body, threads=options.threads)
    poses = held_out(options.motions, body, frames)
    rows = rows_of(made, network, Packer(engine, body), poses.poses, reference=reference, seconds=seconds)
    common.print_table(rows, COLUMNS)
    return common.finish(
        "resolution", rows, options, garment=base.name, reference=reference, frames=list(poses.labels),
        model=network.manifest.digest,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(ended(main))
