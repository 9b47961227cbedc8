"""Reads a target: one garment's surface, in metres, on the body it was draped on; repaired with a note, or refused.

A fault that has one repair (copies of vertices, faces without area, crumbs, unit, axis, sides) is repaired, with a note
in the report. A fault that needs a choice (which of two pieces, an edge with three faces) is refused with the cure.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drape.errors import InputError, MeshError
from drape.garment.avatars import Avatar
from drape.garment.files.mesh import GarmentMesh, read_mesh, weld
from drape.garment.mesh_checks import (
    Unit,
    Up,
    check_area,
    check_arrays,
    check_edges,
    check_faces,
    orient_outward,
    place,
)
from drape.geometry import closest, mesh_graphs, meshes
from recovery.fit.contours import TRUNK, bone_chains, open_contours, place_of

CRUMB_SHARE = 0.02  # of the area: smaller pieces are left out with a note
FAR_M = 0.12  # median distance from the skin: the loosest garment hangs nearer
DEEP_M, DEEP_SHARE = 0.02, 0.2  # the target goes through the body where more than this share lies deeper than that
SMALL_HOLE_M = 0.2  # a border of less length is mentioned as a hole
# Openings round each part of the body, by base.
OPENINGS = {
    "tshirt": {TRUNK: 2, "left_arm": 1, "right_arm": 1},
    "trousers": {TRUNK: 1, "left_leg": 1, "right_leg": 1},
    "skirt": {TRUNK: 2},
}


def read_target(path: Path, *, label: str | None = None) -> GarmentMesh:
    """The mesh in ``path`` with copies of vertices joined, bad faces and crumbs left out, in the file's coordinates.

    ``label`` keeps the faces of one material. Raises ``MeshError`` for several pieces, for edges with more than two
    faces and for a solid without openings.
    """
    mesh = read_mesh(path)
    if label is not None:
        mesh = labelled(mesh, label)
    check_arrays(mesh)
    mesh = check_faces(weld(mesh), repair=True)
    check_edges(mesh)
    mesh = one_piece(mesh)
    if not meshes.boundary_loops(mesh.faces):
        raise MeshError(
            "target",
            expected="a garment: a surface with openings",
            got="a closed surface",
            cure="Cut the garment out of the scan, without the body, and open neck, cuffs and hem.",
        )
    return mesh


def labelled(mesh: GarmentMesh, label: str) -> GarmentMesh:
    """The faces of ``mesh`` whose material is called ``label``."""
    if label not in mesh.material_names:
        raise MeshError(
            "--label",
            expected=f"one of {', '.join(mesh.material_names)}",
            got=label,
            cure="Name a material of the file.",
        )
    keep = mesh.face_material == mesh.material_names.index(label)
    if not keep.any():
        raise MeshError("--label", expected=f"faces of {label}", got="none", cure="Name another material of the file.")
    return mesh.take_faces(keep).noted(f"kept {int(keep.sum())} of {len(keep)} faces: those of material {label}")


def one_piece(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` without crumbs and unused vertices; refuses two pieces of cloth."""
    piece = mesh_graphs.connected_components(mesh.faces, len(mesh.vertices))[mesh.faces[:, 0]]
    area = np.bincount(piece, meshes.face_areas(mesh.vertices, mesh.faces))
    whole = np.flatnonzero(area > CRUMB_SHARE * area.sum())
    if len(whole) > 1:
        sizes = ", ".join(f"{100 * area[n] / area.sum():.0f} %" for n in sorted(whole, key=lambda n: -area[n])[:6])
        labels = f" Materials: {', '.join(mesh.material_names)}." if len(mesh.material_names) > 1 else ""
        raise MeshError(
            "target",
            expected="one garment in one piece",
            got=f"{len(whole)} pieces, of {sizes} of the area",
            cure=f"Save the garment alone, name its material (--label), or join what was torn.{labels}",
        )
    kept = mesh.take_faces(piece == whole[0])
    used, inverse = np.unique(kept.faces, return_inverse=True)
    left_out = int(len(np.unique(piece)) - 1)
    kept = replace(kept, vertices=kept.vertices[used], faces=inverse.reshape(-1, 3))
    return kept.noted(f"left out {left_out} small loose pieces") if left_out else kept


def placed_target(mesh: GarmentMesh, skin: Avatar, *, unit: Unit = "auto", up: Up = "auto") -> GarmentMesh:
    """``mesh`` in metres, y up, on ``skin``, with normals outward; refuses one that does not lie on it."""
    if not len(mesh.uv):
        mesh = replace(mesh, uv_faces=np.zeros((0, 3), dtype=np.int64))
    mesh = orient_outward(place(mesh, skin, unit=unit, up=up), skin)
    check_near(mesh, skin)
    check_area(mesh, "target area")
    return mesh


def check_near(mesh: GarmentMesh, skin: Avatar) -> None:
    """Refuses a target that hangs in the air beside the body, or that goes through it."""
    step = max(1, len(mesh.vertices) // 2000)
    distance = closest.signed_distance(mesh.vertices[::step], skin.vertices, skin.faces)
    cure = "Move the target onto the body it was draped on, name its pose (--pose), or fit a body in it (--body fit)."
    if (middle := float(np.median(distance))) > FAR_M:
        raise InputError(
            "target",
            expected=f"cloth on the body, half of it within {100 * FAR_M:.0f} cm of the skin",
            got=f"half of it more than {100 * middle:.0f} cm away",
            cure=cure,
        )
    if (deep := float((distance < -DEEP_M).mean())) > DEEP_SHARE:
        raise InputError(
            "target",
            expected="cloth outside the body",
            got=f"{100 * deep:.0f} % of it more than {100 * DEEP_M:.0f} cm inside",
            cure=cure,
        )


def openings(mesh: GarmentMesh, joints: np.ndarray) -> tuple[dict[str, int], list[str]]:
    """The number of the target's openings round each part of the body (``joints`` [m] (24, 3)), and notes on holes."""
    chains = bone_chains(joints)
    found: dict[str, int] = {}
    holes = []
    for contour in open_contours(mesh.vertices, mesh.faces):
        part = place_of(contour, chains).part
        if part is None or contour.length_m < SMALL_HOLE_M:
            holes.append(contour.length_m)
        else:
            found[part] = found.get(part, 0) + 1
    notes = [f"{len(holes)} holes of up to {100 * max(holes):.0f} cm round: the fit leaves them alone"] if holes else []
    return found, notes


def check_base(base: str, found: dict[str, int]) -> None:
    """Refuses a target whose openings are not those of the base called ``base``; other bases are not known here."""
    wanted = OPENINGS.get(base)
    if wanted is None:
        return
    missing = {part for part, count in wanted.items() if found.get(part, 0) < count}
    foreign = set(found) - set(wanted)
    if missing or foreign:
        fitting = [name for name, kind in OPENINGS.items() if kind == found]
        raise InputError(
            "target",
            expected=f"the openings of a {base}: {describe_openings(wanted)}",
            got=describe_openings(found) or "no opening that the body goes through",
            cure=f"Take --base {fitting[0]}."
            if fitting
            else "Take a base of the target's kind, and open what is shut.",
        )


def describe_openings(found: dict[str, int]) -> str:
    """A phrase such as "2 round the trunk, 1 round the left arm"."""
    return ", ".join(f"{count} round the {part.replace('_', ' ')}" for part, count in sorted(found.items()))
