"""Writes a sewn garment: mesh files that intake takes, and a JSON of what a mesh file cannot say.

``NAME.obj``: v are nodes [m], vt the panels laid out side by side in metres, unscaled, the grain along +y; a corner's
pair v/vt is the map of the seams. ``NAME.glb``: the same, split at the seams. ``NAME.json``: fabric, seams with their
panels and rest angles, hems and openings, by the numbers of the OBJ's v and vt (from 0).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from recovery.catalogue.build import SewnGarment
from recovery.catalogue.settling import HEM_BENDING, HEM_M
from recovery.drape.output import glb_bytes, obj_text, write
from recovery.pattern.mesh import PatternMesh
from recovery.pattern.pieces import make_sheet

FORMAT = "drape sewn garment"
FORMAT_VERSION = 1


def panel_layout(mesh: PatternMesh) -> np.ndarray:
    """Texture coordinates [m] (P, 2): the panels side by side, as they lie on the cloth."""
    sheet = make_sheet(mesh.pattern, allowance_m=0.0)
    return mesh.rest + sheet.offsets[mesh.panel]


def edge_kind(name: str) -> str:
    """ "hem" for an edge that is turned up, "opening" for one that is bound or banded, "free" for any other."""
    return next((kind for kind in ("hem", "opening") if name.startswith(kind)), "free")


def description(garment: SewnGarment, *, name: str, size: str, body: str) -> dict[str, Any]:
    """What ``NAME.json`` says."""
    made, mesh = garment.design, garment.mesh
    sewn = {ref for stitch in made.pattern.stitches for ref in (stitch.first, stitch.second)}
    seams = []
    for number, (stitch, seam) in enumerate(zip(made.pattern.stitches, made.seam_names, strict=True)):
        pairs = mesh.seam_pairs[mesh.seam_of_pair == number]
        seams.append(
            {
                "name": seam,
                "panels": [stitch.first.panel, stitch.second.panel],
                "angle_rad": made.seam_angles.get(seam, 0.0),
                "vertices": mesh.node_of_panel_vertex[pairs[:, 0]].tolist(),
                "uv": pairs.T.tolist(),
            }
        )
    edges = [
        {
            "name": named,
            "kind": edge_kind(named),
            "panel": ref.panel,
            "vertices": mesh.node_of_panel_vertex[mesh.edge_vertices[ref]].tolist(),
            "uv": np.asarray(mesh.edge_vertices[ref]).tolist(),
        }
        for ref, named in made.edge_names.items()
        if ref not in sewn
    ]
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "name": name,
        "size": size,
        "body": body,
        "fabric": made.fabric,
        "mesh": f"{name}.obj",
        "uv_unit_m": 1.0,
        "hem_bending": HEM_BENDING,
        "hem_width_m": HEM_M,
        "panels": [panel.name for panel in made.pattern.panels],
        "seams": seams,
        "edges": edges,
        "ease_m": dict(made.ease_m),
        "figures": garment.figures,
    }


def write_garment(garment: SewnGarment, folder: Path, *, name: str, size: str, body: str) -> list[Path]:
    """Writes ``NAME.obj``, ``NAME.glb`` and ``NAME.json`` to ``folder`` and returns their paths."""
    texture = (panel_layout(garment.mesh), 1.0)
    return [
        write(folder / f"{name}.obj", obj_text(garment.mesh, garment.nodes, texture)),
        write(folder / f"{name}.glb", glb_bytes(garment.mesh, garment.nodes, texture)),
        write(folder / f"{name}.json", description(garment, name=name, size=size, body=body)),
    ]
