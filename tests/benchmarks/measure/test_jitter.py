"""Which windows jitter is measured on, and that its ratio means what it says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure import judged
from benchmarks.measure.jitter import FPS, Window, _compared, jitter, typical_windows
from drape.motion.clip import MotionClip
from tests.benchmarks.quality_setup import bending, body, network, tube

ELBOW = 18


def clip(turns: list[float], *, frames: int = 60, fps: float = FPS, name: str = "clip") -> MotionClip:
    """An elbow that turns by ``turns`` [rad], one after the other, each over ``frames``."""
    speed = np.repeat(np.array(turns) / frames, frames)
    poses = np.zeros((len(speed), 24, 3))
    poses[:, ELBOW, 1] = np.cumsum(speed)
    return MotionClip(poses, np.zeros((len(poses), 3)), fps, name)


def turned(window: Window) -> float:
    return float(window.poses[-1, ELBOW, 1] - window.poses[0, ELBOW, 1])


def test_the_window_turns_the_median_amount():
    (window,) = typical_windows([clip([0.9, 0.0, 0.3, 0.9, 0.0])])
    assert len(window.poses) == 60
    amounts = [0.9, 0.675, 0.45, 0.225, 0.0, 0.075, 0.15, 0.225, 0.3, 0.45, 0.6, 0.75, 0.9, 0.675, 0.45, 0.225, 0.0]
    assert_allclose(turned(window), np.median(amounts), rtol=0.0, atol=0.03)
    first, last = map(int, window.label.removeprefix("clip:").split("-"))
    assert_allclose(clip([0.9, 0.0, 0.3, 0.9, 0.0]).poses[first : last + 1], window.poses, rtol=0.0, atol=0.0)


def test_fast_clips_are_resampled_and_slow_ones_taken_as_they_are():
    fast, slow = typical_windows([clip([0.6] * 4, fps=2.0 * FPS), clip([0.6] * 4, fps=0.5 * FPS)])
    assert_allclose(turned(fast), 2.0 * turned(slow), rtol=1e-6, atol=0.0)


def test_short_clips_and_glitches_leave_no_window():
    jump = clip([0.0, 0.0])
    poses = np.array(jump.poses)
    poses[::20, ELBOW, 1] = 1.0
    assert typical_windows([clip([0.2], frames=59), MotionClip(poses, jump.trans, FPS, "jump")]) == []


def test_ratios_are_roots_of_squares_over_skinnings():
    found = _compared([4.0, 8.0], [1.0, 2.0], ["a", "b"])
    assert (found.ratio, found.by_clip, found.worst) == (2.0, {"a": 2.0, "b": 2.0}, 2.0)
    mixed = _compared([9.0, 1.0, 5.0], [1.0, 4.0, 0.0], ["a", "b", "still"])
    assert_allclose(mixed.ratio, np.sqrt(3.0), rtol=1e-12, atol=0.0)
    assert_allclose([mixed.by_clip["a"], mixed.by_clip["b"], mixed.worst], [3.0, 0.5, 3.0], rtol=1e-12, atol=0.0)
    assert np.isnan(mixed.by_clip["still"])
    assert np.isnan(_compared([0.0], [0.0], ["still"]).worst)


@pytest.fixture(scope="module")
def measured():
    """``jitter`` of the tube under the small network."""
    return lambda windows: jitter(tube(), network(), body(), windows)


def test_a_shaken_body_shakes_every_drape_alike(measured):
    smooth = measured([Window(bending(12), "bend")])
    assert smooth["skinning"].ratio == 1.0
    assert smooth["network"].by_clip.keys() == {"bend"}
    # The whole body shaken about the vertical: the same rigid motion for every method, of drapes whose widths differ
    # by a few per cent.
    poses = np.zeros((12, 24, 3))
    poses[::2, 0, 1] = 0.02
    shaken = measured([Window(poses, "shake")])
    assert_allclose([found.ratio for found in shaken.values()], 1.0, rtol=0.0, atol=5e-2)


def test_without_windows_there_is_no_jitter(measured):
    assert measured([]) == {}


def test_jitter_is_a_ratio_of_third_differences_and_none_where_the_start_is_still():
    start = np.random.default_rng(0).normal(size=(6, 5, 3))
    assert judged.jitter_ratio(3.0 * start, start) == pytest.approx(3.0)
    assert np.isnan(judged.jitter_ratio(start, np.ones((6, 5, 3))))
