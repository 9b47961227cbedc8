"""Garments on a character's own rig as a GLB: skinned and morphed they are where they were draped, on its own nodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.file_skeleton import FileRig, load_file_rig
from drape.avatar.rig_file import Dressed, add_dressed, add_nodes
from drape.avatar.rig_motion import RigClip
from drape.avatar.wearer import Wearer, read_wearer, save_wearer
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import BodyError
from drape.export.glb_file import GlbFile
from drape.files.gltf import GltfFile
from drape.garment.cache import Garment
from drape.geometry.rotations import rotvec_to_matrix
from tests.drape.garment.files.test_looks import GENERATED, whole
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.poses import random_motion

COLOUR = (0.2, 0.4, 0.7, 1.0)
FRAMES = 5


def strange(document: dict[str, Any]) -> None:
    """A node with a matrix, an end below a toe that a second skin has alone, and a lamp beside the armature."""
    nodes = document["nodes"]
    knee = nodes[JOINT_NAMES.index("left_knee")]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotvec_to_matrix(np.array([0.0, 0.3, 0.0])), knee.pop("translation")
    knee["matrix"] = matrix.T.reshape(-1).tolist()
    nodes[JOINT_NAMES.index("left_foot")]["children"] = [len(nodes)]
    places = document["meshes"][0]["primitives"][0]["attributes"]
    document["meshes"].append({"primitives": [{"mode": 0, "attributes": places}]})
    nodes += [{"name": "toe end", "translation": [0.0, 0.0, 0.1]}, {"name": "points", "mesh": 1, "skin": 1}]
    nodes += [{"name": "lamp", "camera": 0}]
    document["skins"].append({"joints": [len(nodes) - 3]})
    document["scenes"][0]["nodes"] += [len(nodes) - 2, len(nodes) - 1]


@pytest.fixture(scope="module")
def payload(body: BodyModel) -> bytes:
    """Our body in an A-pose that is not its bind pose, in centimetres, facing -z, under an armature."""
    return character(body, arms_rad=ARMS_DOWN_RAD, scale=100.0, yaw_rad=np.pi, change=strange)


@pytest.fixture(scope="module")
def worn(payload: bytes, body: BodyModel) -> Wearer:
    return read_wearer(payload, name="somebody", body=body)


@pytest.fixture(scope="module")
def stored(worn: Wearer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_wearer(worn, tmp_path_factory.mktemp("stored"))


@pytest.fixture(scope="module")
def read(stored: Path) -> FileRig:
    """The rig as it is stored: nobody reads the file again."""
    return load_file_rig(stored)


@pytest.fixture(scope="module")
def draped(tube: Garment) -> np.ndarray:
    """A tube that goes its own way, far from where joints would take it."""
    wave = np.linspace(0.0, 1.0, FRAMES)[:, None, None]
    return (tube.vertices[None] * (1.0 + 0.2 * wave) + [0.3, 0.0, 3.0] * wave).astype(np.float32)


@pytest.fixture(scope="module")
def moves(worn: Wearer) -> RigClip:
    poses, trans = random_motion(FRAMES, spread_rad=0.9)
    return RigClip(*worn.to_rig(poses, trans), 30.0)


def written(draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig, **more: bool) -> bytes:
    file = GlbFile()
    add_dressed(file, add_nodes(file, read.skeleton), [Dressed(tube, draped, COLOUR)], moves, worn, read, **more)
    return file.to_bytes()


@pytest.mark.parametrize("quantised", [True, False])
def test_skinned_and_morphed_it_is_where_it_was_draped(
    draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig, quantised: bool
):
    file = Reader(written(draped, tube, moves, worn, read, quantised=quantised))
    shown = file.skinned(FRAMES)[:, : tube.vertex_count] * worn.scale
    assert np.abs(shown - draped).max() < 5e-6  # float32 of five metres in centimetres
    assert len(file.json["meshes"][0]["primitives"][0]["targets"]) == FRAMES
    assert file.json["meshes"][0]["weights"] == [0.0] * FRAMES  # at rest without targets


def test_nodes_are_those_of_the_file(
    payload: bytes, draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig
):
    own, file = Reader(payload).json, Reader(written(draped, tube, moves, worn, read))
    names = [node["name"] for node in file.json["nodes"]]
    assert "toe end" in names and "Armature" in names and "lamp" not in names and "points" not in names
    assert [file.json["nodes"][top]["name"] for top in file.json["scenes"][0]["nodes"]] == ["Armature", tube.name]
    for node in own["nodes"]:
        if node["name"] not in names or "mesh" in node:
            continue
        found = file.json["nodes"][names.index(node["name"])]
        below = [[of[child]["name"] for child in one.get("children", ())] for of, one in (
            (own["nodes"], node), (file.json["nodes"], found))]  # fmt: skip
        assert below[0] == below[1]
        for key in ("translation", "rotation", "scale"):
            if key in node:
                assert_allclose(found[key], node[key], atol=1e-12)
    joints = [names[joint] for joint in file.json["skins"][0]["joints"]]
    assert joints == [*(own["nodes"][joint]["name"] for joint in own["skins"][0]["joints"]), "toe end"]
    binds, found = own["skins"][0]["inverseBindMatrices"], file.array(file.json["skins"][0]["inverseBindMatrices"])
    assert_allclose(found[:-1], GltfFile(payload).array(binds).reshape(-1, 4, 4), atol=0)
    # The joint of the second skin is bound as if it were of the first: at rest it takes the surface where the toe does.
    skeleton = read.skeleton
    rest = skeleton.world(skeleton.moves[None], skeleton.turns[None])[0][skeleton.joints] @ np.swapaxes(found, -1, -2)
    assert_allclose(rest[-1], rest[JOINT_NAMES.index("left_foot")], atol=1e-5)


def test_the_rig_moves_as_the_poses_say(draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig):
    poses, trans = random_motion(FRAMES, spread_rad=0.9)
    file = Reader(written(draped, tube, moves, worn, read))
    names = [node["name"] for node in file.json["nodes"]]
    world = file.world(FRAMES) * worn.scale
    at = [worn.body.bones(poses, trans)[part] for part in (0, 1)]
    for joint in ("pelvis", "left_knee", "right_elbow", "left_wrist"):
        index = JOINT_NAMES.index(joint)
        place = np.einsum("fab,b->fa", at[0][:, index], worn.body.joints_template[index]) + at[1][:, index]
        found = world[:, names.index(worn.joints[joint]), :3, 3]
        # Trunks have joints elsewhere than ours, and what hangs on them lies beside by as much.
        assert np.abs(found - place).max() < (1e-6 if joint == "pelvis" else 0.03), joint


def test_without_targets_it_hangs_on_the_limbs_next_to_it(
    draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig
):
    file = Reader(written(draped, tube, moves, worn, read))
    held = file.json["meshes"][0]["primitives"][0]["attributes"]
    names = [file.json["nodes"][joint]["name"] for joint in file.json["skins"][0]["joints"]]
    bones, weights = file.array(held["JOINTS_0"]), file.array(held["WEIGHTS_0"])
    assert_allclose(weights.sum(axis=1), 1.0, atol=2e-7)
    heaviest = {names[bone] for bone in bones[:, 0]}
    assert heaviest <= {worn.joints[one] for one in JOINT_NAMES if one in worn.joints and "wrist" not in one}
    assert len(heaviest) > 2


def test_vertices_between_joints_that_turn_against_each_other_have_one(
    draped: np.ndarray, tube: Garment, worn: Wearer, read: FileRig
):
    poses = np.zeros((FRAMES, 24, 3))
    poses[:, JOINT_NAMES.index("spine1"), 1] = np.linspace(0.0, np.pi, FRAMES)  # a blend half-way is flat
    file = Reader(written(draped, tube, RigClip(*worn.to_rig(poses, np.zeros((FRAMES, 3))), 30.0), worn, read))
    shown = file.skinned(FRAMES)[:, : tube.vertex_count] * worn.scale
    assert np.abs(shown - draped).max() < 5e-6


def test_the_khronos_validator_has_no_complaint(
    draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig, tmp_path: Path
):
    for quantised in (True, False):
        assert khronos_complaints(written(draped, tube, moves, worn, read, quantised=quantised), tmp_path) == []


def test_a_garment_has_its_pictures_on_the_rig(
    draped: np.ndarray, tube: Garment, moves: RigClip, worn: Wearer, read: FileRig, tmp_path: Path
):
    dressed = replace(tube, looks=replace(whole().looks, materials=whole().looks.materials * len(tube.material_names)))
    for quantised in (True, False):
        content = written(draped, dressed, moves, worn, read, quantised=quantised)
        # Normals without tangents are the viewer's to make.
        assert {one["code"] for one in khronos_complaints(content, tmp_path)} == {GENERATED}
        material = Reader(content).json["materials"][0]
        assert ("baseColorTexture" in material["pbrMetallicRoughness"]) == bool(len(tube.uv))


def test_a_rig_that_is_not_stored_or_damaged_is_refused(worn: Wearer, stored: Path, tmp_path: Path):
    cut = tmp_path / "cut.npz"
    cut.write_bytes(stored.read_bytes()[:-300])
    for path in (save_wearer(replace(worn, file=None), tmp_path), cut, tmp_path / "none.npz"):
        with pytest.raises(BodyError, match="stored with its rig"):
            load_file_rig(path)
