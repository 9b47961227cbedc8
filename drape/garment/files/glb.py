"""Reads the triangles of a binary glTF 2.0 file; declared counts are compared with the bytes first."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from drape.errors import MeshError
from drape.garment.files.mesh import GarmentMesh, check_count, mesh_fault, plain_mesh, weld
from drape.geometry.rotations import quaternion_to_matrix

NODE_LIMIT = 4096
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_INERT_EXTENSIONS = frozenset({"KHR_texture_transform", "KHR_mesh_quantization"})


def read_glb(payload: bytes, *, name: str, vertex_limit: int) -> GarmentMesh:
    """The default scene's triangles in world axes; vertices at the same place become one, uv stay per corner."""
    return _GlbReader(payload, name, vertex_limit).read()


class _GlbReader:
    """A glTF document and its binary chunk."""

    def __init__(self, payload: bytes, name: str, vertex_limit: int) -> None:
        self.name, self.vertex_limit = name, vertex_limit
        self.document, self.binary = self.chunks(payload)

    def fault(self, expected: str, got: str, cure: str = "Export the mesh again.") -> MeshError:
        return mesh_fault(self.name, expected, got, cure)

    def chunks(self, payload: bytes) -> tuple[dict[str, Any], bytes]:
        if payload[:4] != b"glTF" or len(payload) < 20 or int.from_bytes(payload[4:8], "little") != 2:
            raise self.fault("a GLB of glTF 2.0", "another header")
        declared, length = int.from_bytes(payload[8:12], "little"), int.from_bytes(payload[12:16], "little")
        if declared != len(payload):
            raise self.fault(f"{declared:,} bytes as declared", f"{len(payload):,} bytes")
        if payload[16:20] != b"JSON" or 20 + length > len(payload):
            raise self.fault("a JSON chunk inside the file", f"a chunk of {length:,} bytes")
        try:
            document = json.loads(payload[20 : 20 + length])
        except (ValueError, RecursionError) as error:
            raise self.fault("a JSON chunk", str(error)) from error
        start = 20 + length
        binary = b""
        if start + 8 <= len(payload):
            size = int.from_bytes(payload[start : start + 4], "little")
            if payload[start + 4 : start + 8] != b"BIN\0" or start + 8 + size > len(payload):
                raise self.fault("a binary chunk inside the file", f"a chunk of {size:,} bytes")
            binary = payload[start + 8 : start + 8 + size]
        if not isinstance(document, dict):
            raise self.fault("a JSON object", type(document).__name__)
        return document, binary

    def read(self) -> GarmentMesh:
        try:
            return self.scene()
        except (KeyError, IndexError, TypeError, ValueError, OverflowError, AttributeError) as error:
            # Every index of the document is looked up unchecked above; here is the one place that says so.
            raise self.fault("a valid glTF document", f"{type(error).__name__}: {error}") from error

    def scene(self) -> GarmentMesh:
        required = set(self.document.get("extensionsRequired", [])) - _INERT_EXTENSIONS
        if required:
            raise self.fault("no required extensions", ", ".join(sorted(required)), "Export without compression.")
        nodes = self.document.get("nodes", [])
        if len(nodes) > NODE_LIMIT:
            raise self.fault(f"at most {NODE_LIMIT} nodes", str(len(nodes)))
        scenes = self.document.get("scenes") or [{"nodes": range(len(nodes))}]
        waiting = [(int(root), np.eye(4)) for root in scenes[self.document.get("scene", 0)].get("nodes", [])]
        parts: list[tuple] = []
        seen: set[int] = set()
        total = 0
        while waiting:
            number, above = waiting.pop(0)
            if number in seen:
                raise self.fault("nodes that form a tree", f"node {number} twice")
            seen.add(number)
            node = nodes[number]
            placed = above @ node_matrix(node)
            if "mesh" in node:
                for primitive in self.document["meshes"][node["mesh"]]["primitives"]:
                    parts.append(self.primitive(primitive, placed))
                    total += len(parts[-1][0])
                    check_count(self.name, total, 6 * self.vertex_limit)
            waiting += [(int(child), placed) for child in node.get("children", [])]
        if not parts:
            raise self.fault("a mesh in the scene", "none")
        return self.join(parts)

    def left_out(self) -> list[str]:
        """What of the file is not taken over, for its notes."""
        pictures = len(self.document.get("images", []))
        if not pictures:
            return []
        count = "a picture is" if pictures == 1 else f"{pictures} pictures are"
        return [f"warning: {count} left out: put the textures on again, materials keep their names and coordinates"]

    def primitive(self, primitive: dict[str, Any], placed: np.ndarray):
        if primitive.get("mode", 4) != 4:
            raise self.fault("triangles (mode 4)", f"mode {primitive['mode']}", "Triangulate the mesh.")
        attributes = primitive["attributes"]
        points = self.accessor(attributes["POSITION"], "VEC3")
        uv = self.accessor(attributes["TEXCOORD_0"], "VEC2") if "TEXCOORD_0" in attributes else None
        if uv is not None and len(uv) != len(points):
            raise self.fault(f"{len(points)} texture coordinates", str(len(uv)))
        index = (
            self.accessor(primitive["indices"], "SCALAR").astype(np.int64).reshape(-1)
            if "indices" in primitive
            else np.arange(len(points))
        )
        if len(index) % 3 or (len(index) and index.max() >= len(points)):
            raise self.fault(
                f"triples of indices below {len(points)}", f"{len(index)} indices up to {index.max(initial=0)}"
            )
        faces = index.reshape(-1, 3)
        if np.linalg.det(placed[:3, :3]) < 0:
            faces = faces[:, ::-1]  # a mirroring node turns its triangles
        return points @ placed[:3, :3].T + placed[:3, 3], faces, uv, primitive.get("material", -1)

    def accessor(self, number: int, kind: str) -> np.ndarray:
        accessor = self.document["accessors"][number]
        if accessor["type"] != kind or "sparse" in accessor or "bufferView" not in accessor:
            raise self.fault(
                f"a dense {kind} accessor with a buffer view", f"accessor {number}", "Export without sparse accessors."
            )
        view = self.document["bufferViews"][accessor["bufferView"]]
        if view.get("buffer", 0) != 0 or "uri" in self.document["buffers"][0]:
            raise self.fault("one embedded buffer", "an external buffer", "Export as a single GLB file.")
        count, width = int(accessor["count"]), _WIDTHS[kind]
        check_count(self.name, count // (6 if kind == "SCALAR" else 1), 6 * self.vertex_limit)
        dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
        stride = int(view.get("byteStride", dtype.itemsize * width))
        start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        end = start + (count - 1) * stride + dtype.itemsize * width if count else start
        if min(count, start) < 0 or stride < dtype.itemsize * width or end > len(self.binary):
            raise self.fault(f"{end:,} bytes for accessor {number} of {count:,} entries", f"{len(self.binary):,} bytes")
        values = np.ndarray(
            (count, width), dtype=dtype, buffer=self.binary, offset=start, strides=(stride, dtype.itemsize)
        )
        if kind == "SCALAR" or dtype.kind == "f":
            return values.astype(np.float64)
        numbers = values.astype(np.float64)
        return np.maximum(numbers / np.iinfo(dtype).max, -1.0) if accessor.get("normalized") else numbers

    def join(self, parts: list) -> GarmentMesh:
        starts = np.cumsum([0] + [len(part[0]) for part in parts])
        points = np.concatenate([part[0] for part in parts])
        corner = np.concatenate([part[1] + start for part, start in zip(parts, starts[:-1], strict=True)])
        mesh = weld(plain_mesh(self.name, points, corner))
        used = list(dict.fromkeys(part[3] for part in parts))
        listed = self.document.get("materials", [])
        names = tuple(str(listed[i].get("name", f"material {i}")) if i >= 0 else "default" for i in used)
        material = np.concatenate([np.full(len(part[1]), used.index(part[3])) for part in parts]).astype(np.int64)
        mesh = replace(mesh, material_names=names, face_material=material).noted(*self.left_out())
        if all(part[2] is None for part in parts):
            return mesh
        uv = np.concatenate([np.zeros((len(part[0]), 2)) if part[2] is None else part[2] for part in parts])
        # glTF's origin is at the upper left.
        return replace(mesh, uv=np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), uv_faces=corner)


def node_matrix(node: dict[str, Any]) -> np.ndarray:
    """The 4 x 4 transform of a glTF node (column-major matrix, or scale, rotation xyzw, translation)."""
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    placed = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    placed[:3, :3] = quaternion_to_matrix(np.array([w, x, y, z], dtype=np.float64)) * np.asarray(
        node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64
    )
    placed[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return placed
