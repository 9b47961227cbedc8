"""Writes a draped garment: OBJ with the panels as texture coordinates, GLB, and the report."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from recovery.pattern.mesh import PatternMesh
from recovery.pattern.pieces import make_sheet


def panel_texture(mesh: PatternMesh) -> tuple[np.ndarray, float]:
    """Texture coordinates (P, 2) in the unit square: the panels side by side; and how many metres one unit is."""
    sheet = make_sheet(mesh.pattern, allowance_m=0.0)
    unit = float(max(sheet.width_m, sheet.height_m))
    return (mesh.rest + sheet.offsets[mesh.panel]) / unit, unit


def obj_text(mesh: PatternMesh, nodes: np.ndarray, texture: tuple[np.ndarray, float]) -> str:
    """The garment at ``nodes`` [m] (N, 3) as an OBJ: vertices are nodes, texture vertices are panel vertices.

    Both keep their numbers, so a corner's pair v/vt is the one-to-many map of the seams; a material per panel.
    ``texture`` is what ``panel_texture`` gives.
    """
    uv, unit = texture
    lines = [f"# {mesh.pattern.name}: metres, y up; one unit of vt is {unit:.9g} m of cloth"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in nodes]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in uv]
    for number, panel in enumerate(mesh.pattern.panels):
        mine = mesh.face_panel == number
        lines += [f"usemtl {'_'.join(panel.name.split())}"]
        corners = np.stack([mesh.faces[mine], mesh.panel_faces[mine]], axis=2) + 1
        lines += ["f " + " ".join(f"{node}/{vertex}" for node, vertex in face) for face in corners]
    return "\n".join(lines) + "\n"


def glb_bytes(mesh: PatternMesh, nodes: np.ndarray, texture: tuple[np.ndarray, float]) -> bytes:
    """The same as a GLB; a vertex per panel vertex, because glTF has no separate texture vertices."""
    uv, _ = texture
    surface = trimesh.Trimesh(
        nodes[mesh.node_of_panel_vertex],
        mesh.panel_faces,
        process=False,
        visual=TextureVisuals(uv=uv),
    )
    payload = surface.export(file_type="glb")
    assert isinstance(payload, bytes)
    return payload


def write(path: Path, content: str | bytes | dict[str, Any]) -> Path:
    """Writes text, bytes or JSON to ``path`` atomically and returns it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, dict):
        content = json.dumps(content, indent=1) + "\n"
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    os.replace(temporary, path)
    return path
