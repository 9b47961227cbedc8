"""The least turn between two directions, and what a skeleton's rest pose is worth."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.body.skeleton import JOINT_COUNT
from drape.errors import MotionError
from drape.geometry.rotations import matrix_to_rotvec
from drape.motion.alignment import least_turn, rest_alignment, world_joint_rotations
from drape.motion.t_pose import BONE_DIRECTIONS, CANONICAL_JOINTS, JOINT_INDEX

EXACT = 1e-12


def units(rng, *shape):
    vectors = rng.normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_the_least_turn_brings_start_to_end_by_the_angle_between_them(rng):
    start, end = units(rng, 4, 1), units(rng, 4, 5)
    turn = least_turn(start, end, np.eye(3))
    assert_allclose((turn @ np.broadcast_to(start, end.shape)[..., None])[..., 0], end, rtol=0.0, atol=EXACT)
    angle = np.linalg.norm(matrix_to_rotvec(turn), axis=-1)
    assert_allclose(np.cos(angle), np.sum(start * end, axis=-1), rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("start", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
def test_a_half_turn_is_a_turn_too_and_none_is_none(start, rng):
    start, frame = np.array(start), Rotation.random(rng=rng).as_matrix()
    half = least_turn(start, -start, frame)
    assert_allclose(half @ start, -start, rtol=0.0, atol=EXACT)
    assert_allclose(half @ half.T, np.eye(3), rtol=0.0, atol=EXACT)
    assert_allclose(np.linalg.det(half), 1.0, rtol=0.0, atol=EXACT)
    assert_allclose(least_turn(start, start, frame), np.eye(3), rtol=0.0, atol=0.0)


def test_a_turned_rest_pose_is_worth_its_turn_and_only_named_bones_are_measured():
    turn = Rotation.from_rotvec([0.2, -1.1, 0.4]).as_matrix()
    rest = CANONICAL_JOINTS @ turn.T
    limbs = {"left_shoulder": "left_elbow", "left_hip": "left_knee"}
    got = rest_alignment(rest, JOINT_INDEX, directions=BONE_DIRECTIONS, ends=limbs, label="rig")
    assert_allclose(got, np.tile(turn, (JOINT_COUNT, 1, 1)), rtol=0.0, atol=EXACT)


def test_a_joint_that_is_missing_goes_with_its_parent(rng):
    rotations = Rotation.random(2, rng=rng).as_matrix()[None]
    alignment = Rotation.random(JOINT_COUNT, rng=rng).as_matrix()
    got = world_joint_rotations(rotations, {"pelvis": 0, "left_hip": 1}, alignment)
    assert_allclose(got[:, JOINT_INDEX["left_hip"]], rotations[:, 1] @ alignment[1], rtol=0.0, atol=EXACT)
    assert_allclose(got[:, JOINT_INDEX["left_foot"]], got[:, JOINT_INDEX["left_hip"]], rtol=0.0, atol=0.0)
    assert_allclose(got[:, JOINT_INDEX["head"]], got[:, 0], rtol=0.0, atol=0.0)


def test_hips_along_the_trunk_are_refused():
    rest = CANONICAL_JOINTS.copy()
    rest[[JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]] = [0.0, 0.1, 0.0], [0.0, -0.1, 0.0]
    with pytest.raises(MotionError, match="rig: skeleton: expected hips beside a trunk"):
        rest_alignment(rest, JOINT_INDEX, directions=BONE_DIRECTIONS, label="rig", up=np.array([0.0, 1.0, 0.0]))
