"""What garments remember at rest: ``python -m benchmarks.cloth.rest_sheets --sheets FOLDER``.

For every garment, shipped or under ``$DRAPE_DATA/garments``: how long intake takes, how many hinges keep an angle,
where the grain is from, how far the cloth is from lying flat, and a sheet of its angles at rest, modelled and auto.
Then drapes of some of them, minimised with both rest states in the same pose, beside each other under a low light.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.judge import physics
from benchmarks.shared import common
from benchmarks.shared.render import PLAIN_CLOTH, RAKING_LIGHT, SKIN, Surface, render, save_png, sheet
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment, short_name
from drape.cloth import metrics, rest_state
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import RestState
from drape.errors import ended
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.garment.rest_detail import cloth_of, distortion, rest_of
from drape.geometry import meshes
from drape.geometry.skinning import skin_points
from drape.motion.readers import read_motion

SIZE, DRAPE_SIZE = (250, 330), (400, 330)
VIEWS_DEG = ((15.0, 20.0), (180.0, 8.0))
PALE, BENT, DOUBLE = np.array([0.92, 0.92, 0.92]), np.array([0.90, 0.05, 0.0]), np.array([0.30, 0.55, 1.0])
FULL_RAD = np.radians(25.0)  # an angle of full colour
FRONT_LIGHT = np.array([0.2, 0.3, 0.93])
LONG_M = 0.75  # drapes of garments taller than this are drawn whole
# Upper bodies and a dress: nothing else stays up without a waistband. Clip and the share of it that has gone by.
DRAPES = {
    "male_long_sleeve_shirt": ("walk", 0.23),
    "female_suit_jacket": ("reach", 0.5),
    "tshirt": ("squat", 0.5),
    "dress": ("walk", 0.23),
}
PICTURED = ("male_tshirt", "male_long_sleeve_shirt", "female_suit_jacket")  # whose angles the picture shows
COLUMNS = {
    "garment": "s",
    "intake_s": ".1f",
    "rest_s": ".2f",
    "kept_pct": ".2f",
    "hem_pct": ".1f",
    "grain": "s",
    "lengths": "s",
    "distortion_pct": ".0f",
}


def row_of(path: Path, body: BodyModel) -> tuple[Garment, dict[str, Any]]:
    """The garment at ``path``, taken in where it is a mesh, and its row of the table (processor seconds)."""
    started = time.process_time()
    garment = open_garment(path, body)
    taken = time.process_time() - started
    painted, materials = (garment.uv, garment.uv_faces), (garment.material_names, garment.face_material)
    started = time.process_time()
    state, figures = rest_of(cloth_of(garment.vertices, garment.fine_faces, painted, materials))
    derived = time.process_time() - started
    told = garment.manifest.get("rest")
    if told is not None:
        state = garment.rest_state()
    faces = garment.fine_faces.astype(np.int64)
    return garment, {
        "garment": garment.name,
        "intake_s": taken if told is not None else None,
        "rest_s": derived,
        "kept_pct": 100.0 * float((state.hinge_angle != 0.0).mean()),
        "hem_pct": 100.0 * float((state.stiffening > 1.0).mean()),
        "grain": told["grain"] if told else figures.grain,
        "lengths": told["lengths"] if told else figures.lengths,
        "distortion_pct": 100.0 * (distortion(garment.vertices.astype(np.float64), faces) - 1.0),
    }


def angle_colours(state: RestState, faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3): the more a triangle is bent at rest the redder; blue where cloth lies double."""
    sides = meshes.hinge_faces(faces)
    bent, double = np.zeros(len(faces)), np.zeros(len(faces))
    for side in sides.T:
        np.maximum.at(bent, side, np.abs(state.hinge_angle))
        np.maximum.at(double, side, np.where(state.stiffening > 1.0, 1.0, 0.0))
    ground = PALE + double[:, None] * (DOUBLE - PALE)
    return ground + np.clip(bent / FULL_RAD, 0.0, 1.0)[:, None] * (BENT - ground)


def angle_sheet(garment: Garment) -> list[np.ndarray]:
    """One row: the garment at rest, coloured by its angles modelled, then auto, from two sides each."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    wide, tall, _ = np.ptp(rest, axis=0)
    return [
        render(
            [Surface(rest, faces, angle_colours(state, faces), smooth=False)],
            size=SIZE,
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            extent_m=1.1 * max(tall, wide * SIZE[0] / SIZE[1]),
            light=FRONT_LIGHT,
        )
        for state in (rest_state.modelled(rest, faces), garment.rest_state())
        for azimuth, elevation in VIEWS_DEG
    ]


@dataclass(frozen=True, eq=False)
class Pair:
    """A garment draped with the rest state modelled and auto, vertices [m] (2, V, 3), over ``skin`` (Vb, 3)."""

    garment: Garment
    vertices: np.ndarray
    skin: np.ndarray
    figures: dict[str, Any]


def drape_pair(garment: Garment, body: BodyModel, pose: np.ndarray, fabric_name: str, steps: int) -> Pair:
    """``garment`` in ``pose`` (24, 3), minimised from its skinning with both rest states."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    contact, material = BodyContact.of_body(body), Material.of(fabric(fabric_name))
    rotations, translations = body.bones(pose[None])
    skin = body.posed_vertices(pose[None])
    skinned = skin_points(rest[None], garment.skin_weights.astype(np.float64), rotations, translations)
    start = nearest_vertex_push(skinned, skin, np.asarray(contact.normals(skin)))
    found = []
    for state in (rest_state.modelled(rest, faces), garment.rest_state()):
        cloth = ClothMesh.of(state, faces, len(rest))
        task = physics.Task.of_garment(
            garment, body, cloth, material, contact=contact, body_vertices=skin, skinned=skinned, starts=(start,)
        )
        found.append(physics.minimise(task, step_limit=steps))
    drapes = np.concatenate([one.vertices for one in found])
    bend = [np.abs(rest_state.dihedral_angles(x, faces)) for x in drapes]
    figures = {
        "garment": garment.name,
        "apart_mm": 1e3 * float(np.linalg.norm(drapes[0] - drapes[1], axis=1).mean()),
        "bend_modelled_deg": float(np.degrees(bend[0].mean())),
        "bend_auto_deg": float(np.degrees(bend[1].mean())),
        "edge_pct": float(metrics.edge_strain_pct(drapes[1:], rest, faces).mean()),
    }
    return Pair(garment, drapes, skin[0], figures)


def drape_row(pair: Pair, body: BodyModel) -> list[np.ndarray]:
    """One row: front modelled and auto, back modelled and auto."""
    faces = pair.garment.fine_faces
    centre = 0.5 * (pair.vertices[1].min(axis=0) + pair.vertices[1].max(axis=0))
    tall = float(np.ptp(pair.vertices[1][:, 1]))
    return [
        render(
            [Surface(pair.skin, body.faces, SKIN), Surface(draped, faces, PLAIN_CLOTH)],
            size=DRAPE_SIZE,
            azimuth_deg=azimuth,
            elevation_deg=4.0,
            centre=centre,
            extent_m=1.1 * tall if tall > LONG_M else LONG_M,
            light=RAKING_LIGHT,
        )
        for azimuth in (20.0, 165.0)
        for draped in pair.vertices
    ]


def main(arguments: list[str] | None = None) -> dict[str, Any]:
    """Prints the tables and the record, writes the sheets, and returns the record."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.cloth.rest_sheets", description=(__doc__ or "").split("\n")[0]
    )
    common.add_options(parser)
    parser.add_argument(
        "--garments", nargs="+", help="names, files or folders (default: shipped, $DRAPE_DATA/garments)"
    )
    parser.add_argument("--fabric", default="poplin", help="of the drapes (default %(default)s)")
    parser.add_argument("--steps", type=int, default=physics.STEPS, help="of the minimiser (default %(default)s)")
    parser.add_argument("--sheets", type=Path, default=common.ROOT / "runs" / "rest_sheets", help="folder of pictures")
    options = parser.parse_args(arguments)
    folder = data_folder("garments")
    paths = find_garments(options.garments or []) + (
        [] if options.garments or not folder else find_garments([str(folder)])
    )
    body = load_body()
    rows, pairs = [], []
    angles: dict[str, list[np.ndarray]] = {}
    for path in paths[:1] if options.quick else paths:
        garment, row = row_of(path, body)
        rows.append(row)
        angles[garment.name] = angle_sheet(garment)
        if short_name(path) in DRAPES and not options.quick:
            name, share = DRAPES[short_name(path)]
            clip = read_motion(find_motions([name])[0])
            pose = np.asarray(clip.poses[int(share * clip.frame_count)], dtype=np.float64)
            pairs.append(drape_pair(garment, body, pose, options.fabric, options.steps))
    common.print_table(rows, COLUMNS)
    sheets = list(angles.values())
    for start in range(0, len(sheets), 5):
        save_png(options.sheets / f"angles_{start // 5}.png", sheet(sheets[start : start + 5]), colours=256)
    if pairs:
        drapes = [pair.figures for pair in pairs]
        common.print_table(drapes, dict.fromkeys(drapes[0], ".2f") | {"garment": "s"})
        drawn = [drape_row(pair, body) for pair in pairs]
        save_png(options.sheets / "drapes.png", sheet(drawn), colours=128)
        shown = [angles[name] for name in PICTURED if name in angles]
        save_png(options.sheets / "rest_state.png", sheet(shown + drawn[:2]), colours=160)
    return common.finish("rest_sheets", rows, options, drapes=[pair.figures for pair in pairs], fabric=options.fabric)


if __name__ == "__main__":
    sys.exit(ended(main))
