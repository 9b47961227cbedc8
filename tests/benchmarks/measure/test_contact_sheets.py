"""Contact sheets turn with the body, and frames are taken from all of the clip."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure.contact_sheets import _heading_deg, frames_of
from drape.body.assets import load_body
from drape.motion.clip import MotionClip


@pytest.mark.parametrize("angle_deg", [-120.0, 0.0, 35.0, 90.0])
def test_the_heading_is_the_bodys_turn_about_the_vertical(angle_deg):
    pose = np.zeros((1, 24, 3))
    pose[0, 0, 1] = np.deg2rad(angle_deg)
    assert_allclose(_heading_deg(load_body().posed_vertices(pose)[0]), angle_deg, rtol=0, atol=2.0)


def test_frames_are_spread_over_the_clip():
    poses = np.zeros((71, 24, 3))
    poses[:, 0, 1] = np.linspace(0.0, 1.0, 71)
    chosen = frames_of(MotionClip(poses, np.zeros((71, 3)), 30.0, "turn"), 6)
    assert_allclose(chosen.poses[:, 0, 1], np.arange(1, 7) / 7.0, rtol=0, atol=1e-9)
