"""Writes GLB files by hand: static meshes, clips as morph targets, and the body as a skinned mesh.

glTF's axes are ours (right-handed, y up, facing +z) and its unit is the metre. A draped clip has no
skeleton that could reproduce it, so frame i is the morph target i - 1 of frame 0 and its weight is
one at its time; between frames players interpolate linearly. The body is skinned with its four
heaviest bones per vertex, which is what players support (the shipped body's fifth and sixth weights
sum to at most 0.034).
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.garment.cache import Garment
from drape.geometry import meshes
from drape.geometry.rotations import rotvec_to_quaternion

GENERATOR = "drape"
_COMPONENTS = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963
GARMENT_COLOURS = ((0.18, 0.42, 0.72, 1.0), (0.62, 0.17, 0.19, 1.0), (0.16, 0.38, 0.26, 1.0), (0.40, 0.28, 0.55, 1.0))
BODY_COLOUR = (0.80, 0.70, 0.63, 1.0)


class GlbFile:
    """A GLB file that grows: arrays go into one buffer, everything else into the JSON part."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": GENERATOR},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._buffer = bytearray()

    def add(self, key: str, value: dict[str, Any]) -> int:
        """Appends ``value`` to the list ``key`` and returns its index."""
        rows = self.json.setdefault(key, [])
        rows.append(value)
        return len(rows) - 1

    def array(self, array: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """The accessor of ``array`` (N, ...); positions and times need ``bounds``."""
        array = np.ascontiguousarray(array)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": array.nbytes}
        if target is not None:
            view["target"] = target
        self._buffer += array.tobytes()
        self._buffer += b"\0" * (-len(self._buffer) % 4)
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view),
            "componentType": _COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": _SHAPES[array.shape[1:]],
        }
        if bounds:
            rows = array.reshape(len(array), -1)
            accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        return self.add("accessors", accessor)

    def node(self, value: dict[str, Any]) -> int:
        """A node at the top of the scene."""
        index = self.add("nodes", value)
        self.json["scenes"][0]["nodes"].append(index)
        return index

    def place(self, name: str, point: np.ndarray) -> None:
        """Puts all that stands at the top of the scene under one node at ``point`` [m], which JSON holds in float64.

        Skinned meshes stay at the top: they go where their joints are.
        """
        top = self.json["scenes"][0]["nodes"]
        skinned = [index for index in top if "skin" in self.json["nodes"][index]]
        children = [index for index in top if index not in skinned]
        placed = self.add("nodes", {"name": name, "translation": point.tolist(), "children": children})
        self.json["scenes"][0]["nodes"] = [placed, *skinned]

    def material(self, name: str, colour: tuple[float, float, float, float]) -> int:
        surface = {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.85}
        return self.add("materials", {"name": name, "doubleSided": True, "pbrMetallicRoughness": surface})

    def to_bytes(self) -> bytes:
        """The file: header, JSON chunk, binary chunk."""
        self.json["buffers"] = [{"byteLength": len(self._buffer)}]
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self._buffer)
        head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON")
        return b"".join([head, text, struct.pack("<I4s", len(self._buffer), b"BIN\0"), bytes(self._buffer)])


@dataclass(frozen=True, eq=False)
class Corners:
    """A mesh whose vertices are split where texture coordinates have a seam.

    ``source`` (N,) is the delivered vertex of each row, ``faces`` (F, 3) index the rows, ``uv`` (N, 2) or None.
    """

    source: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None


def split_seams(garment: Garment) -> Corners:
    """Rows for the file: every (vertex, uv) pair once, the delivered order kept for the first of each vertex."""
    if not garment.uv_faces.size:
        return Corners(np.arange(garment.vertex_count), garment.faces.astype(np.int64), None)
    pairs = np.stack([garment.faces.reshape(-1), garment.uv_faces.reshape(-1)], axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    first = np.ones(len(unique), dtype=bool)
    first[1:] = unique[1:, 0] != unique[:-1, 0]
    place = np.empty(len(unique), dtype=np.int64)
    place[first] = unique[first, 0]
    place[~first] = garment.vertex_count + np.arange((~first).sum())
    source = np.concatenate([np.arange(garment.vertex_count), unique[~first, 0]])
    uv = np.zeros((len(source), 2))
    uv[place] = garment.uv[unique[:, 1]]
    uv[:, 1] = 1.0 - uv[:, 1]  # glTF counts v from the top
    return Corners(source, place[inverse.reshape(-1)].reshape(-1, 3), uv)


def vertex_normals(frames: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (F, V, 3) float32; straight up where a vertex has no face."""
    normals = meshes.vertex_normals(frames, faces)
    normals[np.linalg.norm(normals, axis=-1) < 0.5] = (0.0, 1.0, 0.0)
    return normals.astype(np.float32)


def add_garment(
    file: GlbFile,
    garment: Garment,
    frames: np.ndarray,
    fps: float,
    colour: tuple[float, float, float, float] = GARMENT_COLOURS[0],
) -> None:
    """The garment at ``frames`` (F, V, 3) [m], animated if there are several."""
    corners = split_seams(garment)
    frames = frames.astype(np.float32)
    normals = vertex_normals(frames, garment.faces)[:, corners.source]
    positions = frames[:, corners.source]
    attributes = {
        "POSITION": file.array(positions[0], target=_VERTEX_BUFFER, bounds=True),
        "NORMAL": file.array(normals[0], target=_VERTEX_BUFFER),
    }
    if corners.uv is not None:
        attributes["TEXCOORD_0"] = file.array(corners.uv.astype(np.float32), target=_VERTEX_BUFFER)
    targets = [
        {
            "POSITION": file.array(positions[i] - positions[0], target=_VERTEX_BUFFER, bounds=True),
            "NORMAL": file.array(normals[i] - normals[0], target=_VERTEX_BUFFER),
        }
        for i in range(1, len(frames))
    ]
    primitives = []
    names = garment.material_names or (garment.name,)
    for index, name in enumerate(names):
        chosen = corners.faces[garment.face_material == index] if garment.material_names else corners.faces
        if len(chosen) == 0:
            continue
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": file.array(_indices(chosen, len(corners.source)), target=_INDEX_BUFFER),
            "material": file.material(name, colour),
        }
        if targets:
            primitive["targets"] = targets
        primitives.append(primitive)
    mesh: dict[str, Any] = {"name": garment.name, "primitives": primitives}
    if targets:
        mesh["weights"] = [0.0] * len(targets)
    node = file.node({"name": garment.name, "mesh": file.add("meshes", mesh)})
    if targets:
        weights = np.eye(len(frames), dtype=np.float32)[:, 1:]
        _animate(file, _times(file, len(frames), fps), [(node, "weights", weights.reshape(-1))])


def add_body(
    file: GlbFile,
    body: BodyModel,
    betas: np.ndarray,
    poses: np.ndarray | None = None,
    trans: np.ndarray | None = None,
    fps: float = 30.0,
) -> None:
    """The body of shape ``betas`` with its 24 joints as a skeleton, moving if ``poses`` and ``trans`` are given."""
    rest, joints = body.rest_vertices(betas), body.rest_joints(betas)
    first = len(file.json["nodes"])
    for joint, (name, parent) in enumerate(zip(JOINT_NAMES, PARENTS, strict=True)):
        offset = joints[joint] - (joints[parent] if parent >= 0 else 0.0)
        node: dict[str, Any] = {"name": name, "translation": offset.tolist()}
        children = [first + child for child, other in enumerate(PARENTS) if other == joint]
        if children:
            node["children"] = children
        file.add("nodes", node)
    file.json["scenes"][0]["nodes"].append(first)
    binds = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
    binds[:, 3, :3] = -joints  # column-major: the translation is the last row as stored
    bones, weights = heaviest_bones(body)
    attributes = {
        "POSITION": file.array(rest.astype(np.float32), target=_VERTEX_BUFFER, bounds=True),
        "NORMAL": file.array(vertex_normals(rest[None], body.faces)[0], target=_VERTEX_BUFFER),
        "JOINTS_0": file.array(bones, target=_VERTEX_BUFFER),
        "WEIGHTS_0": file.array(weights, target=_VERTEX_BUFFER),
    }
    primitive = {
        "attributes": attributes,
        "indices": file.array(_indices(body.faces, body.vertex_count), target=_INDEX_BUFFER),
        "material": file.material("body", BODY_COLOUR),
    }
    skin = file.add(
        "skins",
        {
            "joints": [first + joint for joint in range(len(joints))],
            "skeleton": first,
            "inverseBindMatrices": file.array(binds),
        },
    )
    file.node(
        {"name": body.name, "mesh": file.add("meshes", {"name": body.name, "primitives": [primitive]}), "skin": skin}
    )
    if poses is None or trans is None:
        return
    wxyz = rotvec_to_quaternion(np.asarray(poses, dtype=np.float64))
    # A quaternion and its negative turn alike, but players interpolate between them the long way round.
    for frame in range(1, len(wxyz)):
        wxyz[frame] *= np.where((wxyz[frame] * wxyz[frame - 1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    xyzw = np.roll(wxyz, -1, axis=-1).astype(np.float32)
    channels = [(first + joint, "rotation", xyzw[:, joint]) for joint in range(len(joints))]
    channels.append((first, "translation", (joints[0] + trans).astype(np.float32)))
    _animate(file, _times(file, len(poses), fps), channels)


def heaviest_bones(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """The four heaviest bones of each vertex, uint8 (V, 4), and their weights, float32, summing to one."""
    order = np.argsort(-body.weights, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(body.weights, order, axis=1)
    weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    return np.where(weights > 0.0, order, 0).astype(np.uint8), weights


def _times(file: GlbFile, count: int, fps: float) -> int:
    return file.array((np.arange(count) / fps).astype(np.float32), bounds=True)


def _animate(file: GlbFile, times: int, channels: list[tuple[int, str, np.ndarray]]) -> None:
    """Adds ``channels`` (node, path, values per time) to the file's one animation."""
    if "animations" not in file.json:
        file.json["animations"] = [{"name": "drape", "channels": [], "samplers": []}]
    animation = file.json["animations"][0]
    for node, path, values in channels:
        sampler = {"input": times, "output": file.array(values), "interpolation": "LINEAR"}
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}})
        animation["samplers"].append(sampler)


def _indices(faces: np.ndarray, count: int) -> np.ndarray:
    """Flat indices; 16 bits where they suffice (65535 is reserved)."""
    return faces.reshape(-1).astype(np.uint16 if count < 65535 else np.uint32)
