"""Laws of the joint descriptors: blind to heading, zero when still, the same for numpy and torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.body import features
from drape.body.features import joint_rotations
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.geometry import rotations
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import matrix_to_sixd, rotvec_to_matrix
from tests.fixtures.garments import default_body

EXACT = 1e-12
DT_S = 1.0 / 30.0


@pytest.fixture
def local(rng):
    """Local rotations (5, 24, 3, 3) of five poses."""
    return rotvec_to_matrix(0.5 * rng.normal(size=(5, JOINT_COUNT, 3)))


def world(local):
    return forward_kinematics(local, default_body().joints_template, PARENTS)


def turned(local, turn):
    root = turn @ local[..., :1, :, :]
    return np.concatenate([root, local[..., 1:, :, :]], axis=-3)


def test_static_features_are_the_rotation_and_gravity_in_the_joints_frame(local):
    rotations = world(local)[0]
    got = features.static_features(local, rotations)
    assert got.shape == (5, JOINT_COUNT, features.STATIC_PER_JOINT)
    assert features.feature_count() == JOINT_COUNT * features.STATIC_PER_JOINT
    assert_array_equal(got[:, 1:, :6], matrix_to_sixd(local[:, 1:]))
    assert_array_equal(got[:, 0, :6], np.tile([1.0, 0.0, 0.0, 0.0, 1.0, 0.0], (5, 1)))
    down = np.einsum("fjab,fjb->fja", rotations, got[..., 6:])
    assert_allclose(down, np.broadcast_to([0.0, -1.0, 0.0], down.shape), rtol=0.0, atol=EXACT)


def kinematics(local, moved=0.0):
    rotations, joints = world(local)
    return features.Kinematics(features.static_features(local, rotations), joints + moved, rotations)


@pytest.mark.parametrize("times_s", [(2 * DT_S, DT_S, 0.0), (0.05, 0.03, 0.0)])
def test_dynamic_features_of_a_falling_body_are_gravity_in_the_joints_frame(local, times_s):
    at = kinematics(local)
    now, before, earlier = (at.joints - 0.5 * 9.81 * t * t * np.array([0.0, 1.0, 0.0]) for t in times_s)
    dt_s, dt_before_s = -np.diff(times_s)
    got = features.dynamic_features(at.static, at.static, (now, before, earlier), at.rotations, dt_s, dt_before_s)
    assert_allclose(got[..., 9:], 9.81 * at.static[..., 6:], rtol=0.0, atol=1e-9)
    assert_array_equal(got[..., :9], np.zeros((5, JOINT_COUNT, 9)))


@pytest.mark.parametrize(("pace_m_s", "rounding"), [(0.0, 0.0), (1.0, 1e-9)])
def test_dynamic_features_of_a_body_that_stands_or_glides_are_zero(local, rng, pace_m_s, rounding):
    at, step = kinematics(local), pace_m_s * rng.normal(size=3) * DT_S
    track = at.joints + 2 * step, at.joints + step, at.joints
    got = features.dynamic_features(at.static, at.static, track, at.rotations, DT_S)
    assert_allclose(got, np.zeros((5, JOINT_COUNT, features.DYNAMIC_PER_JOINT)), rtol=0.0, atol=rounding)


def test_dynamic_features_ignore_the_heading_and_count_in_seconds(local):
    def dynamic(local, dt_s):
        at = kinematics(local)
        track = (at.joints[2:], at.joints[1:-1], at.joints[:-2])  # at t, t - dt, t - 2 dt
        return features.dynamic_features(at.static[2:], at.static[1:-1], track, at.rotations[2:], dt_s)

    want = dynamic(local, DT_S)
    heading = rotvec_to_matrix(np.array([0.0, 1.1, 0.0]))
    assert_allclose(dynamic(turned(local, heading), DT_S), want, rtol=0.0, atol=1e-8)
    slower = dynamic(local, 2.0 * DT_S)
    assert_allclose(slower[..., :9], 0.5 * want[..., :9], rtol=1e-12, atol=1e-9)
    assert_allclose(slower[..., 9:], 0.25 * want[..., 9:], rtol=1e-12, atol=1e-9)


def test_numpy_and_torch_agree(local):
    rotations, joints = world(local)
    as_torch = [torch.from_numpy(np.ascontiguousarray(x)) for x in (local, rotations, joints)]
    static = features.static_features(local, rotations)
    static_torch = features.static_features(as_torch[0], as_torch[1])
    assert_allclose(static_torch.numpy(), static, rtol=0.0, atol=EXACT)
    track, track_torch = ((x, 0.9 * x, 0.7 * x) for x in (joints, as_torch[2]))
    want = features.dynamic_features(static, 0.5 * static, track, rotations, DT_S)
    got = features.dynamic_features(static_torch, 0.5 * static_torch, track_torch, as_torch[1], DT_S)
    assert_allclose(got.numpy(), want, rtol=1e-12, atol=1e-9)


def test_motion_features_take_times_per_body(local):
    now, before, earlier = (kinematics(local, way) for way in (0.3, 0.1, 0.0))
    dt_s, dt_before_s = np.linspace(0.01, 0.05, 5), np.linspace(0.04, 0.02, 5)
    got = features.motion_features(now, before, earlier, dt_s, dt_before_s)
    for i in range(5):
        one = features.motion_features(now[i], before[i], earlier[i], dt_s[i], dt_before_s[i])
        assert_array_equal(got[i], one)
        joints = (now.joints[i], before.joints[i], earlier.joints[i])
        want = features.dynamic_features(
            now.static[i], before.static[i], joints, now.rotations[i], dt_s[i], dt_before_s[i]
        )
        assert_array_equal(one[..., 9:], want[..., 9:])
        acceleration = (0.2 / dt_s[i] - 0.1 / dt_before_s[i]) / (0.5 * (dt_s[i] + dt_before_s[i]))
        assert_allclose(np.linalg.norm(one[:, 9:], axis=-1), np.sqrt(3.0) * abs(acceleration), rtol=1e-9, atol=0.0)


def test_rounding_is_no_motion(local):
    now, before, dt_s = kinematics(local), kinematics(local, 1e-13), np.full(5, 1.0 / 240.0)
    track = now.joints, before.joints, now.joints
    plain = features.dynamic_features(now.static, now.static, track, now.rotations, 1.0 / 240.0)
    assert 0.0 < np.abs(plain).max() < features.STILL
    got = features.motion_features(now, before, now, dt_s, dt_s)
    assert_array_equal(got, np.zeros((5, JOINT_COUNT, features.DYNAMIC_PER_JOINT)))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, np.pi, 40.0, 1e4])
def test_rotations_of_joints_are_those_of_the_readable_formulas(angle: float):
    poses = angle * np.random.default_rng(1).normal(size=(2, 24, 3))
    quaternions, matrices = joint_rotations(poses)
    rounding = 1e-14 + angle * np.finfo(np.float64).eps  # of the angle itself
    assert_allclose(quaternions, rotations.rotvec_to_quaternion(poses), rtol=0.0, atol=rounding)
    assert_allclose(matrices, rotations.rotvec_to_matrix(poses), rtol=0.0, atol=2.0 * rounding)
