"""Windows of motion: frames in a row with their true times, clean, mirrored whole, and what stops stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.features import motion_features
from drape.errors import MotionError
from drape.graph.feeds import kinematics
from drape.motion.clip import MotionClip
from tests.fixtures.poses import smooth_motion
from tests.training.training_setup import body
from training.config import DataConfig, MotionConfig
from training.poses import mirror_poses
from training.windows import WindowBank

PLAIN = MotionConfig(
    window_frames=3, warm_up_frames=4, intervals_s=(0.05,), drop_share=0.0, speeds=(1.0, 1.0), stop_share=0.0,
    sway_share=0.0,
)  # fmt: skip
ASIS = DataConfig(mirror_share=0.0)
FRAMES = 11


def clip(count: int = 200, *, fps: float = 60.0) -> MotionClip:
    poses, trans = smooth_motion(np.arange(count) / fps)
    return MotionClip(poses=poses, trans=trans, fps=fps, name="swaying")


def places(poses: np.ndarray, source: MotionClip) -> np.ndarray:
    """The frame of ``source`` that each pose is."""
    return np.array([int(np.argmin(np.abs(source.poses - pose).max(axis=(1, 2)))) for pose in poses])


def test_a_window_is_frames_in_a_row_with_the_times_between_them(rng):
    source = clip()
    windows = WindowBank([source], ASIS, PLAIN).draw(6, FRAMES, rng)
    for poses, trans, dt_s in zip(windows.poses, windows.trans, windows.dt_s, strict=True):
        index = places(poses, source)
        assert_array_equal(np.diff(index), 3)  # 0.05 s at 60 frames per second
        assert_array_equal(poses, source.poses[index])
        assert_allclose(trans, source.trans[index] - source.trans[index[0]], rtol=0, atol=1e-12)
        assert_allclose(dt_s, 0.05, rtol=1e-12, atol=0)


def test_dropped_frames_take_longer_and_faster_play_takes_less(rng):
    source = clip(600)
    windows = WindowBank([source], ASIS, replace(PLAIN, drop_share=0.4, speeds=(0.5, 2.0))).draw(20, FRAMES, rng)
    speeds, long_steps = [], 0
    for poses, dt_s in zip(windows.poses, windows.dt_s, strict=True):
        steps = np.diff(places(poses, source))
        speed = steps / 60.0 / dt_s
        assert_allclose(speed, speed[0], rtol=1e-9, atol=0)
        speeds.append(speed[0])
        assert (steps % 3 == 0).all()
        long_steps += (steps > 3).sum()
    assert 0.5 <= min(speeds) < 0.9 and 1.3 < max(speeds) <= 2.0
    assert 0.25 < long_steps / (20 * (FRAMES - 1)) < 0.55


def test_no_window_crosses_a_glitch(rng):
    source = clip(120)
    poses = source.poses.copy()
    poses[60:, 5, 0] += 1.5
    windows = WindowBank([replace(source, poses=poses)], ASIS, PLAIN).draw(40, FRAMES, rng)
    assert np.abs(np.diff(windows.poses[:, :, 5, 0], axis=1)).max() < 0.5


def test_a_window_is_mirrored_whole(rng):
    bank = WindowBank([clip()], ASIS, PLAIN)
    other = WindowBank([clip()], replace(ASIS, mirror_share=1.0), PLAIN)
    plain, flipped = (b.draw(3, FRAMES, np.random.default_rng(5)) for b in (bank, other))
    assert_array_equal(flipped.poses, mirror_poses(plain.poses))
    assert_array_equal(flipped.trans, plain.trans * [-1.0, 1.0, 1.0])


def test_after_a_stop_the_body_stands_and_time_goes_on(rng):
    windows = WindowBank([clip()], ASIS, replace(PLAIN, stop_share=1.0, sway_share=1.0)).draw(30, FRAMES, rng)
    shapes = np.zeros((30, 10))
    moves = np.abs(np.diff(windows.trans, axis=1)).max(axis=2) + np.abs(np.diff(windows.poses, axis=1)).max(axis=(2, 3))
    stood = 0
    features = windows.features(body(), shapes)
    for i in range(30):
        last = int(np.flatnonzero(moves[i])[-1]) + 1  # the frame at which it stops
        assert (moves[i, :last] > 0.0).all() and (windows.dt_s[i] > 0.0).all()
        stood += FRAMES - 1 - last
        assert_array_equal(features[i, last:], 0.0)  # from two frames after the stop on
        if 2 <= last < FRAMES - 1:
            assert np.abs(features[i, last - 1]).max() > 0.0
    assert stood > 30


def test_the_ground_sways_no_harder_than_said(rng):
    still = MotionClip(np.zeros((300, 24, 3)), np.zeros((300, 3)), 60.0, "still")
    motion = replace(PLAIN, intervals_s=(1 / 60,), sway_share=1.0, sway_m_s2=3.0)
    features = WindowBank([still], ASIS, motion).draw(40, FRAMES, rng).features(body(), np.zeros((40, 10)))
    size = np.linalg.norm(features[..., 9:], axis=-1)
    assert 1.0 < size.max() <= 3.0 + 1e-6
    assert_allclose(size, np.broadcast_to(size[:, :, :1], size.shape), rtol=1e-6, atol=1e-6)


def test_features_are_those_that_the_service_makes(rng):
    windows = WindowBank([clip()], ASIS, replace(PLAIN, drop_share=0.3)).draw(2, FRAMES, rng)
    betas = rng.normal(size=(2, 10))
    got = windows.features(body(), betas)
    assert got.shape == (2, FRAMES - 2, 24, 12)
    for i in range(2):
        at = kinematics(body(), windows.poses[i], windows.trans[i], betas[i])
        dt_s = windows.dt_s[i]
        want = motion_features(at[2:], at[1:-1], at[:-2], dt_s[1:], dt_s[:-1])
        assert_allclose(got[i], want, rtol=1e-6, atol=1e-7)


def test_short_clips_give_what_they_have(rng):
    source = clip(FRAMES)
    windows = WindowBank([source], ASIS, PLAIN).draw(2, FRAMES, rng)  # 0.05 s steps would need 31 frames
    assert_array_equal(windows.poses[0], source.poses)
    assert_allclose(windows.dt_s, 1 / 60, rtol=1e-12, atol=0)
    with pytest.raises(MotionError, match="training clips: expected a clip with 11 frames in a row, got 1 clips"):
        WindowBank([clip(FRAMES - 1)], ASIS, PLAIN)
