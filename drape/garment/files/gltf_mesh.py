"""Reads the triangles of a glTF 2.0 file; declared counts are compared with the bytes first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drape.files.gltf import GltfFile
from drape.files.gltf_json import Node, Primitive
from drape.files.gltf_nodes import node_matrix
from drape.garment.files.gltf_looks import gltf_looks
from drape.garment.files.mesh import Beside, GarmentMesh, check_count, mesh_fault, plain_mesh, weld

TRIANGLES = 4
EXPORT = "Export the mesh again."

Part = tuple[np.ndarray, np.ndarray, np.ndarray | None, int | None]


def read_glb(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """Returns the triangles of the default scene as one mesh, in the scene's world axes [m]. Vertices at the same place
    become one; texture coordinates stay per corner. Raises ``MeshError``."""
    file, parts, total = GltfFile(payload, label=f"mesh {name}", beside=beside), [], 0
    for node, placed in _placed_nodes(file, name):
        mesh = None if node.mesh is None else file.item("meshes", node.mesh, "nodes.mesh")
        for primitive in () if mesh is None else mesh.primitives:
            total += file.count(primitive.attributes.get("POSITION"))
            corners = 0 if primitive.indices is None else file.count(primitive.indices)
            check_count(name, max(total, corners // 6), 6 * vertex_limit)
            parts.append(_part(file, primitive, placed, name))
    if not parts:
        raise mesh_fault(name, "a mesh in the scene", "none", EXPORT)
    return _joined(file, parts, name)


def _placed_nodes(file: GltfFile, name: str) -> Iterator[tuple[Node, np.ndarray]]:
    """Each node of the default scene and its transform (4, 4) to the world."""
    document = file.document
    tops = file.item("scenes", document.scene or 0, "scene").nodes if document.scenes else range(len(document.nodes))
    waiting, seen = [(number, np.eye(4)) for number in tops], set()
    while waiting:
        number, above = waiting.pop(0)
        if number in seen:
            raise mesh_fault(name, "nodes that form a tree", f"node {number} twice", EXPORT)
        seen.add(number)
        node = file.item("nodes", number)
        placed = above @ node_matrix(node)
        yield node, placed
        waiting += [(child, placed) for child in node.children]


def _part(file: GltfFile, primitive: Primitive, placed: np.ndarray, name: str) -> Part:
    """Points (V, 3), faces (F, 3), texture coordinates (V, 2) and material of a ``primitive``."""
    if primitive.mode != TRIANGLES:
        raise mesh_fault(name, "triangles (mode 4)", f"mode {primitive.mode}", "Triangulate the mesh.")
    held = primitive.attributes
    points = file.array(held.get("POSITION")).astype(np.float64)
    uv = file.array(held["TEXCOORD_0"]).astype(np.float64) if "TEXCOORD_0" in held else None
    if points.shape[1] != 3 or (uv is not None and uv.shape != (len(points), 2)):
        raise mesh_fault(name, "positions of 3 numbers, texture coordinates of 2, as many", "others", EXPORT)
    whole = np.arange(len(points)) if primitive.indices is None else file.array(primitive.indices)
    index = whole.astype(np.int64).reshape(-1)
    if len(index) % 3 or (len(index) and not 0 <= index.min() <= index.max() < len(points)):
        got = f"{len(index)} indices up to {index.max(initial=0)}"
        raise mesh_fault(name, f"triples of indices below {len(points)}", got, EXPORT)
    faces = index.reshape(-1, 3)
    if np.linalg.det(placed[:3, :3]) < 0:
        faces = faces[:, ::-1]  # a mirroring node turns its triangles
    return points @ placed[:3, :3].T + placed[:3, 3], faces, uv, primitive.material


def _joined(file: GltfFile, parts: list[Part], name: str) -> GarmentMesh:
    starts = np.cumsum([0] + [len(part[0]) for part in parts])
    points = np.concatenate([part[0] for part in parts])
    corner = np.concatenate([part[1] + start for part, start in zip(parts, starts[:-1], strict=True)])
    mesh = weld(plain_mesh(name, points, corner))
    used = list(dict.fromkeys(part[3] for part in parts))
    held = [{"name": "default"} if i is None else file.item("materials", i, "primitives.material") for i in used]
    names = [one.get("name") for one in held]
    names = tuple(name if isinstance(name, str) else f"material {i}" for i, name in zip(used, names, strict=True))
    material = np.concatenate([np.full(len(part[1]), used.index(part[3])) for part in parts]).astype(np.int64)
    looks, notes = gltf_looks(file, used)
    mesh = replace(mesh, material_names=names, face_material=material, looks=looks).noted(*notes)
    if all(part[2] is None for part in parts):
        return mesh
    uv = np.concatenate([np.zeros((len(part[0]), 2)) if part[2] is None else part[2] for part in parts])
    # The origin of glTF's texture coordinates is at the upper left.
    return replace(mesh, uv=np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), uv_faces=corner)
