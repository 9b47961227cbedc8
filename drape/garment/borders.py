"""The borders of a garment's cloth: which is an opening and which a hole, as far as the cloth at them tells.

A hole lies in the cloth, so the cloth at its rim looks the way that the hole does; at the rim of a cuff the cloth looks
sideways. Where a body is known its bones decide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes

SHORT_SHARE = 0.14  # of the root of the area: no cuff is as short as this; 14 cm for a square metre
LONG_SHARE = 0.35  # of the same: a longer border may be a neckline, which lies in flat cloth on broad shoulders
LIES_IN_CLOTH = 0.85  # cosine between the cloth's normals at a rim and the hole's own: a neckline has 0.7, a cuff 0.2
LOOKS_SIDEWAYS = 0.6  # below it is a tube's end; a border between the two needs a body to be told
SMOOTHINGS = 4


class Loop(NamedTuple):
    """A border: vertices ``loop`` (n,) in order, its ``length``, and how much it lies in the cloth, from 0 to 1.

    ``axis`` (3,) is the normal of the plane that it spans.
    """

    loop: np.ndarray
    length: float
    flatness: float
    axis: np.ndarray


def borders(mesh: GarmentMesh) -> list[Loop]:
    """The borders of ``mesh``, whose faces agree in orientation, longest first."""
    normals = meshes.vertex_normals(mesh.vertices, mesh.faces)
    averaging = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    for _ in range(SMOOTHINGS):  # noise tilts single normals
        normals = normals + averaging @ normals
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    loops = []
    for loop in meshes.boundary_loops(mesh.faces):
        points = mesh.vertices[loop]
        way = np.roll(points, -1, axis=0) - points
        length = np.linalg.norm(way, axis=1)
        axis = 0.5 * np.cross(points - points.mean(axis=0), way).sum(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
        flatness = float((length * np.abs(normals[loop] @ axis)).sum() / max(float(length.sum()), 1e-300))
        loops.append(Loop(loop, float(length.sum()), flatness, axis))
    return sorted(loops, key=lambda one: -one.length)


def plainly_hole(one: Loop, mesh: GarmentMesh) -> bool:
    """Returns whether a border is a hole, as far as the cloth alone tells: it is very short, or lies in the middle of
    the cloth."""
    root = float(np.sqrt(meshes.face_areas(mesh.vertices, mesh.faces).sum()))
    lies = one.flatness > LIES_IN_CLOTH and one.length < LONG_SHARE * root
    return one.length < SHORT_SHARE * root or lies


def plainly_opening(one: Loop) -> bool:
    """Returns whether a border is an opening, as far as the cloth alone tells: the cloth at it looks sideways."""
    return one.flatness < LOOKS_SIDEWAYS
