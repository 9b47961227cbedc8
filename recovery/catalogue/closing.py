"""Brings a design's panels round the body, sews them on a coarse mesh, and moves the shape to a fine mesh."""

from __future__ import annotations

import numpy as np

from drape.cloth.relaxation import Distance
from drape.errors import InputError
from drape.geometry import closest
from recovery.drape.placement import moved_clear
from recovery.drape.seam_threads import SEWING_GAP_M, Sewn, sew
from recovery.pattern.design import Design
from recovery.pattern.pattern_mesh import PatternMesh

OVER_GAP_M = 0.032  # that panels over others keep from the skin while they are sewn


def start_positions(design: Design, mesh: PatternMesh, distance: Distance) -> np.ndarray:
    """Panel vertices [m] (P, 3) before sewing: wraps round their limbs, flat panels moved outward until clear."""
    positions = moved_clear(mesh, mesh.placed(), distance, leave=design.wraps)[0]
    for number, panel in enumerate(design.pattern.panels):
        if panel.name in design.wraps:
            mine = mesh.panel == number
            positions[mine] = design.wraps[panel.name].place(mesh.rest[mine])
    return positions


def sew_design(design: Design, mesh: PatternMesh, distance: Distance) -> Sewn:
    """Returns ``design`` sewn on ``mesh`` round the body with this signed ``distance``. Raises ``InputError`` where a
    seam cannot close."""
    folded = [number for number, name in enumerate(design.seam_names) if name in design.seam_angles]
    creases = np.unique(mesh.node_of_panel_vertex[mesh.seam_pairs[np.isin(mesh.seam_of_pair, folded)]])
    over = [panel.name in design.over for panel in design.pattern.panels]
    gaps = np.where(np.array(over)[mesh.panel], OVER_GAP_M, SEWING_GAP_M)
    return sew(mesh, start_positions(design, mesh, distance), distance, gap_m=gaps, creases=creases)


def on_finer_mesh(coarse: PatternMesh, nodes: np.ndarray, fine: PatternMesh) -> np.ndarray:
    """Nodes [m] (N, 3) of ``fine`` on the cloth of ``coarse`` at ``nodes``, by their places in the panels.

    Panels of ``fine`` may be cut into the rest, under the same name, and parts in the same frame, named after it.
    """
    there, here = ([panel.name for panel in mesh.pattern.panels] for mesh in (coarse, fine))
    whole = [_whole(name, there) for name in here]
    if None in whole or not set(there) <= set(here):
        raise InputError(
            "meshes",
            expected="two meshes of one pattern",
            got=f"{coarse.pattern.name} and {fine.pattern.name}",
            cure="Mesh the same pattern twice.",
        )
    positions = np.zeros((len(fine.rest), 3))
    flat = np.column_stack([coarse.rest, np.zeros(len(coarse.rest))])
    for number, parent in enumerate(whole):
        mine, faces = fine.panel == number, coarse.face_panel == parent
        points = np.column_stack([fine.rest[mine], np.zeros(mine.sum())])
        triangles = coarse.panel_faces[faces]
        found = closest.closest_point(points, flat, triangles)
        # Points outside a coarse chord are carried on along the nearest triangle.
        weights = closest.barycentric(points, flat[triangles[found.face]])
        positions[mine] = np.einsum("nk,nkc->nc", weights, nodes[coarse.faces[faces][found.face]])
    return fine.nodes_from(positions)


def _whole(name: str, names: list[str]) -> int | None:
    """The number of the panel called ``name``, or of the one that it was cut off; None where there is none."""
    while name not in names and "_" in name:
        name = name.rpartition("_")[0]
    return names.index(name) if name in names else None
