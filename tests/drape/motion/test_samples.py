"""The generated clips stand on the ground, bend as people do, are smooth, and are those that ship."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.skeleton import PARENTS
from drape.catalog import MOTIONS_DIR
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import flagged_steps, joint_steps
from drape.motion.grounding import sole_heights
from drape.motion.legs import leg_rotations
from drape.motion.readers import read_motion
from drape.motion.samples import SAMPLES, main
from drape.motion.t_pose import CANONICAL_FLOOR, CANONICAL_JOINTS, JOINT_INDEX

GROUND_TOLERANCE = 1e-9  # feet are placed by closed forms

CLIPS = {name: make() for name, make in SAMPLES.items()}


@pytest.fixture(params=SAMPLES)
def clip(request):
    return CLIPS[request.param]


def joints_of(clip):
    rotations, joints = forward_kinematics(rotvec_to_matrix(clip.poses), CANONICAL_JOINTS, PARENTS)
    return rotations, joints + clip.trans[:, None]


def soles_of(clip):
    heights = sole_heights(rotvec_to_matrix(clip.poses), CANONICAL_JOINTS, floor=CANONICAL_FLOOR)
    return heights + clip.trans[:, 1, None, None]


def angles_of(clip, joint):
    return clip.poses[:, JOINT_INDEX[joint]]


def test_clip_is_60_hz_and_3_to_6_seconds(clip):
    assert clip.fps == 60.0
    assert 3.0 <= clip.frame_count / clip.fps <= 6.0


def test_no_step_is_flagged(clip):
    assert not flagged_steps(clip).any()
    assert joint_steps(clip).max() < 0.25


def test_a_foot_is_on_the_ground_and_none_below(clip):
    heights = soles_of(clip)
    assert heights.min() > -GROUND_TOLERANCE
    assert heights.min(axis=(1, 2)).max() < GROUND_TOLERANCE


def test_feet_on_the_ground_do_not_slide(clip):
    _, joints = joints_of(clip)
    heights = soles_of(clip)
    for index, side in enumerate(("left", "right")):
        flat = np.all(heights[:, index] < 1e-6, axis=-1)
        ankle = joints[:, JOINT_INDEX[f"{side}_ankle"]]
        moved = np.linalg.norm(np.diff(ankle, axis=0), axis=-1)[flat[1:] & flat[:-1]]
        assert len(moved) > 0
        assert moved.max() < 1e-6


def test_clip_loops_up_to_its_way_forward(clip):
    """Continuing from the last frame to the first is as smooth as any other step."""
    for values in (rotvec_to_matrix(clip.poses[:, 1:]), rotvec_to_matrix(clip.poses[:, :1])):
        step = np.abs(np.diff(values, axis=0)).max()
        assert np.abs(values[0] - values[-1]).max() < 1.05 * step + 1e-9
    drift = clip.trans[-1] + (clip.trans[-1] - clip.trans[-2]) - clip.trans[0]
    if clip.name == "walk":
        assert drift[2] > 3.0
        drift[2] = 0.0
    assert np.linalg.norm(drift) < 2e-3


def test_motion_is_smooth(clip):
    """Accelerations are bounded, and the same at half the rate: no kinks."""
    _, joints = joints_of(clip)
    fine = np.abs(np.diff(joints, 2, axis=0)).max() * clip.fps**2
    coarse = np.abs(np.diff(joints[::2], 2, axis=0)).max() * (clip.fps / 2.0) ** 2
    assert fine < 1.6 * coarse
    assert fine < 60.0  # [m/s^2]


def test_knees_bend_backwards_only(clip):
    for side in ("left", "right"):
        angle = angles_of(clip, f"{side}_knee")
        assert_allclose(angle[:, 1:], np.zeros((clip.frame_count, 2)), rtol=0.0, atol=1e-7)
        assert angle[:, 0].min() > 0.0
        assert angle[:, 0].max() < 2.6


def test_elbows_bend_forwards_only(clip):
    for side, sign in (("left", -1.0), ("right", 1.0)):
        angle = angles_of(clip, f"{side}_elbow")
        assert_allclose(angle[:, [0, 2]], np.zeros((clip.frame_count, 2)), rtol=0.0, atol=1e-7)
        assert (sign * angle[:, 1]).min() > 0.0
        assert (sign * angle[:, 1]).max() < 1.5


def test_arms_stay_out_of_the_trunk(clip):
    """Elbows and wrists keep their distance from the line of the trunk."""
    _, joints = joints_of(clip)
    low, high = joints[:, JOINT_INDEX["pelvis"]], joints[:, JOINT_INDEX["neck"]]
    for name in ("left_elbow", "right_elbow", "left_wrist", "right_wrist"):
        point = joints[:, JOINT_INDEX[name]]
        share = np.clip(np.sum((point - low) * (high - low), -1) / np.sum((high - low) ** 2, -1), 0.0, 1.0)
        distance = np.linalg.norm(point - (low + share[:, None] * (high - low)), axis=-1)
        assert distance.min() > 0.18


def test_ankles_stay_in_their_range(clip):
    for side in ("left", "right"):
        assert np.linalg.norm(angles_of(clip, f"{side}_ankle"), axis=-1).max() < 0.9


def test_shipped_clips_are_the_generated_ones(clip):
    shipped = read_motion(MOTIONS_DIR / f"{clip.name}.npz")
    assert shipped.name == clip.name
    assert_allclose(shipped.poses, clip.poses, rtol=0.0, atol=1e-5)
    assert_allclose(shipped.trans, clip.trans, rtol=0.0, atol=1e-5)


def test_shipped_clips_are_small():
    assert sum(path.stat().st_size for path in MOTIONS_DIR.glob("*.npz")) < 300_000


def test_command_writes_every_clip(tmp_path, capsys):
    main(["--out", str(tmp_path / "new")])
    assert {path.stem for path in (tmp_path / "new").iterdir()} == set(SAMPLES)
    assert "walk.npz" in capsys.readouterr().out


def test_leg_reaches_its_ankle(rng):
    hip = rng.normal(size=(50, 3))
    line = rng.normal(size=(50, 3))
    ankle = hip + line / np.linalg.norm(line, axis=-1, keepdims=True) * rng.uniform(0.2, 0.77, (50, 1))
    forward = np.cross(line, rng.normal(size=(50, 3)))
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    thigh, shin = leg_rotations(hip, ankle, forward)
    knee = hip + thigh @ np.array([0.0, -0.38, 0.0])
    assert_allclose(knee + shin @ np.array([0.0, -0.40, 0.0]), ankle, rtol=0.0, atol=1e-12)
    assert (np.sum((knee - hip) * forward, axis=-1) > 0.0).all()


def test_leg_out_of_reach_is_refused():
    hip, ankle, forward = np.zeros((1, 3)), np.array([[0.0, -0.9, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="the leg is"):
        leg_rotations(hip, ankle, forward)
