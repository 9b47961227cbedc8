"""Writes a sewn garment: mesh files for intake, and a JSON for what a mesh file has no place for.

``NAME.obj``: v are nodes [m], vt the panels laid out side by side in metres, unscaled, the grain along +y; a corner's
pair v/vt is the map of the seams. ``NAME.glb``: the same, split at the seams. ``NAME.json``: its ``Sewing``.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from drape.files.atomic import write_whole
from drape.garment.sewing import Edge, Seam, Sewing
from recovery.catalogue.build import SewnGarment
from recovery.catalogue.fall import HEM_BENDING, HEM_M
from recovery.drape.output import panel_texture, write_shape


def edge_kind(name: str) -> str:
    """ "hem" for an edge that is turned up, "opening" for one that is bound or banded, "free" for any other."""
    return next((kind for kind in ("hem", "opening") if name.startswith(kind)), "free")


def sewing(garment: SewnGarment, *, name: str, size: str, body: str) -> Sewing:
    """Returns the content of ``NAME.json`` for ``garment`` in ``size`` on ``body``."""
    design, mesh = garment.design, garment.mesh
    sewn = {ref for stitch in design.pattern.stitches for ref in (stitch.first, stitch.second)}
    seams = []
    for number, (stitch, seam) in enumerate(zip(design.pattern.stitches, design.seam_names, strict=True)):
        pairs = mesh.seam_pairs[mesh.seam_of_pair == number]
        panels = (stitch.first.panel, stitch.second.panel)
        nodes = mesh.node_of_panel_vertex[pairs[:, 0]].tolist()
        seams.append(Seam(seam, panels, design.seam_angles.get(seam, 0.0), nodes, pairs.T.tolist()))
    edges = []
    for ref, named in design.edge_names.items():
        if ref not in sewn:
            line = np.asarray(mesh.edge_vertices[ref])
            edges.append(
                Edge(named, edge_kind(named), ref.panel, mesh.node_of_panel_vertex[line].tolist(), line.tolist())
            )
    return Sewing(
        name=name,
        size=size,
        body=body,
        fabric=design.fabric,
        mesh=f"{name}.obj",
        uv_unit_m=1.0,
        hem_bending=HEM_BENDING,
        hem_width_m=HEM_M,
        panels=[panel.name for panel in design.pattern.panels],
        seams=seams,
        edges=edges,
        ease_m=dict(design.ease_m),
        figures=garment.figures,
    )


def write_garment(garment: SewnGarment, folder: Path, *, name: str, size: str, body: str) -> list[Path]:
    """Writes ``NAME.obj``, ``NAME.glb`` and ``NAME.json`` to ``folder`` and returns their paths."""
    texture = panel_texture(garment.mesh, unit_m=1.0)
    told = json.dumps(sewing(garment, name=name, size=size, body=body).to_json(), indent=1) + "\n"
    path = write_whole(folder / f"{name}.json", told)
    return [*write_shape(folder, name, garment.mesh, garment.nodes, texture), path]
