"""Reads the meshes of an FBX file, with the looks of its materials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drape.files.fbx import FbxMesh, read_scene
from drape.garment.files.fbx_looks import fbx_looks
from drape.garment.files.mesh import (
    Beside,
    GarmentMesh,
    MeshPart,
    check_count,
    fans,
    in_stated_unit,
    join_parts,
    mesh_fault,
)

NO_MATERIAL = -1  # the number of a face without a material


def read_fbx(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """Returns the visible meshes of an FBX file as one, in metres, y up. Vertices keep the file's order. Pictures come
    from the file or by ``beside``. Raises ``MeshError``."""
    scene = read_scene(payload, lambda expected, got, cure: mesh_fault(name, expected, got, cure))
    parts = list(_parts(scene.meshes, name, vertex_limit))
    mesh = join_parts(name, [part for part, _ in parts])
    points, unit_note = in_stated_unit(mesh.vertices, scene.unit_m)
    used, material = np.unique(np.concatenate([numbers for _, numbers in parts]), return_inverse=True)
    records = [None if number == NO_MATERIAL else scene.materials[number] for number in used]
    looks, notes = fbx_looks(records, scene.pictures, beside)
    names = tuple("default" if record is None else record["name"] for record in records)
    mesh = replace(mesh, material_names=names, face_material=material.reshape(-1), looks=looks)
    return replace(mesh, vertices=points).noted(unit_note, *notes)


def _parts(meshes: list[FbxMesh], name: str, vertex_limit: int) -> Iterator[tuple[MeshPart, np.ndarray]]:
    """Each of ``meshes`` with corners, and the number (F,) of the material of each of its triangles."""
    total = 0
    for mesh in meshes:
        total += len(mesh.vertices)
        check_count(name, max(total, len(mesh.corners) // 8), vertex_limit)
        begin, sides = mesh.polygons.T
        whole = np.flatnonzero(sides >= 3)  # fewer corners make a point or a line
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
        yield MeshPart(points, corners[fan], uv, int((sides > 3).sum())), material


def _materials(mesh: FbxMesh) -> np.ndarray:
    """The number of the material of each polygon of ``mesh``."""
    count = len(mesh.polygons)
    row = mesh.face_material if len(mesh.face_material) == count else np.zeros(count, dtype=np.int64)
    known = np.array([*mesh.materials, NO_MATERIAL])
    return known[np.where((row >= 0) & (row < len(mesh.materials)), row, -1)]
