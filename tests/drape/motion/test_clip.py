"""Laws of motion clips: resampling, windows, flagged steps, saving."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_COUNT
from drape.errors import MotionError
from drape.geometry.rotations import quaternion_multiply, quaternion_to_rotvec, rotvec_to_matrix, rotvec_to_quaternion
from drape.motion.amass import read_amass
from drape.motion.clip import MotionClip, clean_windows, flagged_steps, joint_steps

EXACT = 1e-12


def make_clip(rng, frame_count=20, fps=60.0, spread=0.02):
    """A random walk of the joints from a random pose."""
    poses = rng.normal(size=(1, JOINT_COUNT, 3)) + np.cumsum(
        spread * rng.normal(size=(frame_count, JOINT_COUNT, 3)), axis=0
    )
    return MotionClip(poses=poses, trans=rng.normal(size=(frame_count, 3)), fps=fps, name="random")


def spinning_clip(velocity, frame_count=31, fps=30.0):
    """Every joint turns at a constant angular velocity (24, 3) [rad/s]."""
    times = np.arange(frame_count) / fps
    poses = times[:, None, None] * velocity
    return MotionClip(poses=poses, trans=times[:, None] * np.ones(3), fps=fps, name="spin")


@pytest.mark.parametrize(("own", "fps"), [*((60.0, fps) for fps in (30.0, 60.0, 90.0, 120.0, 180.0)), (180.0, 60.0)])
def test_resampling_is_exact_at_the_samples(own, fps, rng):
    clip = make_clip(rng, fps=own)
    resampled = clip.resampled(fps)
    assert resampled.frame_count == int(19 * fps / own) + 1
    for frame in range(resampled.frame_count):
        source = frame * own / fps
        if source == int(source):
            np.testing.assert_array_equal(resampled.poses[frame], clip.poses[int(source)])
            assert_allclose(resampled.trans[frame], clip.trans[int(source)], rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("fps", [24.0, 29.97, 47.3, 120.0])
def test_resampling_a_constant_turn_gives_the_same_turn(fps, rng):
    velocity = rng.normal(size=(JOINT_COUNT, 3))
    resampled = spinning_clip(velocity).resampled(fps)
    times = np.arange(resampled.frame_count) / fps
    want = rotvec_to_matrix(times[:, None, None] * velocity)
    assert_allclose(rotvec_to_matrix(resampled.poses), want, rtol=0.0, atol=1e-10)
    assert_allclose(resampled.trans, times[:, None] * np.ones(3), rtol=0.0, atol=EXACT)
    steps = joint_steps(resampled)
    assert_allclose(steps, np.broadcast_to(np.linalg.norm(velocity, axis=-1) / fps, steps.shape), rtol=0.0, atol=1e-8)


def flipped(clip, rng):
    """The same rotations with some rotation vectors a full turn away."""
    angle = np.linalg.norm(clip.poses, axis=-1, keepdims=True)
    other = clip.poses / angle * (angle - 2.0 * np.pi)
    choice = rng.random((clip.frame_count, JOINT_COUNT, 1)) < 0.5
    return MotionClip(poses=np.where(choice, other, clip.poses), trans=clip.trans, fps=clip.fps, name=clip.name)


def test_full_turns_in_the_rotation_vectors_change_nothing(rng):
    clip = make_clip(rng)
    other = flipped(clip, rng)
    assert np.abs(other.poses - clip.poses).max() > 1.0
    assert_allclose(joint_steps(other), joint_steps(clip), rtol=0.0, atol=1e-7)
    np.testing.assert_array_equal(flagged_steps(other), flagged_steps(clip))
    got, want = other.resampled(100.0), clip.resampled(100.0)
    assert_allclose(rotvec_to_matrix(got.poses), rotvec_to_matrix(want.poses), rtol=0.0, atol=1e-10)


def test_one_frame_resamples_to_itself(rng):
    clip = make_clip(rng, frame_count=1)
    assert clip.duration_s == 0.0
    np.testing.assert_array_equal(clip.resampled(17.0).poses, clip.poses)


def glitched(rng, frame, angle, fps=60.0):
    clip = make_clip(rng, frame_count=40, fps=fps, spread=1e-3)
    poses = clip.poses.copy()
    kick = rotvec_to_quaternion(np.array([0.0, angle, 0.0]))
    poses[frame, 5] = quaternion_to_rotvec(quaternion_multiply(rotvec_to_quaternion(poses[frame, 5]), kick))
    return MotionClip(poses=poses, trans=clip.trans, fps=fps, name="glitch")


def test_a_one_frame_glitch_flags_the_two_steps_around_it(rng):
    assert np.flatnonzero(flagged_steps(glitched(rng, 17, 0.6))).tolist() == [16, 17]
    assert not flagged_steps(glitched(rng, 17, 0.4)).any()


def test_the_limit_is_an_angular_speed(rng):
    assert flagged_steps(glitched(rng, 17, 0.3, fps=120.0)).sum() == 2
    assert not flagged_steps(glitched(rng, 17, 0.9, fps=30.0)).any()


def test_clean_windows_are_those_without_a_flagged_step(rng):
    clip = glitched(rng, 17, 1.0)
    flags = flagged_steps(clip)
    want = [start for start in range(31) if not flags[start : start + 9].any()]
    assert clean_windows(clip, 10) == want
    assert clean_windows(clip, 10, stride=4) == [start for start in want if start % 4 == 0]
    assert clean_windows(clip, 1) == list(range(40))
    assert clean_windows(clip, 41) == []


@pytest.mark.parametrize(("length", "stride"), [(0, 1), (5, 0)])
def test_windows_of_no_length_are_refused(length, stride, rng):
    with pytest.raises(MotionError, match="1 or more frames"):
        clean_windows(make_clip(rng), length, stride=stride)


def test_window_and_slice_cut_the_same_frames(rng):
    clip = make_clip(rng)
    window = clip.window(6, 7)
    np.testing.assert_array_equal(window.poses, clip.poses[6:13])
    np.testing.assert_array_equal(window.trans, clip.trans[6:13])
    np.testing.assert_array_equal(clip.slice(0.1, 0.2).poses, window.poses)


@pytest.mark.parametrize(("start", "count"), [(-1, 3), (0, 0), (15, 6), (20, 1)])
def test_window_outside_the_clip_is_refused(start, count, rng):
    with pytest.raises(MotionError, match="window"):
        make_clip(rng).window(start, count)


def test_clip_is_immutable_and_keeps_a_copy(rng):
    poses = np.zeros((2, JOINT_COUNT, 3))
    clip = MotionClip(poses=poses, trans=np.zeros((2, 3)), fps=60, name="still")
    poses[:] = 1.0
    assert not clip.poses.any()
    with pytest.raises(ValueError, match="read-only"):
        clip.poses[0] = 1.0


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"poses": np.zeros((3, 23, 3))}, "poses"),
        ({"poses": np.zeros((0, 24, 3)), "trans": np.zeros((0, 3))}, "poses"),
        ({"poses": np.full((3, 24, 3), np.nan)}, "poses"),
        ({"poses": [["wrong"]]}, "poses"),
        ({"trans": np.zeros((4, 3))}, "trans"),
        ({"trans": np.full((3, 3), np.inf)}, "trans"),
        ({"betas": np.zeros((1, 10))}, "betas"),
        ({"betas": np.full(10, np.nan)}, "betas"),
        ({"fps": 0.0}, "fps"),
        ({"fps": -60.0}, "fps"),
        ({"fps": np.nan}, "fps"),
        ({"fps": np.inf}, "fps"),
    ],
)
def test_wrong_parts_of_a_clip_are_refused_by_name(change, name):
    parts = {"poses": np.zeros((3, 24, 3)), "trans": np.zeros((3, 3)), "fps": 60.0, "name": "clip"} | change
    with pytest.raises(MotionError) as refusal:
        MotionClip(**parts)
    assert refusal.value.name == name


def test_resampling_to_no_rate_is_refused(rng):
    with pytest.raises(MotionError, match="fps"):
        make_clip(rng).resampled(0.0)


@pytest.mark.parametrize("betas", [None, np.linspace(-1.0, 1.0, 10)])
def test_saved_clip_reads_back(betas, rng, tmp_path):
    clip = make_clip(rng, fps=29.97)
    clip = MotionClip(poses=clip.poses, trans=clip.trans, fps=clip.fps, name="a clip", betas=betas)
    clip.save(tmp_path / "new" / "clip.npz")
    back = read_amass(tmp_path / "new" / "clip.npz")
    assert_allclose(back.poses, clip.poses, rtol=1e-7, atol=1e-7)
    assert_allclose(back.trans, clip.trans, rtol=1e-7, atol=1e-7)
    assert_allclose(back.fps, clip.fps, rtol=1e-6, atol=0.0)
    assert back.name == "a clip"
    assert (back.betas is None) == (betas is None)
    if betas is not None and back.betas is not None:
        assert_allclose(back.betas, betas, rtol=1e-6, atol=1e-7)


def test_failed_save_leaves_nothing(rng, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        make_clip(rng).save(tmp_path / "clip.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_clip_is_shown_in_a_line():
    assert (
        repr(MotionClip(np.zeros((3, 24, 3)), np.zeros((3, 3)), 30.0, "wave"))
        == "MotionClip('wave', 3 frames at 30 per second)"
    )
