"""Small garments and the files that hold them, for the tests of intake."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.avatars import Avatar
from drape.garment.cloth_layer import join_sheets
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import check_surface, place_on_avatar
from drape.garment.rest_mesh import RestMesh, rest_mesh
from drape.geometry import mesh_graphs, meshes
from tests.drape.cloth.cloth_shapes import tube

TORSO = [JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")]
SLEEVES = [JOINT_NAMES.index(name) for name in ("left_shoulder", "right_shoulder")]
# The tube that small files hold.
FACES = tube(10, 3)[1]
VERTICES = tube(10, 3)[0].astype(np.float32).astype(np.float64)
UV = np.random.default_rng(3).random((len(VERTICES), 2)).astype(np.float32)


def at_rest(mesh: GarmentMesh, avatar: Avatar, body: BodyModel, *, carriers: tuple[str, ...] | None = None) -> RestMesh:
    """The delivered ``mesh`` of a named ``avatar`` at rest on ``body``."""
    sheets = place_on_avatar(check_surface(join_sheets(mesh)), avatar)
    return rest_mesh(mesh, sheets, avatar, body, carriers=carriers)


def shirt(body: BodyModel, skin: np.ndarray, *, ease_m: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A shirt cut from the body's own faces, ``ease_m`` off the ``skin`` (V, 3): vertices (N, 3), faces (F, 3)."""
    covered = body.weights[:, TORSO + SLEEVES].sum(axis=1) > 0.6
    joints = body.joints_template
    low = joints[JOINT_NAMES.index("pelvis"), 1] - 0.02
    covered &= (body.v_template[:, 1] > low) & (body.v_template[:, 1] < joints[JOINT_NAMES.index("neck"), 1] - 0.02)
    faces = body.faces[covered[body.faces].all(axis=1)]
    label = mesh_graphs.connected_components(faces, body.vertex_count)
    faces = faces[label[faces[:, 0]] == np.bincount(label[faces.reshape(-1)]).argmax()]
    used, inverse = np.unique(faces, return_inverse=True)
    lifted = skin + ease_m * meshes.vertex_normals(skin, body.faces)
    return lifted[used], inverse.reshape(-1, 3)


def skirt(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """A cone round both thighs of the standard body."""
    hips = body.joints_template[JOINT_NAMES.index("left_hip")]
    around, rows = 40, 13
    unit, faces = tube(around, rows, radius_m=1.0, height_m=1.0)
    down = 1.0 - unit[:, 1:2]
    radius = 0.2 + 0.1 * rows / (rows + 1) * down
    middle = np.array([0.0, hips[1] + 0.08, 0.02])
    return radius * unit * [1.0, 0.0, 1.0] + middle - 0.04 * rows * down * [0.0, 1.0, 0.0], faces


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """An OBJ of triangles."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    return "\n".join(lines).encode()


def stl_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary STL."""
    record = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = vertices[faces]
    return b"\0" * 80 + struct.pack("<I", len(faces)) + record.tobytes()


def ply_bytes(vertices: np.ndarray, faces: np.ndarray, *, declared: int | None = None) -> bytes:
    """A binary PLY that declares ``declared`` vertices."""
    count = len(vertices) if declared is None else declared
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    table = np.zeros(len(faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    table["n"], table["v"] = 3, faces
    return header.encode() + vertices.astype("<f4").tobytes() + table.tobytes()


def glb_bytes(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None = None, *, change=None) -> bytes:
    """A GLB with one node; ``change`` edits the document before it is written."""
    arrays = [vertices.astype("<f4"), faces.astype("<u4").reshape(-1)] + ([] if uv is None else [uv.astype("<f4")])
    kinds = [("VEC3", 5126), ("SCALAR", 5125), ("VEC2", 5126)]
    views, accessors, binary = [], [], b""
    for array, (kind, component) in zip(arrays, kinds, strict=False):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(accessors), "componentType": component, "count": len(array), "type": kind})
        binary += array.tobytes()
    attributes = {"POSITION": 0} | ({} if uv is None else {"TEXCOORD_0": 2})
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "materials": [{"name": "denim"}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    if change is not None:
        change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def as_gltf(payload: bytes, *, inside: bool) -> tuple[bytes, bytes]:
    """A GLB as a glTF and its binary, which is a data address where it is to be ``inside``."""
    length = int.from_bytes(payload[12:16], "little")
    document, binary = json.loads(payload[20 : 20 + length]), payload[28 + length :]
    address = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = address if inside else "the%20coat.bin"
    return json.dumps(document).encode(), binary
