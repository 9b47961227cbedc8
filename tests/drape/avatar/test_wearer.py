"""A character as a wearer: its T-pose, its body, its rig; stored and read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.avatar import wearer as wearers
from drape.avatar.body_fit import target_joints
from drape.avatar.character import character_in
from drape.avatar.mapping import map_joints
from drape.avatar.t_pose import to_t_pose
from drape.avatar.wearer import Wearer, load_wearer, main, read_wearer, save_wearer, wearer_name
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import ArtifactError, BodyError, MotionError, NotFound
from drape.files.gltf import GltfFile
from drape.geometry.closest import closest_point, nearest_vertices
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.motion.rig_poses import poses_to_rig
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.poses import random_motion

BETAS = np.array([1.0, -1.5, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
LIMBS = [JOINT_NAMES.index(f"left_{joint}") for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]


@pytest.fixture(scope="module")
def worn(body: BodyModel) -> Wearer:
    """Our body in another shape, in an A-pose, in centimetres, facing -z."""
    payload = character(body, betas=BETAS, vrm="0", arms_rad=ARMS_DOWN_RAD, scale=100.0, yaw_rad=np.pi)
    return read_wearer(payload, name="somebody", body=body)


def test_a_character_in_an_a_pose_comes_to_the_t_pose(body: BodyModel):
    payload = character(body, arms_rad=ARMS_DOWN_RAD, yaw_rad=np.pi)
    found = character_in(GltfFile(payload))
    pose = to_t_pose(found, map_joints(found, body).rig)
    rest = body.v_template - [0.0, body.v_template[:, 1].min(), 0.0]
    distance, _ = nearest_vertices(pose.vertices, rest)
    # The arms of the body itself are not level to a degree: at a wrist, 0.6 m out, that is a centimetre.
    assert np.median(distance) < 2e-3 and distance.max() < 0.03
    assert pose.scale == 1.0 and pose.height_m == pytest.approx(np.ptp(body.v_template[:, 1]), abs=0.01)


def test_our_body_in_another_shape_is_found(worn: Wearer, body: BodyModel):
    assert worn.median_mm < 2.5 and worn.p95_mm < 10.0
    assert worn.scale == 0.01 and worn.vrm == "0"
    assert worn.height_m == pytest.approx(np.ptp(body.rest_vertices(BETAS)[:, 1]), abs=0.02)
    lengths = [np.linalg.norm(np.diff(joints[LIMBS[:3]], axis=0), axis=1) for joints in (
        worn.body.joints_template, body.rest_joints(BETAS))]  # fmt: skip
    assert_allclose(*lengths, atol=1e-3)


def test_its_body_has_the_characters_joints_and_moves_like_it(worn: Wearer, body: BodyModel):
    assert_allclose(worn.body.joints_template[0], body.joints_template[0], atol=1e-9)
    assert_allclose(np.asarray(worn.body.regressor.sum(axis=1)), 1.0, atol=1e-9)
    assert not worn.body.shapedirs.any() and worn.body.standard_digest == body.digest
    poses, trans = random_motion(3, spread_rad=0.2)
    skin, surface = worn.body.posed_vertices(poses, trans), worn.posed(poses, trans)
    limbs = worn.weights[:, LIMBS[:3]].sum(axis=1) > 0.9
    for frame in range(len(poses)):
        distance = closest_point(surface[frame][limbs], skin[frame], body.faces).distance
        assert np.median(distance) < 3e-3


def test_poses_of_its_own_rig_are_ours(worn: Wearer):
    poses, _ = random_motion(4, spread_rad=0.2)
    poses[:, [22, 23]] = 0.0  # hands have no bones of their own
    quaternions = poses_to_rig(worn.rig, poses)
    back, trans = worn.from_rig(quaternions[..., [1, 2, 3, 0]], None)
    turn = rotvec_to_matrix(back) @ np.swapaxes(rotvec_to_matrix(poses), -1, -2)
    angle = 2.0 * np.arccos(np.clip(np.abs(matrix_to_quaternion(turn)[..., 0]), 0.0, 1.0))
    assert np.degrees(angle).mean() < 1.0
    # The pelvis is where it is in the file, in metres: the body comes there.
    place = worn.body.joints_template[0] + trans[0]
    assert_allclose(place, worn.scale * worn.rig.rest_positions[worn.rig.sources["pelvis"]], atol=1e-9)


@pytest.mark.parametrize("sent", [np.zeros((2, 5, 4)), [[[0.0, 0.0, 0.0, 1.0]], []], np.zeros((3, 4))])
def test_other_numbers_of_quaternions_are_refused(worn: Wearer, sent: np.ndarray):
    with pytest.raises(MotionError, match="nodes"):
        worn.from_rig(sent, None)


def test_it_is_stored_and_read_again(worn: Wearer, body: BodyModel, tmp_path: Path):
    assert (worn.found_by, worn.confidence, worn.notes) == ("vrm", 1.0, ())
    worn = replace(worn, found_by="shape", confidence=0.8, notes=("upside down",))
    path = save_wearer(worn, tmp_path)
    again = load_wearer(path, body)
    assert (again.found_by, again.confidence, again.notes) == ("shape", 0.8, ("upside down",))
    assert path.name == worn.file_name() == again.file_name()
    assert (again.joints, again.nodes, again.scale, again.vrm) == (worn.joints, worn.nodes, worn.scale, worn.vrm)
    assert_array_equal(again.body.joints_template, worn.body.joints_template)
    assert_array_equal(again.rig.alignment, worn.rig.alignment)
    assert again.body.digest == worn.body.digest


def test_a_damaged_file_or_that_of_another_body_is_refused(worn: Wearer, body: BodyModel, tmp_path: Path):
    path = save_wearer(worn, tmp_path)
    with pytest.raises(ArtifactError, match="another body"):
        load_wearer(path, worn.body)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ArtifactError, match="a stored avatar"):
        load_wearer(path, body)


# --- what is told, and what is refused ---


def test_a_joint_that_is_told_counts(body: BodyModel):
    found = character_in(GltfFile(character(body)))
    told = {"spine3": "mixamorig:Spine1"}
    rig = map_joints(found, body, joints=told).rig
    assert found.names[rig.sources["spine3"]] == "mixamorig:Spine1"
    with pytest.raises(NotFound, match="joint"):
        map_joints(found, body, joints={"tail": "mixamorig:Spine1"})
    with pytest.raises(NotFound, match="a node"):
        map_joints(found, body, joints={"spine3": "Spine9"})


def test_bones_of_no_person_are_refused(body: BodyModel):
    def all_on_one(document: dict) -> None:
        for number, node in enumerate(document["nodes"]):
            node["name"] = "leg"
            if number < len(JOINT_NAMES):
                node["children"] = list(range(1, len(JOINT_NAMES))) if number == 0 else []

    with pytest.raises(MotionError, match="a person's joints"):
        read_wearer(character(body, change=all_on_one), name="table", body=body)


def test_limbs_of_no_person_are_refused(body: BodyModel):
    def stretched(document: dict) -> None:
        knee = document["nodes"][JOINT_NAMES.index("left_knee")]
        knee["translation"] = [0.0, -0.01, 0.0]
        document["nodes"][JOINT_NAMES.index("left_ankle")]["translation"] = [0.0, -0.01, 0.0]

    with pytest.raises(BodyError, match="leg"):
        read_wearer(character(body, change=stretched), name="duck", body=body)


def test_a_body_that_does_not_fit_is_refused(body: BodyModel, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(wearers, "FIT_LIMIT_MM", 0.0)
    with pytest.raises(BodyError, match="ours fits"):
        read_wearer(character(body), name="ghost", body=body)


def test_joints_that_a_rig_lacks_lie_as_ours_do(body: BodyModel):
    template = body.joints_template
    found = template.copy()
    for name in ("spine1", "spine2", "spine3", "left_collar", "right_collar", "head", "left_foot", "right_foot"):
        found[JOINT_NAMES.index(name)] = np.nan
    assert_allclose(target_joints(found, template), template, atol=1e-9)
    found[[JOINT_NAMES.index(f"{side}_wrist") for side in ("left", "right")]] = np.nan
    assert_allclose(target_joints(found, template), template, atol=1e-9)
    assert_allclose(target_joints(1.3 * found + 0.2, template), 1.3 * template + 0.2, atol=1e-9)


def test_a_name_is_one_for_a_file():
    assert wearer_name("Mé & You (2)") == "m_you_2"
    assert wearer_name("@@@") == "avatar"


def test_the_command_line_tells_and_stores(body: BodyModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "Me.glb"
    path.write_bytes(character(body, scheme="unreal"))
    assert main([str(path), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "thigh_l" in said and "fit" in said and list(tmp_path.glob("me-*.npz"))
    assert "joints by names, 100 % sure" in said
    path.write_bytes(b"no character")
    assert main([str(path)]) == 2
