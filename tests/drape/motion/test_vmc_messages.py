"""Poses of VMC are those of the person whose bones were told, in Unity's axes and with any of its optional bones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.grounding import leg_length
from drape.motion.samples import SAMPLES
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX
from drape.motion.vmc_messages import BONE, ROOT, VmcPoses
from tests.drape.motion.vmc_sender import OPTIONAL, messages

CLIP = SAMPLES["turn"]()
FRAME = 60
TURNED = Rotation.from_euler("y", 40, degrees=True)


def told(**more) -> VmcPoses:
    poses = VmcPoses()
    for address, values in messages(CLIP.poses[FRAME], CLIP.trans[FRAME], **more):
        assert poses.take(address, values)
    return poses


def test_bones_are_the_pose_that_they_were_told_of():
    found = told().pose()
    assert found is not None
    pose, pelvis = found
    assert_allclose(rotvec_to_matrix(pose), rotvec_to_matrix(CLIP.poses[FRAME]), atol=1e-6)
    assert_allclose(pelvis * leg_length(CANONICAL_JOINTS), CLIP.trans[FRAME], atol=1e-6)


def test_the_root_turns_and_moves_all():
    found = told(root=(TURNED, np.array([1.0, 0.0, 2.0]))).pose()
    assert found is not None
    pose, pelvis = found
    expected = TURNED.as_matrix() @ rotvec_to_matrix(CLIP.poses[FRAME, 0])
    assert_allclose(rotvec_to_matrix(pose[0]), expected, atol=1e-6)
    place = TURNED.apply(np.array(CLIP.trans[FRAME])) + np.array([1.0, 0.0, 2.0])
    assert_allclose(pelvis * leg_length(CANONICAL_JOINTS), place, atol=1e-6)


def test_a_left_arm_that_is_raised_in_unity_is_raised_at_the_left():
    poses = VmcPoses()
    for address, values in messages(np.zeros((24, 3)), np.zeros(3)):
        poses.take(address, values)
    # There the left hand is at -x: R takes -x to y.
    raised = Rotation.from_matrix([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).as_quat()
    poses.take(BONE, ["LeftUpperArm", 0.0, 0.0, 0.0, *raised.tolist()])
    found = poses.pose()
    assert found is not None
    expected = np.zeros((24, 3))
    expected[JOINT_INDEX["left_shoulder"], 2] = np.pi / 2
    assert_allclose(found[0], expected, atol=1e-9)


@pytest.mark.parametrize("missing", [("Chest",), ("UpperChest",), OPTIONAL])
def test_optional_bones_may_be_missing(missing: tuple[str, ...]):
    poses = VmcPoses()
    for address, values in messages(np.zeros((24, 3)), np.zeros(3), missing=missing):
        poses.take(address, values)
    found = poses.pose()
    assert found is not None
    assert_allclose(found[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("needed", ["Hips", "Spine", "LeftFoot", "RightLowerArm"])
def test_there_is_no_pose_without_what_a_person_needs(needed: str):
    assert told(missing=(needed,)).pose() is None
    assert told(missing=(needed,)).placed(CANONICAL_JOINTS) is None


def test_steps_are_those_of_the_legs_of_the_body():
    joints = 1.1 * CANONICAL_JOINTS + [0.0, 0.3, 0.0]
    found = told().placed(joints)
    assert found is not None
    assert_allclose(found[1] + joints[0], 1.1 * CLIP.trans[FRAME], atol=1e-6)


@pytest.mark.parametrize(
    ("address", "values"),
    [
        ("/VMC/Ext/OK", [1]),
        (BONE, []),
        (BONE, ["LeftThumbProximal", *[0.0] * 6, 1.0]),
        (BONE, ["Hips", *[0.0] * 5, 1.0]),
        (BONE, ["Hips", *[0.0] * 7]),
        (BONE, ["Hips", float("nan"), *[0.0] * 5, 1.0]),
        (BONE, ["Hips", *[0.0] * 5, float("inf"), 1.0]),
        (BONE, ["Hips", *["0"] * 7]),
        (ROOT, ["root", *[0.0] * 6, 9.0]),
    ],
)
def test_what_is_no_bone_is_left_out(address: str, values: list):
    poses = told()
    before, count = poses.pose(), poses.count
    assert not poses.take(address, values) and poses.count == count
    after = poses.pose()
    assert before is not None and after is not None
    assert_allclose(after[0], before[0], atol=0)
