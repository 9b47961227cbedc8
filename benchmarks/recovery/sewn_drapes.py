"""Sewn garments draped by the shipped model: energy left of skinning's, strain of their panels, collisions, relief.

    python -m benchmarks.recovery.sewn_drapes --garments DIR --motions walk squat [--picture FILE.png] [--no-relief]

Each garment in its own fabric and rest state, on the hard poses of the clips, pushed out of the body. ``left_pct`` is
over skinning with the nearest-vertex push; ``panel_pct`` the mean change of the triangles' edges against the panels;
``copied``: the correlation of the posed relief (what ``drape.cloth.detail`` looks at) with that of the rest mesh, 1
where its folds are carried along as they are. ``--no-relief`` leaves out what the jets leave over at rest.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure.intersections import intersection_count
from benchmarks.shared import common
from benchmarks.shared.network import Network
from benchmarks.shared.render import PLAIN_CLOTH, SKIN, Surface, render, save_png, sheet
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.detail import LowPass
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import RestState
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.geometry import meshes
from drape.geometry.skinning import skin_points
from drape.graph.push_feed import push_feed
from drape.motion.hard_poses import HardPoses, hard_poses
from drape.motion.readers import read_motion

COLUMNS = {
    **dict.fromkeys(("garment", "fabric"), "s"),
    **dict.fromkeys(("vertices", "patches"), "d"),
    **dict.fromkeys(("left_pct", "panel_pct", "rest_panel_pct", "colliding_pct", "crossings"), ".2f"),
    **dict.fromkeys(("detail_mm", "rest_detail_mm", "copied"), ".2f"),
}
SIZE, MARGIN = (250, 176), 1.12
DRAWN = 2  # poses beside the T-pose


def panel_strain_pct(vertices: np.ndarray, faces: np.ndarray, rest: RestState) -> float:
    """Mean |length / length on the panel - 1| [%] of the triangles' edges at ``vertices`` [m] (..., V, 3)."""
    cut = [rest.edges[:, 0], rest.edges[:, 1], rest.edges[:, 1] - rest.edges[:, 0]]
    first, second = meshes.corner_edges(vertices, faces)
    worn = [first, second, second - first]
    return float(
        np.mean([100.0 * np.abs(_length(now) / _length(flat) - 1.0) for now, flat in zip(worn, cut, strict=True)])
    )


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def relief(low_pass: LowPass, vertices: np.ndarray) -> np.ndarray:
    """Heights [m] (..., V) of ``vertices`` over their low-pass surface."""
    smooth = low_pass.smoothed(vertices)
    return ((vertices - smooth) * meshes.vertex_normals(smooth, low_pass.faces)).sum(axis=-1)


def measure(
    garment: Garment, network: Network, body: BodyModel, poses: np.ndarray
) -> tuple[dict[str, Any], np.ndarray]:
    """The row of one garment at ``poses`` (F, 24, 3) [rad], and its drape [m] (F, V, 3)."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    state, cloth_of = garment.rest_state(), fabric(garment.fabric)
    cloth, low_pass = ClothMesh.of(state, faces, len(rest)), LowPass.of(state, faces, len(rest))
    skin, contact = body.posed_vertices(poses), BodyContact(body.faces, body.vertex_count)
    rotations, translations = body.bones(poses)
    still = np.broadcast_to(rest, (len(poses), *rest.shape))
    skinned = skin_points(still, garment.skin_weights.astype(np.float64), rotations, translations)
    draped = worn(garment, network, body, poses)
    height = metrics.mean_height(skinned, cloth)
    energy = [
        np.stack(list(metrics.static_parts(x, cloth, Material.of(cloth_of), contact, skin, height_m=height).values()))
        for x in (nearest_vertex_push(skinned, skin, np.asarray(contact.normals(skin))), draped)
    ]
    own, still_relief = relief(low_pass, draped), relief(low_pass, rest)
    alike = [np.corrcoef(frame, still_relief)[0, 1] for frame in own]
    return {
        "garment": garment.name,
        "fabric": cloth_of.name,
        "vertices": garment.vertex_count,
        "patches": garment.patch_count,
        "left_pct": float(100.0 * energy[1].sum(axis=0).mean() / energy[0].sum(axis=0).mean()),
        "panel_pct": panel_strain_pct(draped, faces, state),
        "rest_panel_pct": panel_strain_pct(rest, faces, state),
        "colliding_pct": float(metrics.colliding_triangle_pct(draped, skin, body.faces).mean()),
        "crossings": float(intersection_count(draped, faces).mean()),
        "detail_mm": float(low_pass.detail_mm(draped).mean()),
        "rest_detail_mm": float(low_pass.detail_mm(rest)),
        "copied": float(np.mean(alike)),
    }, draped


def worn(garment: Garment, network: Network, body: BodyModel, poses: np.ndarray) -> np.ndarray:
    """The drape [m] (F, V, 3) at ``poses`` (F, 24, 3) [rad] in the garment's fabric, pushed out of the body."""
    draped = network.made_of(fabric(garment.fabric)).drape(garment, poses).vertices
    return push_out_of_bodies(draped, body.posed_vertices(poses), body_skin(body), push_feed(garment, body))


def views(garment: Garment, draped: np.ndarray, skin: np.ndarray, skin_faces: np.ndarray) -> list[np.ndarray]:
    """The drape on the bodies ``skin`` [m] (F, Vb, 3), a picture per frame, all at one scale."""
    faces = garment.fine_faces.astype(np.int64)
    extent = MARGIN * float(np.ptp(draped[..., 1], axis=1).max())
    return [
        render(
            [Surface(bare, skin_faces, SKIN), Surface(cloth, faces, PLAIN_CLOTH)],
            size=SIZE,
            azimuth_deg=20.0,
            centre=0.5 * (cloth.min(axis=0) + cloth.max(axis=0)),
            extent_m=extent,
        )
        for cloth, bare in zip(draped, skin, strict=True)
    ]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    common.add_options(parser)
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, default=6, help="hard poses (default 6)")
    parser.add_argument("--fabric", help="of all garments (default: each garment's own)")
    parser.add_argument("--no-relief", action="store_true", help="without what the jets leave over at rest")
    parser.add_argument("--picture", type=Path, help="T-pose and poses of two clips, two garments a row")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and one line of JSON, and returns what that holds."""
    options = parse(arguments)
    body = load_body()
    network = Network(model_folder(options.model), body, threads=options.threads)
    clips = [read_motion(path) for path in find_motions(options.motions)]
    poses = hard_poses(clips, body, 2 if options.quick else options.frames)
    shown = drawn(poses)
    rows, pictures = [], []
    for path in find_garments(options.garments):
        garment = open_garment(path, body)
        if options.fabric:
            garment = replace(garment, fabric=options.fabric)
        if options.no_relief:
            garment = replace(garment, chart_residual=np.zeros_like(garment.chart_residual))
        row, draped = measure(garment, network, body, poses.poses)
        rows.append(row)
        if options.picture:
            on = np.concatenate([np.zeros_like(poses.poses[:1]), poses.poses[shown]])
            cloth = np.concatenate([worn(garment, network, body, on[:1]), draped[shown]])
            pictures.append(views(garment, cloth, body.posed_vertices(on), body.faces))
    if options.picture:
        pictures += [[np.ones_like(pictures[0][0])] * len(pictures[0])] * (len(pictures) % 2)
        save_png(options.picture, sheet([a + b for a, b in zip(pictures[::2], pictures[1::2], strict=True)]))
    common.print_table(rows, COLUMNS)
    return common.finish("sewn_drapes", rows, options, frames=list(poses.labels), **network.record())


def drawn(poses: HardPoses) -> list[int]:
    """The first pose of each clip, ``DRAWN`` at most."""
    clips = [label.split(":")[0] for label in poses.labels]
    return [clips.index(clip) for clip in dict.fromkeys(clips)][:DRAWN]


if __name__ == "__main__":
    main()
