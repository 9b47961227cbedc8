"""Laws of the posed body: rest pose, rigid motion, skin weights, joints, shape and pose blend shapes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import body_from_arrays
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import BodyError, MotionError
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from tests.drape.body.body_files import smpl_arrays
from tests.fixtures.garments import default_body
from tests.fixtures.laws import each

EXACT = 1e-12
REST = np.zeros((1, JOINT_COUNT, 3))


@pytest.fixture
def poses(rng):
    return 0.5 * rng.normal(size=(3, JOINT_COUNT, 3))


@pytest.fixture
def betas(rng):
    return rng.normal(size=10)


@pytest.fixture
def small(rng):
    """A random body with pose blend shapes."""
    return body_from_arrays(smpl_arrays(rng, posedirs=True), name="small", digest="")


def test_rest_pose_returns_the_template(betas):
    body = default_body()
    assert_allclose(body.posed_vertices(REST)[0], body.v_template, rtol=0.0, atol=EXACT)
    assert_allclose(body.posed_vertices(REST, None, betas)[0], body.rest_vertices(betas), rtol=0.0, atol=EXACT)


def test_skinning_commutes_with_rigid_motion(poses, betas, rng):
    body = default_body()
    turn, shift = rotvec_to_matrix(rng.normal(size=3)), rng.normal(size=3)
    trans = rng.normal(size=(3, 3))
    root = body.rest_joints(betas)[0]
    moved = poses.copy()
    moved[:, 0] = matrix_to_rotvec(turn @ rotvec_to_matrix(poses[:, 0]))
    # The root joint turns about itself: what the motion does to its place goes into the translation.
    moved_trans = (root + trans) @ turn.T + shift - root
    want = body.posed_vertices(poses, trans, betas) @ turn.T + shift
    assert_allclose(body.posed_vertices(moved, moved_trans, betas), want, rtol=0.0, atol=EXACT)


def test_turning_one_joint_moves_only_what_hangs_on_it():
    body, poses = default_body(), REST.copy()
    elbow = JOINT_NAMES.index("left_elbow")
    poses[0, elbow] = [0.0, 0.0, 1.0]
    below = {elbow}
    for joint, parent in enumerate(PARENTS):
        if parent in below:
            below.add(joint)
    moved = np.linalg.norm(body.posed_vertices(poses)[0] - body.v_template, axis=1) > 1e-9
    hangs = body.weights[:, sorted(below)].sum(axis=1)
    assert moved.any()
    assert not (moved & (hangs == 0.0)).any()


def test_bones_are_rotations_that_leave_the_joints_connected(poses, betas, rng):
    body, trans = default_body(), rng.normal(size=(3, 3))
    rotations, translations = body.bones(poses, trans, betas)
    square = rotations @ np.swapaxes(rotations, -1, -2)
    assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), rtol=0.0, atol=EXACT)
    joints = body.rest_joints(betas)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        ends = [(rotations[:, bone] @ joints[joint]) + translations[:, bone] for bone in (joint, parent)]
        assert_allclose(ends[0], ends[1], rtol=0.0, atol=EXACT)


def test_every_joint_is_a_weighted_mean_of_vertices():
    regressor = default_body().regressor
    assert (regressor.data >= 0.0).all()
    assert_allclose(np.asarray(regressor.sum(axis=1)).ravel(), 1.0, rtol=0.0, atol=1e-6)


def test_joints_are_regressed_from_the_shaped_template(betas):
    body = default_body()
    for shape in (None, betas, 3.0 * np.eye(10)[2]):
        assert_allclose(body.rest_joints(shape), body.regressor @ body.rest_vertices(shape), rtol=0.0, atol=EXACT)


def test_shape_is_linear(betas, rng):
    body, other = default_body(), rng.normal(size=10)
    for rest in (body.rest_vertices, body.rest_joints):
        zero = rest(None)
        want = 2.0 * (rest(betas) - zero) - 0.5 * (rest(other) - zero)
        assert_allclose(rest(2.0 * betas - 0.5 * other) - zero, want, rtol=0.0, atol=EXACT)
        assert_allclose(rest(np.zeros(10)), zero, rtol=0.0, atol=0.0)


def test_missing_shape_entries_are_zero(betas):
    body = default_body()
    assert_array_equal(body.check_betas(betas[:3]), np.append(betas[:3], np.zeros(7)))
    assert_array_equal(body.check_betas(np.zeros(0)), np.zeros(10))
    padded = np.where(np.arange(10) < 3, betas, 0.0)
    assert_array_equal(body.rest_vertices(betas[:3]), body.rest_vertices(padded))


def test_bone_directions_are_unit_and_leaves_repeat_their_parents():
    directions = default_body().bone_directions
    assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0.0, atol=EXACT)
    joints = default_body().joints_template
    for joint, end in enumerate(BONE_ENDS):
        if end < 0:
            assert_array_equal(directions[joint], directions[PARENTS[joint]])
        else:
            assert directions[joint] @ (joints[end] - joints[joint]) > 0.0


def test_body_stands_upright_faces_the_front_and_spreads_its_arms():
    joints = dict(zip(JOINT_NAMES, default_body().joints_template, strict=True))
    assert joints["head"][1] > joints["pelvis"][1] > joints["left_ankle"][1]
    assert joints["left_foot"][2] > joints["left_ankle"][2]
    assert joints["left_wrist"][0] > joints["left_shoulder"][0] > 0.0 > joints["right_wrist"][0]


def test_pose_blend_shapes_are_added_before_skinning(small, poses):
    rotations, translations = small.bones(poses)
    offset = (rotvec_to_matrix(poses)[:, 1:] - np.eye(3)).reshape(3, -1)
    for frame in range(3):
        rest = small.v_template + small.posedirs @ offset[frame]
        by_bone = np.einsum("jab,vb->jva", rotations[frame], rest) + translations[frame][:, None]
        want = np.einsum("vj,jva->va", small.weights, by_bone)
        assert_allclose(small.posed_vertices(poses)[frame], want, rtol=0.0, atol=EXACT)


def test_counts_are_those_of_the_arrays(small):
    assert (small.vertex_count, small.shape_count) == (60, 10)
    assert small.posed_vertices(np.zeros((0, JOINT_COUNT, 3))).shape == (0, 60, 3)


GOOD = np.zeros((3, JOINT_COUNT, 3))
AT_ODDS = GOOD.copy()
AT_ODDS[1, 2, 0] = np.inf
REFUSED = {
    **{
        f"betas {bad.shape}": (lambda body, bad=bad: body.rest_vertices(bad), BodyError, "at most 10 numbers")
        for bad in (np.zeros(11), np.zeros((1, 10)), np.array(1.0))
    },
    "betas nan": (lambda body: body.rest_joints(np.array([0.0, np.nan])), BodyError, "betas: expected finite"),
    "many betas": (lambda body: body.rest_joints(np.zeros((3, 11))), BodyError, "betas: expected shape"),
    **{
        f"poses {shape}": (lambda body, s=shape: body.bones(np.zeros(s)), MotionError, "poses: expected shape")
        for shape in ((24, 3), (1, 52, 3), (1, 72))
    },
    "poses inf": (lambda body: body.bones(AT_ODDS), MotionError, r"poses: expected finite.*\(1, 2, 0\)"),
    **{
        f"trans {shape}": (lambda body, s=shape: body.bones(GOOD, np.zeros(s)), MotionError, "trans: expected shape")
        for shape in ((3,), (1, 3), (3, 2))
    },
    "trans nan": (lambda body: body.bones(GOOD, np.full((3, 3), np.nan)), MotionError, "trans: expected finite"),
}


@each(case=REFUSED)
def test_what_no_body_can_take_is_refused_by_its_name(small, case):
    pose, error, message = case
    with pytest.raises(error, match=message):
        pose(small)
