"""How good the drape is: skinning, network and physics side by side, on hard poses (docs/quality.md).

    python -m benchmarks.quality
    python -m benchmarks.quality --garments tshirt dress --motions walk squat --frames 6
    python -m benchmarks.quality --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save

A garment is a name under assets/garments, a cache file, a mesh, or a folder of either; a
motion is a name under assets/motions, a file, or a folder. Everything is measured at rest
(motion knob 0) on the garment's subdivided mesh.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch

from benchmarks import common, physics
from benchmarks.hard_poses import HardPoses, hard_poses
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR, load_manifest
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, push_out
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material, material
from drape.errors import ArtifactError, InputError, NotFound
from drape.feeds import body_feed, garment_feed
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.geometry.skinning import skin_points
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion

MOTIONS_DIR = GARMENTS_DIR.parent / "motions"
MESH_SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl")
MOTION_SUFFIXES = (".npz", ".bvh", ".amc")
METHODS = ("skinning", "skinning_push", "network", "network_push", "physics")
FRAMES, QUICK_FRAMES = 12, 2
QUICK_STEPS = 150
COLUMNS = {
    "garment": "s",
    "method": "s",
    "edge_pct": ".2f",
    "area_pct": ".2f",
    "colliding_vertex_pct": ".3f",
    "colliding_triangle_pct": ".3f",
    "energy_j": ".4f",
    "membrane_j": ".4f",
    "gain": ".3f",
}


@dataclass(frozen=True, eq=False)
class Bench:
    """What all garments share: the posed bodies, the contact surface and the drape network."""

    body: BodyModel
    poses: HardPoses
    contact: BodyContact
    body_vertices: np.ndarray
    body_normals: np.ndarray
    network: Network
    material: Material
    step_limit: int


class Network:
    """A model folder as a function garment -> vertices, by ONNX Runtime on the CPU."""

    def __init__(self, folder: Path, body: BodyModel, *, threads: int) -> None:
        self.manifest = load_manifest(folder)
        check_body(f"model {folder.name}", self.manifest.body_digest, body)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self._sessions = {
            key: onnxruntime.InferenceSession(str(folder / spec.file), options, providers=["CPUExecutionProvider"])
            for key, spec in self.manifest.graphs.items()
        }

    def vertices(self, garment: Garment, body: BodyModel, poses: np.ndarray) -> np.ndarray:
        """World vertices [m] (F, V, 3) of the garment's subdivided mesh."""
        feed = body_feed(body, poses, np.zeros((len(poses), 3)))
        features = np.ascontiguousarray(garment.patch_features, dtype=np.float32)
        embedding = self._run("garment_encoder", {"patch_features": features}, "patch_embedding")
        arrays = {**feed.arrays, **garment_feed(garment, fine=True), "patch_embedding": embedding}
        return self._run("drape", arrays, "vertices").astype(np.float64) + feed.root[:, None]

    def _run(self, graph: str, arrays: dict[str, np.ndarray], output: str) -> np.ndarray:
        feed = {spec.name: arrays[spec.name] for spec in self.manifest.graphs[graph].inputs}
        return np.asarray(self._sessions[graph].run([output], feed)[0])


def check_body(what: str, digest: str, body: BodyModel) -> None:
    """Refuses ``what`` if it was made for another body."""
    if digest != body.digest:
        raise ArtifactError(
            f"{what} body",
            expected=f"digest {body.digest[:12]} of {body.name}",
            got=digest[:12],
            cure="Make it again with this body.",
        )


def measure(garment: Garment, bench: Bench) -> list[dict[str, Any]]:
    """One row per method."""
    check_body(f"garment {garment.name}", garment.body_digest, bench.body)
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth = ClothMesh.from_rest(rest, faces)
    poses = bench.poses.poses
    rotations, translations = bench.body.bones(poses)
    skinned = skin_points(
        np.broadcast_to(rest, (len(poses), *rest.shape)),
        garment.skin_weights.astype(np.float64),
        rotations,
        translations,
    )
    draped = bench.network.vertices(garment, bench.body, poses)
    pushed = push_out(skinned, bench.body_vertices, bench.body_normals)
    optimum = physics.minimise(
        cloth, bench.material, pushed, bench.contact, bench.body_vertices, step_limit=bench.step_limit
    )
    positions = {
        "skinning": skinned,
        "skinning_push": pushed,
        "network": draped,
        "network_push": push_out(draped, bench.body_vertices, bench.body_normals),
        "physics": optimum.vertices,
    }
    height = physics.mean_height(skinned, cloth)
    rows = {}
    for method in METHODS:
        vertices = positions[method]
        parts = physics.static_parts(
            vertices, cloth, bench.material, bench.contact, bench.body_vertices, height_m=height
        )
        rows[method] = {
            "garment": garment.name,
            "method": method,
            "edge_pct": float(metrics.edge_strain_pct(vertices, rest, faces).mean()),
            "area_pct": float(metrics.area_strain_pct(vertices, rest, faces).mean()),
            "colliding_vertex_pct": float(
                metrics.colliding_vertex_pct(vertices, bench.body_vertices, bench.body_normals).mean()
            ),
            "colliding_triangle_pct": float(
                metrics.colliding_triangle_pct(vertices, bench.body_vertices, bench.body.faces).mean()
            ),
            "energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean()),
            **{f"{part}_j": float(value.mean()) for part, value in parts.items()},
        }
    skin, best = rows["skinning_push"]["energy_j"], rows["physics"]["energy_j"]
    for row in rows.values():
        row["gain"] = metrics.gain(skin, row["energy_j"], best)
    rows["physics"] |= {
        "residual_n": float(optimum.residual_n.mean()),
        "weight_n": float(bench.material.gravity_m_s2 * cloth.vertex_mass(bench.material).sum()),
        "change": float(optimum.change.max()),
        "steps": float(optimum.steps.mean()),
        "seconds": optimum.seconds,
    }
    return [rows[method] for method in METHODS]


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the garments, one row per method; the gain is that of the mean energies."""
    means = {}
    for method in METHODS:
        own = [row for row in rows if row["method"] == method]
        numbers = [key for key in own[0] if isinstance(own[0][key], float) and key != "gain"]
        means[method] = {"garment": "all", "method": method} | {
            key: float(np.mean([row[key] for row in own])) for key in numbers
        }
    skin, best = means["skinning_push"]["energy_j"], means["physics"]["energy_j"]
    for row in means.values():
        row["gain"] = metrics.gain(skin, row["energy_j"], best)
    return list(means.values())


def find_files(names: Sequence[str], folder: Path, suffixes: tuple[str, ...], kind: str) -> list[Path]:
    """Files of ``names``, each a file, a folder, or the beginning of a file's name in ``folder``."""
    found: list[Path] = []
    for name in names or [str(folder)]:
        path = Path(name)
        if path.is_dir():
            matches = sorted(p for p in path.iterdir() if p.suffix.lower() in suffixes and not _is_avatar(p))
        elif path.is_file():
            matches = [path]
        else:
            matches = [p for p in sorted(folder.iterdir()) if p.suffix in suffixes and _short_name(p) == name]
        if not matches:
            known = sorted({_short_name(p) for p in folder.iterdir() if p.suffix in suffixes})
            raise NotFound(kind, expected=f"one of {known}, a file or a folder", got=name, cure="Check the name.")
        found += matches
    return found


def _short_name(path: Path) -> str:
    """A cache file NAME-DIGEST16.npz answers to NAME."""
    stem, _, digest = path.stem.rpartition("-")
    return stem if stem and len(digest) == 16 else path.stem


def _is_avatar(path: Path) -> bool:
    return path.stem.startswith("avatar")


def open_garments(names: Sequence[str], body: BodyModel) -> list[Callable[[], Garment]]:
    """One function per garment that loads or takes it in, so that only one is in memory."""

    def opener(path: Path) -> Callable[[], Garment]:
        if path.suffix == ".npz":
            return lambda: load_garment(path)
        from drape.garment.intake import intake

        return lambda: intake(path, body=body)

    return [opener(path) for path in find_files(names, GARMENTS_DIR, (".npz", *MESH_SUFFIXES), "garment")]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality", description="Quality of skinning, network and physics, side by side."
    )
    parser.add_argument("--garments", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--model", default=DEFAULT_MODEL, help=f"name under assets/models (default {DEFAULT_MODEL})")
    parser.add_argument("--material", default="jersey", help="cloth (drape.cloth.material)")
    parser.add_argument("--steps", type=int, help="most steps of the physics minimiser (default 2000, quick 150)")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments = options.garments or ["tshirt"]
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    options.steps = options.steps or (QUICK_STEPS if options.quick else 2000)
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body = load_body()
    clips: list[MotionClip] = [
        read_motion(path) for path in find_files(options.motions, MOTIONS_DIR, MOTION_SUFFIXES, "motion")
    ]
    poses = hard_poses(clips, body, options.frames)
    contact = BodyContact(body.faces, body.vertex_count)
    body_vertices = body.posed_vertices(poses.poses)
    network = Network(MODELS_DIR / options.model, body, threads=options.threads)
    bench = Bench(
        body=body,
        poses=poses,
        contact=contact,
        body_vertices=body_vertices,
        body_normals=np.asarray(contact.normals(body_vertices)),
        network=network,
        material=material(options.material),
        step_limit=options.steps,
    )
    rows: list[dict[str, Any]] = []
    refused: dict[str, str] = {}
    for open_garment in open_garments(options.garments, body):
        try:
            garment = open_garment()
        except InputError as error:
            # One bad file of a folder must not cost the table; it is named below and in the record.
            refused[error.name] = str(error)
            continue
        rows += measure(garment, bench)
        print(f"{garment.name}: physics {rows[-1]['steps']:.0f} steps, {rows[-1]['seconds']:.0f} s", flush=True)
    if not rows:
        raise InputError("garments", expected="at least one usable", got=str(refused), cure="Check the files.")
    print()
    common.print_table([*rows, *summary(rows)], COLUMNS)
    for row in (row for row in rows if row["method"] == "physics"):
        print(
            f"physics {row['garment']}: residual {row['residual_n']:.3f} N of {row['weight_n']:.2f} N weight, "
            f"energy changed by {row['change']:.1e} of its gain in the last {physics.CHECK_STEPS} steps"
        )
    for message in refused.values():
        print(f"refused: {message}")
    return common.finish(
        "quality",
        rows,
        options,
        summary=summary(rows),
        frames=list(poses.labels),
        model=options.model,
        model_digest=network.manifest.digest,
        refused=refused,
    )


if __name__ == "__main__":
    main()
