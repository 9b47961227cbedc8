"""GLB files hold what they were given: read back with a reader of the tests' own, and with pygltflib."""

from __future__ import annotations

import dataclasses
import json
import struct

import numpy as np
import pygltflib
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.garment.cache import Garment
from drape.geometry import rigid
from drape.geometry.rotations import quaternion_to_matrix
from service import glb
from tests.fixtures.poses import random_motion

TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": (), "VEC2": (2,), "VEC3": (3,), "VEC4": (4,), "MAT4": (4, 4)}


class Reader:
    """The JSON part and the arrays of a GLB, checked on the way."""

    def __init__(self, content: bytes) -> None:
        magic, version, size = struct.unpack_from("<4sII", content)
        assert (magic, version, size) == (b"glTF", 2, len(content))
        length, kind = struct.unpack_from("<I4s", content, 12)
        assert kind == b"JSON" and length % 4 == 0
        self.json = json.loads(content[20 : 20 + length])
        bin_length, kind = struct.unpack_from("<I4s", content, 20 + length)
        assert kind == b"BIN\0" and bin_length % 4 == 0
        self.binary = content[28 + length :]
        assert len(self.binary) == bin_length == self.json["buffers"][0]["byteLength"]

    def array(self, index: int) -> np.ndarray:
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        shape = (accessor["count"], *WIDTHS[accessor["type"]])
        dtype = TYPES[accessor["componentType"]]
        array = np.frombuffer(self.binary, dtype, int(np.prod(shape)), view["byteOffset"]).reshape(shape)
        assert array.nbytes == view["byteLength"]
        if "min" in accessor:
            rows = array.reshape(len(array), -1)
            assert_allclose(rows.min(0), accessor["min"], rtol=0, atol=0)
            assert_allclose(rows.max(0), accessor["max"], rtol=0, atol=0)
        return array

    def channel(self, node: int, path: str) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and values of one animated property."""
        (animation,) = self.json["animations"]
        (found,) = (c for c in animation["channels"] if c["target"] == {"node": node, "path": path})
        sampler = animation["samplers"][found["sampler"]]
        assert sampler["interpolation"] == "LINEAR"
        return self.array(sampler["input"]), self.array(sampler["output"])


def clip(tube: Garment, frames: int = 5) -> np.ndarray:
    wave = np.linspace(0.0, 1.0, frames)[:, None, None]
    return (tube.vertices[None] * (1.0 + 0.2 * wave) + [0.0, 0.0, 3.0] * wave).astype(np.float32)


def written(tube: Garment, frames: np.ndarray, fps: float = 30.0) -> Reader:
    file = glb.GlbFile()
    glb.add_garment(file, tube, frames, fps)
    return Reader(file.to_bytes())


def test_seams_split_vertices_and_nothing_else(tube: Garment):
    corners = glb.split_seams(tube)
    assert_array_equal(corners.source[:216], np.arange(216))
    assert len(corners.source) == 216 + 9  # one copy of each vertex of the seam
    assert_array_equal(corners.source[corners.faces], tube.faces)
    flipped = tube.uv[tube.uv_faces] * [1, -1] + [0, 1]
    assert corners.uv is not None
    assert_allclose(corners.uv[corners.faces], flipped, rtol=0, atol=1e-7)


def test_a_mesh_without_texture_coordinates_stays_as_it_is(tube: Garment):
    bare = dataclasses.replace(tube, uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))
    corners = glb.split_seams(bare)
    assert corners.uv is None
    assert_array_equal(corners.faces, tube.faces)
    assert "TEXCOORD_0" not in written(bare, clip(tube)).json["meshes"][0]["primitives"][0]["attributes"]


def test_every_keyframe_is_its_frame(tube: Garment):
    frames = clip(tube)
    file = written(tube, frames, fps=24.0)
    source = glb.split_seams(tube).source
    (node,) = (i for i, n in enumerate(file.json["nodes"]) if n.get("mesh") == 0)
    times, weights = file.channel(node, "weights")
    assert_allclose(times, np.arange(5) / 24.0, rtol=1e-6, atol=0)
    weights = weights.reshape(5, 4)
    for primitive in file.json["meshes"][0]["primitives"]:
        base = file.array(primitive["attributes"]["POSITION"])
        normals = file.array(primitive["attributes"]["NORMAL"])
        moves = np.stack([file.array(target["POSITION"]) for target in primitive["targets"]])
        turns = np.stack([file.array(target["NORMAL"]) for target in primitive["targets"]])
        shown = base + np.einsum("ft,tva->fva", weights, moves)
        assert_allclose(shown, frames[:, source], rtol=0, atol=1e-6)
        lengths = np.linalg.norm(normals + np.einsum("ft,tva->fva", weights, turns), axis=-1)
        assert_allclose(lengths, 1.0, rtol=0, atol=1e-5)


def test_materials_keep_their_names_and_faces(tube: Garment):
    file = written(tube, clip(tube, 1))
    assert [material["name"] for material in file.json["materials"]] == ["cotton", "trim"]
    assert "animations" not in file.json
    source = glb.split_seams(tube).source
    for index, primitive in enumerate(file.json["meshes"][0]["primitives"]):
        faces = source[file.array(primitive["indices"])].reshape(-1, 3)
        assert_array_equal(faces, tube.faces[tube.face_material == index])


def test_a_vertex_without_faces_gets_a_normal(tube: Garment):
    lone = dataclasses.replace(
        tube, faces=tube.faces[:-2], uv_faces=tube.uv_faces[:-2], face_material=tube.face_material[:-2]
    )
    file = written(lone, clip(tube, 1))
    normals = file.array(file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-5)


def test_the_skeleton_moves_the_body(tube: Garment, body: BodyModel):
    poses, trans = random_motion(4, spread_rad=0.6)
    betas = np.full(10, 0.5)
    content = glb.GlbFile()
    glb.add_body(content, body, betas, poses, trans, 30.0)
    file = Reader(content.to_bytes())
    (skin,) = file.json["skins"]
    names = [file.json["nodes"][joint]["name"] for joint in skin["joints"]]
    assert names == list(JOINT_NAMES)
    # The file's own forward kinematics, by its nodes.
    offsets = np.array([file.json["nodes"][joint]["translation"] for joint in skin["joints"]])
    xyzw = np.stack([file.channel(joint, "rotation")[1] for joint in skin["joints"]], axis=1)
    root = file.channel(skin["joints"][0], "translation")[1]
    local = quaternion_to_matrix(np.roll(xyzw.astype(np.float64), 1, axis=-1))
    joints = np.zeros((24, 3))
    for joint, parent in enumerate(PARENTS):
        joints[joint] = offsets[joint] + (joints[parent] if parent >= 0 else 0.0)
    rotations, places = rigid.forward_kinematics(local, np.broadcast_to(joints, (4, 24, 3)), PARENTS)
    places = places + (root - joints[0])[:, None]
    (primitive,) = file.json["meshes"][0]["primitives"]
    rest = file.array(primitive["attributes"]["POSITION"])
    bones, weights = (file.array(primitive["attributes"][key]) for key in ("JOINTS_0", "WEIGHTS_0"))
    binds = file.array(skin["inverseBindMatrices"])
    bound = rest[:, None] + binds[bones][..., 3, :3]
    moved = np.einsum("fvkab,vkb->fvka", rotations[:, bones], bound) + places[:, bones]
    shown = np.einsum("vk,fvka->fva", weights, moved)
    # Four bones of at most six: what is left out sums to 0.034 at most.
    assert np.abs(shown - body.posed_vertices(poses, trans, betas)).max() < 0.01
    assert np.median(np.abs(shown - body.posed_vertices(poses, trans, betas))) < 1e-6
    # Neighbouring keys are never on opposite sides of the sphere.
    assert (np.sum(xyzw[1:] * xyzw[:-1], axis=-1) >= 0.0).all()


def test_foreign_readers_open_it(tube: Garment, body: BodyModel, tmp_path):
    file = glb.GlbFile()
    glb.add_garment(file, tube, clip(tube), 30.0)
    poses, trans = random_motion(5)
    glb.add_body(file, body, np.zeros(10), poses, trans, 30.0)
    path = tmp_path / "both.glb"
    path.write_bytes(file.to_bytes())
    read = pygltflib.GLTF2().load(str(path))
    assert read is not None and len(read.animations) == 1 and len(read.skins) == 1
    scene = trimesh.load_scene(path)
    assert {"tube", body.name} <= {name.split("_")[0] if name.startswith("tube") else name for name in scene.geometry}


@pytest.mark.parametrize(("count", "dtype"), [(65534, np.uint16), (65535, np.uint32)])
def test_indices_are_as_wide_as_they_must(count: int, dtype: type):
    assert glb._indices(np.zeros((1, 3), int), count).dtype == dtype
