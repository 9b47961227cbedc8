"""Reads the meshes of an FBX file, with the looks of its materials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drape.files.fbx import FbxMesh, read_scene
from drape.garment.files.fbx_looks import fbx_looks
from drape.garment.files.mesh import Beside, GarmentMesh, check_count, fans, in_stated_unit, mesh_fault, plain_mesh

UNTOLD = -1  # the number of no material


@dataclass(frozen=True, eq=False)
class _Part:
    """World ``points`` (V, 3), triangles ``faces`` (F, 3), texture coordinates of their corners (3 F, 2) or None, and
    the number of the material (F,) of each."""

    points: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    material: np.ndarray
    polygons: int


def read_fbx(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """The visible meshes of an FBX file in metres, y up; vertices keep the file's order. Pictures are in the file or
    ``beside``."""
    scene = read_scene(payload, lambda expected, got, cure: mesh_fault(name, expected, got, cure))
    parts = list(_parts(scene.meshes, name, vertex_limit))
    if not parts:
        raise mesh_fault(name, "a mesh that is drawn", "none", "Export the garment's surface.")
    starts = np.cumsum([0] + [len(part.points) for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)])
    used, material = np.unique(np.concatenate([part.material for part in parts]), return_inverse=True)
    told = [None if number == UNTOLD else scene.materials[number] for number in used]
    looks, notes = fbx_looks(told, scene.pictures, beside)
    names = tuple("default" if one is None else one["name"] for one in told)
    points, unit_note = in_stated_unit(np.concatenate([part.points for part in parts]), scene.unit_m)
    mesh = plain_mesh(name, points, faces)
    mesh = replace(mesh, material_names=names, face_material=material.reshape(-1), looks=looks)
    if polygons := sum(part.polygons for part in parts):
        mesh = mesh.noted(f"{polygons} polygons triangulated")
    mesh = mesh.noted(unit_note, *notes)
    if all(part.uv is None for part in parts):
        return mesh
    uv = np.concatenate([np.zeros((3 * len(part.faces), 2)) if part.uv is None else part.uv for part in parts])
    return replace(mesh, uv=uv, uv_faces=np.arange(len(uv)).reshape(-1, 3))


def _parts(meshes: list[FbxMesh], name: str, vertex_limit: int) -> Iterator[_Part]:
    total = 0
    for mesh in meshes:
        total += len(mesh.vertices)
        check_count(name, max(total, len(mesh.corners) // 8), vertex_limit)
        begin, sides = mesh.polygons.T
        whole = np.flatnonzero(sides >= 3)  # what is less is a point or a line
        if not len(whole):
            continue
        corner = np.repeat(begin[whole] - (np.cumsum(sides[whole]) - sides[whole]), sides[whole])
        corner = corner + np.arange(len(corner))
        corners = mesh.corners[corner]
        if not np.isfinite(mesh.vertices).all() or not 0 <= corners.min() <= corners.max() < len(mesh.vertices):
            raise mesh_fault(name, f"finite vertices, and corners below {len(mesh.vertices)}", "others")
        fan = fans(sides[whole])
        if np.linalg.det(mesh.placed[:, :3]) < 0.0:
            fan = fan[:, ::-1]
        uv = None if mesh.uv is None or not np.isfinite(mesh.uv).all() else mesh.uv[corner][fan.reshape(-1)]
        material = np.repeat(_materials(mesh)[whole], sides[whole] - 2)
        points = mesh.vertices @ mesh.placed[:, :3].T + mesh.placed[:, 3]
        yield _Part(points, corners[fan], uv, material, int((sides > 3).sum()))


def _materials(mesh: FbxMesh) -> np.ndarray:
    """The number of the material of each polygon of ``mesh``."""
    count = len(mesh.polygons)
    row = mesh.face_material if len(mesh.face_material) == count else np.zeros(count, dtype=np.int64)
    known = np.array([*mesh.materials, UNTOLD])
    return known[np.where((row >= 0) & (row < len(mesh.materials)), row, -1)]
