"""A character's file as it is read, and every fault of a stranger's file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.avatar import character as reading
from drape.avatar.character import character_in
from drape.avatar.mapping import map_joints
from drape.avatar.t_pose import to_t_pose
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.export.glb_body import heaviest_bones
from drape.files import gltf
from drape.geometry.closest import nearest_vertices
from drape.geometry.skinning import skin_points
from tests.fixtures.characters import character, with_json

Change = Callable[[dict[str, Any]], None]


def test_the_surface_is_where_nodes_put_it(body: BodyModel):
    found = character_in(gltf.GltfFile(character(body, arms_rad=0.8, scale=0.01, yaw_rad=np.pi)))
    pose = np.zeros((24, 3))
    pose[16, 2], pose[17, 2] = -0.8, 0.8
    bones = body.bones(pose[None])
    # The file has the four heaviest weights of six.
    index, weight = heaviest_bones(body)
    weights = np.zeros_like(body.weights)
    np.add.at(weights, (np.arange(len(weights))[:, None], index), weight)
    posed = skin_points(body.v_template[None], weights, *bones)[0]
    turned = 0.01 * posed @ Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix().T
    assert len(found.vertices) <= body.vertex_count and found.faces.max() < len(found.vertices)
    distance, _ = nearest_vertices(found.vertices, turned)
    assert distance.max() < 1e-7  # float32 of a metre, a hundredth of it
    assert_allclose(np.asarray(found.weights.sum(axis=1)), 1.0, atol=1e-6)


def test_nodes_come_after_their_parents_under_their_own_names(body: BodyModel):
    found = character_in(gltf.GltfFile(character(body, scheme="unreal")))
    assert all(parent < node for node, parent in enumerate(found.parents))
    assert found.names.index("Armature") < found.names.index("pelvis") and "thigh_l" in found.names
    knee = found.names.index("calf_l")
    assert_allclose(found.places[knee], body.joints_template[JOINT_NAMES.index("left_knee")], atol=1e-6)


@pytest.mark.parametrize("version", ["0", "1"])
def test_bones_of_vrm_name_nodes(body: BodyModel, version: str):
    found = character_in(gltf.GltfFile(character(body, vrm=version)))
    assert found.vrm == version
    assert found.names[found.humanoid["leftUpperLeg"]] == "bone left_hip"


def test_plates_that_hang_on_bones_count_for_the_height_and_a_hat_does_not(body: BodyModel):
    """A robot whose hands alone are skinned is as tall as its plates."""
    found = character_in(gltf.GltfFile(character(body)))
    rig = map_joints(found.skinned, body, label="me").rig
    height = found.vertices[found.faces][:, :, 1]
    whole, top = np.ptp(found.vertices[:, 1]), height.max() - 0.1
    for hung, told in ((height.max(axis=1) < 0.3, whole), (height.min(axis=1) > top, whole - 0.1)):
        assert_allclose(to_t_pose(replace(found, hung=hung), rig).height_m, told, atol=0.02)


def test_vertices_that_were_split_for_texture_are_one(body: BodyModel):
    payload = character(body)
    whole = character_in(gltf.GltfFile(payload))

    def split(document: dict[str, Any]) -> None:
        mesh = document["meshes"][0]
        mesh["primitives"] = mesh["primitives"] * 2  # the same surface twice, vertex on vertex

    assert len(character_in(gltf.GltfFile(with_json(payload, split))).vertices) == len(whole.vertices)


def test_sparse_and_normalised_numbers_are_read(body: BodyModel):
    file = gltf.GltfFile(character(body))
    view = file.document.accessors[0]["bufferView"]
    sparse = {"count": 2, "indices": {"bufferView": view, "componentType": 5121}, "values": {"bufferView": view}}
    file.document.accessors.append({"componentType": 5126, "type": "SCALAR", "count": 300, "sparse": sparse})
    raw = np.frombuffer(file._rows(view, 0, 1, 12, np.uint8), np.uint8)
    wanted = np.zeros(300, np.float32)
    wanted[raw[:2]] = file._rows(view, 0, 2, 1, np.float32)[:, 0]
    assert_allclose(file.array(len(file.document.accessors) - 1)[:, 0], wanted)
    byte = {"componentType": 5121, "type": "VEC4", "count": 3, "bufferView": view, "normalized": True}
    file.document.accessors.append(byte)
    assert_allclose(file.array(len(file.document.accessors) - 1), raw.reshape(3, 4) / 255.0)


# --- refusals ---


def two_parents(document: dict[str, Any]) -> None:
    document["nodes"].append({"children": [1]})


def own_parent(document: dict[str, Any]) -> None:
    last = len(document["nodes"])
    document["nodes"] += [{"children": [last + 1]}, {"children": [last]}]


def no_skin(document: dict[str, Any]) -> None:
    for node in document["nodes"]:
        node.pop("skin", None)


FAULTS: dict[str, tuple[Change, str]] = {
    "no skin": (no_skin, "surface that a skeleton moves"),
    "two parents": (two_parents, "under two"),
    "a ring": (own_parent, "in a ring"),
    "a child that is not there": (
        lambda j: j["nodes"][0].update(children=[9999]),
        "nodes[0].children: expected an index of nodes below",
    ),
    "no list": (lambda j: j.update(meshes=7), "meshes: expected a valid list, got 7"),
    "a flat node": (lambda j: j["nodes"][1].update(scale=[0, 0, 0]), "can be undone"),
    "a transform of words": (
        lambda j: j["nodes"][1].update(translation=["a", 0, 0]),
        "nodes[1].translation[0]: expected a valid number",
    ),
    "a huge accessor": (lambda j: j["accessors"][0].update(count=10**12), "1,000,000,000 vertices"),
    "a strange type": (lambda j: j["accessors"][0].update(type=["VEC3"]), "numbers of a known type"),
    "beyond the buffer": (lambda j: j["bufferViews"][0].update(byteOffset=10**9), "expected at most"),
    "a negative offset": (lambda j: j["bufferViews"][0].update(byteOffset=-4), "whole numbers"),
    "another file": (lambda j: j["buffers"][0].update(uri="body.bin"), "bytes in the file or beside it"),
    "an extension": (lambda j: j.update(extensionsRequired=["ACME_unknown"]), "extensionsRequired: expected no"),
    "too many nodes": (lambda j: j["nodes"].extend([{}] * 5000), "nodes: expected at most 4096 items, got a list of"),
    "no joints": (lambda j: j["skins"][0].update(joints=[]), "1 to 400 joints"),
    "few binds": (lambda j: j["skins"][0].update(joints=j["skins"][0]["joints"][:3]), "(3, 16)"),
    "an entry that is no object": (lambda j: j["nodes"].__setitem__(3, 5), "nodes[3]: expected a valid dictionary"),
    "a VRM without bones": (lambda j: j.update(extensions={"VRM": {}}), "extensions.VRM.humanoid: expected a value"),
    "a VRM whose bones are a list": (
        lambda j: j.update(extensions={"VRMC_vrm": {"humanoid": {"humanBones": []}}}),
        "humanBones: expected a valid dictionary, got a list of 0",
    ),
    "a VRM of other nodes": (
        lambda j: j.update(extensions={"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 999}}}}}),
        "humanBones",
    ),
    "weights of other vertices": (
        lambda j: j["meshes"][0]["primitives"][0]["attributes"].update(WEIGHTS_0=0),
        "fit together",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_file_with_a_fault_is_refused(body: BodyModel, fault: str):
    change, said = FAULTS[fault]
    with pytest.raises(MeshError, match=re.escape(said)):
        character_in(gltf.GltfFile(with_json(character(body), change)))


def spoilt_sparse(**sparse: Any) -> Change:
    whole = {"count": 2, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}} | sparse
    return lambda j: j["accessors"][0].update(sparse=whole)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda j: j["accessors"][0].update(sparse={}), "count, indices and values"),
        (spoilt_sparse(count=10**9), "whole indices"),
        (spoilt_sparse(), "indices below"),
    ],
)
def test_sparse_parts_that_lead_elsewhere_are_refused(body: BodyModel, change: Change, said: str):
    with pytest.raises(MeshError, match=said):
        character_in(gltf.GltfFile(with_json(character(body), change)))


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "a GLB or VRM file"),
        (b"glTF" + bytes(30), "whole GLB 2.0"),
        (b"glTF\x02\0\0\0\x20\0\0\0\x04\0\0\0ABCD" + bytes(12), "JSON first"),
        (b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0JSON{{{{", "can be read"),
        (b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0JSON[  ]", "JSON: expected a valid dictionary"),
        (b"glTF\x02\0\0\0\x22\0\0\0\x04\0\0\0JSON{  }\xff\xff\0\0BIN\0ab", "whole binary chunk"),
    ],
)
def test_bytes_that_are_no_glb_are_refused(payload: bytes, said: str):
    with pytest.raises(MeshError, match=said):
        gltf.GltfFile(payload)


def test_a_file_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gltf, "FILE_BYTES", 4 * 2**20)
    with pytest.raises(MeshError, match="at most 4 MB"):
        gltf.GltfFile(bytes(5 * 2**20))


def test_numbers_that_are_none_are_refused(body: BodyModel):
    file = gltf.GltfFile(character(body))
    start = file.document.buffer_views[0].get("byteOffset", 0)
    file._binary = file._binary[:start] + np.float32(np.nan).tobytes() + file._binary[start + 4 :]
    with pytest.raises(MeshError, match="finite"):
        file.array(0)


def test_meshes_that_are_too_large_or_move_by_too_many_joints_are_refused(
    body: BodyModel, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(reading, "MOST_VERTICES", 1000)
    with pytest.raises(MeshError, match="100 to 1,000 vertices"):
        character_in(gltf.GltfFile(character(body)))
    monkeypatch.undo()
    payload = character(body)
    monkeypatch.setattr(reading, "MOST_JOINTS", 20)
    with pytest.raises(MeshError, match="1 to 20 joints"):
        character_in(gltf.GltfFile(payload))
    with pytest.raises(MeshError, match="at most 20 joints, got 24"):  # of several skins together
        reading._check_joints(scipy.sparse.csr_matrix(np.eye(24)), "me")
