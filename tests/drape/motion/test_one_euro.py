"""The One Euro filter against closed forms of first-order low passes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.errors import MotionError
from drape.motion.one_euro import OneEuro, one_euro, smoothing

FPS = 30.0
# A few hundred sums of numbers of size one.
EXACT = 1e-12


def share(cutoff_hz):
    """Of a new sample, from the paper's equations for alpha and tau."""
    return 1.0 / (1.0 + 1.0 / (2.0 * np.pi * cutoff_hz) * FPS)


def test_share_of_a_new_sample_is_the_papers():
    assert_allclose(smoothing(1.0, 1.0 / FPS), share(1.0), rtol=EXACT, atol=0.0)
    assert_allclose(smoothing(np.array([0.5, 7.0]), 1.0 / FPS), [share(0.5), share(7.0)], rtol=EXACT, atol=0.0)


def test_a_step_is_answered_by_a_geometric_series():
    step = np.ones((100, 1))
    step[0] = 0.0
    left = (1.0 - share(1.5)) ** np.arange(100)
    assert_allclose(one_euro(step, fps=FPS, min_cutoff=1.5)[:, 0], 1.0 - left, rtol=0.0, atol=EXACT)


def test_a_steady_motion_lags_by_the_time_constant():
    """A ramp of speed v lags by v (1 - alpha) / (alpha fps) = v / (2 pi f_c)."""
    speed = 0.7
    ramp = speed * np.arange(600)[:, None] / FPS
    lag = ramp[-1, 0] - one_euro(ramp, fps=FPS, min_cutoff=1.0)[-1, 0]
    assert_allclose(lag, speed / (2.0 * np.pi), rtol=1e-9, atol=0.0)


def test_beta_raises_the_cut_off_with_the_speed_that_the_filter_sees():
    """At rest in its own frame: the speed seen is that of the point over the filtered one, lag / dt."""
    speed, beta = 0.7, 3.0
    ramp = speed * np.arange(3000)[:, None] / FPS
    filtered = one_euro(ramp, fps=FPS, min_cutoff=1.0, beta=beta)
    lag = ramp[-1, 0] - filtered[-1, 0]
    seen = lag * FPS + speed  # the sample is a step ahead of the last result's place
    assert_allclose(lag, speed / (2.0 * np.pi * (1.0 + beta * seen)), rtol=1e-9, atol=0.0)


def test_white_noise_is_cut_by_the_share_of_a_sample(rng):
    """Variance of a first-order low pass of white noise: alpha / (2 - alpha)."""
    noise = rng.normal(size=(400, 2000, 1))
    left = one_euro(noise, fps=FPS, min_cutoff=1.0)[100:].var()
    # 600,000 numbers in 2,000 independent rows of a few independent samples each.
    assert_allclose(left, share(1.0) / (2.0 - share(1.0)), rtol=0.02, atol=0.0)


def test_a_still_point_stays_and_any_constant_passes():
    still = np.tile([0.3, -2.0, 5.0], (50, 4, 1))
    assert_allclose(one_euro(still, fps=FPS, beta=0.5), still, rtol=0.0, atol=0.0)


def test_turned_points_are_filtered_to_turned_results(rng):
    points = rng.normal(size=(40, 5, 3)).cumsum(axis=0)
    turn = Rotation.random(rng=rng).as_matrix()
    assert_allclose(
        one_euro(points @ turn.T, fps=FPS, beta=0.8), one_euro(points, fps=FPS, beta=0.8) @ turn.T, rtol=0.0, atol=1e-11
    )


def test_points_are_filtered_each_by_itself(rng):
    points = rng.normal(size=(40, 5, 3))
    together = one_euro(points, fps=FPS, beta=0.8)
    assert_allclose(one_euro(points[:, 2], fps=FPS, beta=0.8), together[:, 2], rtol=0.0, atol=0.0)


def test_a_stream_is_the_clip_and_begins_anew_after_reset(rng):
    points = rng.normal(size=(20, 5, 3))
    stream = OneEuro(beta=0.3)
    once = np.stack([stream(sample, 1.0 / FPS) for sample in points])
    assert_allclose(once, one_euro(points, fps=FPS, beta=0.3), rtol=0.0, atol=0.0)
    assert np.abs(stream(points[0], 1.0 / FPS) - points[0]).max() > 0.1
    stream.reset()
    assert_allclose(stream(points[0], 1.0 / FPS), points[0], rtol=0.0, atol=0.0)


def test_a_point_that_comes_back_starts_anew_and_the_others_do_not_notice(rng):
    points = rng.normal(size=(9, 2, 3))
    stream, got = OneEuro(beta=0.3), []
    for frame, sample in enumerate(points):
        got.append(stream(sample, 1.0 / FPS, seen=np.array([True, frame not in (0, 1, 4, 5)])))
    got = np.stack(got)
    assert_allclose(got[:, 0], one_euro(points[:, 0], fps=FPS, beta=0.3), rtol=0.0, atol=0.0)
    assert_allclose(got[[0, 1, 4, 5], 1], points[[0, 1, 4, 5], 1], rtol=0.0, atol=0.0)
    assert_allclose(got[2:4, 1], one_euro(points[2:4, 1], fps=FPS, beta=0.3), rtol=0.0, atol=0.0)
    assert_allclose(got[6:, 1], one_euro(points[6:, 1], fps=FPS, beta=0.3), rtol=0.0, atol=0.0)


def test_the_caller_may_change_what_it_got(rng):
    stream, points = OneEuro(), rng.normal(size=(3, 2, 3))
    stream(points[0], 1.0 / FPS)[:] = 7.0
    got = stream(points[1], 1.0 / FPS)
    assert_allclose(got, one_euro(points[:2], fps=FPS)[1], rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    "wrong", [{"min_cutoff": 0.0}, {"min_cutoff": np.nan}, {"beta": -0.1}, {"d_cutoff": 0.0}, {"d_cutoff": np.inf}]
)
def test_frequencies_that_are_none_are_refused(wrong):
    with pytest.raises(MotionError, match=f"{next(iter(wrong))}: expected a"):
        OneEuro(**wrong)


def test_samples_that_do_not_fit_the_stream_are_refused():
    stream = OneEuro()
    stream(np.zeros((5, 3)), 0.0)  # the first sample has no time before it
    with pytest.raises(MotionError, match="points: expected shape"):
        stream(np.zeros((4, 3)), 0.1)
    with pytest.raises(MotionError, match="points: expected finite"):
        stream(np.full((5, 3), np.nan), 0.1)
    with pytest.raises(MotionError, match="seen: expected shape"):
        stream(np.zeros((5, 3)), 0.1, seen=np.ones(4, dtype=bool))
    for dt_s in (0.0, -0.1, np.nan):
        with pytest.raises(MotionError, match="positive time step"):
            stream(np.zeros((5, 3)), dt_s)
    with pytest.raises(MotionError, match="fps: expected a positive frame rate"):
        one_euro(np.zeros((2, 3)), fps=0.0)
