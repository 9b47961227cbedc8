"""A draped garment as OBJ and as GLB: nodes as vertices, the panels side by side as texture, a material per panel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric_table import DEFAULT_FABRIC
from drape.cloth.material import worn_fabric
from drape.export import obj
from drape.export.glb import add_garment
from drape.export.glb_file import GlbFile
from drape.export.surface import MeshSurface
from drape.files.atomic import write_whole
from drape.garment.intake import IntakeOptions, intake
from recovery.drape.pattern_drape import Draped
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.pieces import make_sheet
from recovery.progress import Say


def panel_texture(mesh: PatternMesh, unit_m: float | None = None) -> tuple[np.ndarray, float]:
    """Returns texture coordinates (P, 2) of the panel vertices, the panels side by side, and the length [m] of one
    unit.

    This is ``unit_m``, by default the length at which all panels fit into the unit square.
    """
    sheet = make_sheet(mesh.pattern, allowance_m=0.0)
    unit = float(max(sheet.width_m, sheet.height_m)) if unit_m is None else unit_m
    return (mesh.rest + sheet.offsets[mesh.panel]) / unit, unit


def sewn_obj_text(mesh: PatternMesh, nodes: np.ndarray, texture: tuple[np.ndarray, float]) -> str:
    """Returns the garment at ``nodes`` [m] (N, 3) as the text of an OBJ: its vertices are nodes, its texture vertices
    are panel vertices.

    Both keep their numbers, so a corner's pair v/vt is the one-to-many map of the seams. ``texture`` is what
    ``panel_texture`` returns.
    """
    uv, unit = texture
    text = obj.obj_text([_surface(mesh, uv)], [nodes])
    return f"# {mesh.pattern.name}: one unit of vt is {unit:.9g} m of cloth\n{text}"


def glb_bytes(mesh: PatternMesh, nodes: np.ndarray, texture: tuple[np.ndarray, float]) -> bytes:
    """Returns the garment at ``nodes`` [m] (N, 3) as a GLB; ``texture`` is what ``panel_texture`` returns.

    Its vertices are split along the seams: glTF has no separate texture vertices.
    """
    file = GlbFile()
    add_garment(file, _surface(mesh, texture[0]), nodes[None], 1.0)
    return file.to_bytes()


def write_shape(
    folder: Path, name: str, mesh: PatternMesh, nodes: np.ndarray, texture: tuple[np.ndarray, float]
) -> list[Path]:
    """Writes NAME.obj and NAME.glb of the garment at ``nodes`` [m] (N, 3) to ``folder`` and returns their paths."""
    return [
        write_whole(folder / f"{name}.obj", sewn_obj_text(mesh, nodes, texture)),
        write_whole(folder / f"{name}.glb", glb_bytes(mesh, nodes, texture)),
    ]


def write_rest(
    folder: Path, name: str, draped: Draped, body: BodyModel, fabric: str, *, avatar: Any, garment: bool, report: Say
) -> list[Path]:
    """Writes the drape in the T-pose as NAME_rest.obj, and with ``garment`` also the garment cache, to ``folder``.
    Returns the paths.

    The cache holds the garment at rest, from which the service drapes, and the fabric that is nearest to ``fabric``, a
    name that ``material`` takes. It is moved to ``body`` from ``avatar``, on which it was draped
    (``drape.garment.intake``). ``report`` gets lines on that.
    """
    texture = panel_texture(draped.mesh)
    rest = sewn_obj_text(draped.mesh, draped.rest.nodes, texture)
    files = [write_whole(folder / f"{name}_rest.obj", rest)]
    if garment:
        worn = worn_fabric(fabric)
        options = IntakeOptions(uv_unit_m=texture[1], fabric=None if worn == DEFAULT_FABRIC else worn)
        given = {"name": name, "kind": "obj", "avatar": avatar, "body": body, "folder": folder}
        files.append(folder / intake(rest.encode(), **given, options=options, report=report).file_name())
    return files


def _surface(mesh: PatternMesh, uv: np.ndarray) -> MeshSurface:
    pattern = mesh.pattern
    materials = tuple(panel.name for panel in pattern.panels)
    return MeshSurface(pattern.name, mesh.node_count, mesh.faces, uv, mesh.panel_faces, materials, mesh.face_panel)
