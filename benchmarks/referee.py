"""How near to rest the physics optimum is, how low, and in what time, pose by pose (docs/reference/quality.md).

    python -m benchmarks.referee
    python -m benchmarks.referee --garments tshirt --frames 2 --fabrics jersey satin
    python -m benchmarks.referee --before benchmarks/results/referee_before.json --save

Every garment in the one cloth of before fabrics, then those of ``--fabric-garments`` in each of ``--fabrics``, flat at
rest where they keep no crease; poses and starts are those of ``benchmarks.quality``. ``--before`` names a record of
another method in the one cloth: rows of ``garment``, ``pose``, ``energy_j`` over the planes of the nearest body
vertices, with which ``nearest_j`` is compared, and ``processor_s``. ``--sheet``
draws the first pose, a garment per row and a cloth per column, of the garments that are made of ``--fabrics``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR, stored_minimum
from benchmarks.shared import common
from benchmarks.shared.network import Network
from benchmarks.shared.render import PLAIN_CLOTH, RAKING_LIGHT, SKIN, Surface, render, save_png, sheet
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material, material
from drape.errors import InputError, ended
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.motion.hard_poses import HardPoses, hard_poses
from drape.motion.readers import read_motion

FRAMES, QUICK_FRAMES = 8, 1
SIZE, EXTENT = (460, 380), 1.2
FABRIC_GARMENTS = ("tshirt", "trousers", "dress")
COLUMNS = {
    "garment": "s", "fabric": "s", "poses": "d", "start_j": ".3f", "energy_j": ".4f", "old_energy_j": ".4f",
    "not_above_old": "d", "at_rest": "d", "force_left_share": ".4f", "steps": ".0f", "processor_s": ".2f",
    "old_processor_s": ".2f", "planes_apart_pct": ".2f",
}  # fmt: skip


class Scene(NamedTuple):
    """What all garments share."""

    body: BodyModel
    poses: HardPoses
    contact: BodyContact
    body_vertices: np.ndarray
    network: Network
    step_limit: int
    folder: Path | None


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.referee", description="The physics optimum: rest, energy and time, pose by pose."
    )
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--fabrics", nargs="+", default=[], metavar="NAME", help="of drape.cloth.fabric_table")
    parser.add_argument(
        "--fabric-garments", nargs="+", default=FABRIC_GARMENTS, metavar="NAME", help="what is made of --fabrics"
    )
    parser.add_argument("--steps", type=int, default=physics.STEPS, help=f"most steps (default {physics.STEPS})")
    parser.add_argument("--before", type=Path, help="a record of another method, to compare with")
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="draw the first pose in each of --fabrics there")
    parser.add_argument("--no-physics-cache", action="store_true", help="minimise again, store nothing")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    if options.quick:
        options.garments = options.garments or ["tank"]
    return options


def open_scene(options: argparse.Namespace) -> Scene:
    """Poses, posed bodies and network as ``options`` ask."""
    body = load_body()
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    network = Network(model_folder(options.model), body, threads=options.threads)
    folder = None if options.no_physics_cache else CACHE_DIR
    contact = BodyContact(body.faces, body.vertex_count)
    return Scene(body, poses, contact, body.posed_vertices(poses.poses), network, options.steps, folder)


def measure(garment: Garment, made_of: Fabric | None, scene: Scene) -> tuple[list[dict[str, Any]], np.ndarray]:
    """A row per pose of ``garment`` in ``made_of``, in the one cloth of before fabrics where that is None; and the
    optima (F, V, 3) [m]."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    if made_of is None:
        cloth, of, network = ClothMesh.from_rest(rest, faces), material(), scene.network
    else:
        cloth, of = ClothMesh.of(garment.rest_state(), faces, len(rest)), Material.of(made_of)
        network = scene.network.made_of(made_of)
    poses = scene.poses.poses
    rotations, translations = scene.body.bones(poses)
    skinned = skin_points(
        np.broadcast_to(rest, (len(poses), *rest.shape)),
        garment.skin_weights.astype(np.float64),
        rotations,
        translations,
    )
    normals = np.asarray(scene.contact.normals(scene.body_vertices))
    pushed = nearest_vertex_push(skinned, scene.body_vertices, normals)
    task = physics.Task.of_garment(
        garment,
        scene.body,
        cloth,
        of,
        contact=scene.contact,
        body_vertices=scene.body_vertices,
        skinned=skinned,
        starts=(pushed, network.drape(garment, poses).vertices),
    )
    found, was_cached = stored_minimum(task, scene.step_limit, scene.folder)
    weight_n = of.gravity_m_s2 * cloth.vertex_mass(of).sum()
    rows = [
        {
            "garment": garment.name,
            "fabric": "" if made_of is None else made_of.name,
            "pose": label,
            "held": task.held is not None,
            "start_j": float(found.start_j[frame]),
            "energy_j": float(found.energy_j[frame]),
            "nearest_j": float(found.nearest_j[frame]),
            "force_left_share": float(found.residual_n[frame] / weight_n),
            "at_rest": bool(found.converged[frame]),
            "steps": int(found.steps[frame]),
            "processor_s": float(found.processor_s[frame]),
            "seconds": found.seconds / len(poses),
            "cached": was_cached,
        }
        for frame, label in enumerate(scene.poses.labels)
    ]
    return rows, found.vertices


def picture(garment: Garment, vertices: np.ndarray, scene: Scene) -> np.ndarray:
    """The first of the optima ``vertices`` (F, V, 3) as plain cloth under a raking light."""
    body, faces = scene.body, garment.fine_faces.astype(np.int64)
    surfaces = [Surface(scene.body_vertices[0], body.faces, SKIN), Surface(vertices[0], faces, PLAIN_CLOTH)]
    low, high = vertices[0].min(axis=0), vertices[0].max(axis=0)
    extent_m = EXTENT * float((high - low)[1])
    centre = 0.5 * (low + high)
    return render(surfaces, size=SIZE, azimuth_deg=20.0, centre=centre, extent_m=extent_m, light=RAKING_LIGHT)


def add_before(rows: list[dict[str, Any]], path: Path) -> None:
    """Adds ``old_energy_j`` and ``old_processor_s`` of the record at ``path`` to the rows in the one cloth."""
    known = {(row["garment"], row["pose"]): row for row in json.loads(path.read_text(encoding="utf-8"))["rows"]}
    for row in rows:
        old = known.get((row["garment"], row["pose"]))
        if old is not None and not row["fabric"]:
            row |= {"old_energy_j": old["energy_j"], "old_processor_s": old["processor_s"]}


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line per garment and fabric: means over its poses, counts, and the largest force left."""
    found = []
    for garment, name in dict.fromkeys((row["garment"], row["fabric"]) for row in rows):
        own = [row for row in rows if (row["garment"], row["fabric"]) == (garment, name)]
        means = ("start_j", "energy_j", "nearest_j", "old_energy_j", "steps", "processor_s", "old_processor_s")
        line = {key: float(np.mean([row[key] for row in own])) for key in means if all(key in row for row in own)}
        line |= {
            "garment": garment,
            "fabric": name,
            "held": own[0]["held"],
            "poses": len(own),
            "at_rest": sum(row["at_rest"] for row in own),
            "not_above_start": sum(row["energy_j"] <= row["start_j"] for row in own),
            "force_left_share": max(row["force_left_share"] for row in own),
            "planes_apart_pct": 100.0
            * float(np.mean([abs(row["energy_j"] - row["nearest_j"]) for row in own]))
            / (line["start_j"] - line["energy_j"]),
        }
        if "old_energy_j" in line:
            line["not_above_old"] = sum(row["nearest_j"] <= row["old_energy_j"] for row in own)
        found.append(line)
    return found


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    scene = open_scene(options)
    fabrics = [fabric(name) for name in options.fabrics]
    rows: list[dict[str, Any]] = []
    refused: dict[str, str] = {}
    drawn: list[list[np.ndarray]] = []
    for path in find_garments(options.garments):
        try:
            garment = open_garment(path, scene.body)
        except InputError as error:
            refused[error.name] = str(error)
            continue
        own = fabrics if garment.name in options.fabric_garments else []
        pictures = []
        for made_of in (None, *own):
            called = f"{garment.name} of {made_of.name}" if made_of else garment.name
            try:
                new, vertices = measure(garment, made_of, scene)
            except InputError as error:
                refused[called] = str(error)
                print(f"{called}: {error}", flush=True)
                continue
            rows += new
            pictures += [picture(garment, vertices, scene)] if options.sheet and own else []
            print(f"{called}: {sum(row['at_rest'] for row in new)} of {len(new)} at rest", flush=True)
        drawn += [pictures] if len(pictures) == 1 + len(fabrics) > 1 else []
    if options.sheet and drawn:
        save_png(options.sheet, sheet(drawn), colours=128)
    if options.before:
        add_before(rows, options.before)
    print()
    lines = summary(rows)
    common.print_table(lines, COLUMNS)
    return common.finish(
        "referee",
        rows,
        options,
        summary=lines,
        frames=list(scene.poses.labels),
        model=options.model,
        **scene.network.record(),
        refused=refused,
        tolerance=physics.TOLERANCE,
        step_limit=options.steps,
    )


if __name__ == "__main__":
    sys.exit(ended(main))
