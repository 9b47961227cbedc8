"""Poses and shapes that no person has: the drape stays finite and near the body, or the input is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.body.skeleton import JOINT_NAMES
from drape.errors import BodyError, MotionError
from drape.stages.batch import ANGLE_LIMIT_RAD, BETA_LIMIT, PLACE_LIMIT_M, motion_arrays, shape_array
from service.compute.drape_runtime import DrapeRuntime
from tests.extremes.frames import check_bounded, draped


def posed(**turns: tuple[float, float, float]) -> np.ndarray:
    """One pose (1, 24, 3) with these joints turned [rad]."""
    pose = np.zeros((1, 24, 3))
    for name, turn in turns.items():
        pose[0, JOINT_NAMES.index(name)] = turn
    return pose


NAMED = {
    "arms through the trunk": posed(left_shoulder=(0.0, -2.8, 0.0), right_shoulder=(0.0, 2.8, 0.0)),
    "legs through each other": posed(left_hip=(0.0, 0.0, -0.9), right_hip=(0.0, 0.0, 0.9)),
    "splits": posed(left_hip=(-np.pi / 2, 0.0, 0.0), right_hip=(np.pi / 2, 0.0, 0.0)),
    "side splits": posed(left_hip=(0.0, 0.0, np.pi / 2), right_hip=(0.0, 0.0, -np.pi / 2)),
    "headstand": posed(pelvis=(np.pi, 0.0, 0.0)),
    "folded in two": posed(spine1=(np.pi / 2, 0.0, 0.0), spine2=(np.pi / 2, 0.0, 0.0), spine3=(np.pi / 2, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", NAMED)
def test_a_body_that_goes_through_itself_keeps_its_garment(runtime: DrapeRuntime, name: str):
    """Guards against a push-out that runs away where no place is outside of the body."""
    check_bounded(runtime, draped(runtime, np.repeat(NAMED[name], 2, axis=0)))


@pytest.mark.parametrize("spread_rad", [0.5, np.pi, 50.0, ANGLE_LIMIT_RAD])
def test_poses_within_and_beyond_joint_limits(runtime: DrapeRuntime, spread_rad: float):
    """Guards against a network, a fold or a push that grows with what it has not seen in training."""
    poses = np.random.default_rng(5).uniform(-spread_rad, spread_rad, (8, 24, 3))
    check_bounded(runtime, draped(runtime, poses))


@pytest.mark.parametrize("turn_rad", [0.0, 1e-300, 1e-40, 1e-9, np.pi - 1e-9, np.pi, 2 * np.pi - 1e-9, 2 * np.pi])
def test_every_joint_next_to_none_half_and_a_whole_turn(runtime: DrapeRuntime, turn_rad: float):
    """Guards against frames that lose their axes there; what is next to no turn is the T-pose, to rounding."""
    axis = np.random.default_rng(6).normal(size=(24, 3))
    pose = turn_rad * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    batch = draped(runtime, pose[None], folds=0)
    check_bounded(runtime, batch)
    if min(turn_rad, abs(turn_rad - 2 * np.pi)) < 1e-8:
        still = draped(runtime, np.zeros((1, 24, 3)), folds=0)
        np.testing.assert_allclose(batch.vertices, still.vertices, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize("size", [5.0, BETA_LIMIT])
def test_shapes_far_from_the_mean(runtime: DrapeRuntime, size: float):
    """Guards against a body that turns inside out, whose samples have no outside."""
    generator = np.random.default_rng(7)
    for betas in (np.full(10, size), np.full(10, -size), generator.choice([-size, size], 10)):
        check_bounded(runtime, draped(runtime, generator.uniform(-0.5, 0.5, (3, 24, 3)), betas=betas))


@pytest.mark.parametrize("far_m", [1e4, PLACE_LIMIT_M])
def test_a_root_far_away_leaves_every_bit_of_the_drape(runtime: DrapeRuntime, far_m: float):
    """Guards against world coordinates in float32 anywhere between pose and message; motion is of differences."""
    poses = np.random.default_rng(8).uniform(-0.3, 0.3, (4, 24, 3))
    near = draped(runtime, poses, motion=0.0)
    far = draped(runtime, poses, trans=np.full((4, 3), far_m), motion=0.0)
    check_bounded(runtime, far)
    assert_array_equal(far.vertices, near.vertices)
    moving = [draped(runtime, poses, trans=np.full((4, 3), at)) for at in (0.0, far_m)]
    np.testing.assert_allclose(moving[1].vertices, moving[0].vertices, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1.001 * ANGLE_LIMIT_RAD])
def test_angles_that_are_none_are_refused_with_a_cure(value: float):
    poses = np.zeros((1, 24, 3))
    poses[0, 3, 1] = value
    with pytest.raises(MotionError, match=r"poses\[0\]\[3\]\[1\].*radians"):
        motion_arrays(poses.tolist(), None, max_frames=1)


def test_places_and_shapes_beyond_the_limits_are_refused_with_a_cure(runtime: DrapeRuntime):
    with pytest.raises(MotionError, match=r"trans\[0\]\[0\].*metres"):
        motion_arrays(np.zeros((1, 24, 3)).tolist(), [[1.001 * PLACE_LIMIT_M, 0.0, 0.0]], max_frames=1)
    with pytest.raises(BodyError, match="standard deviations"):
        shape_array([1.001 * BETA_LIMIT], runtime.body)
