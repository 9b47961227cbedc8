"""The choice of frames."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip
from drape.motion.hard_poses import OVERLAP_LIMIT_PCT, body_overlap_pct, hard_poses

ELBOW = 18


def swing(angle_rad: float, *, lean_rad: float = 0.0, name: str = "swing", frames: int = 60) -> MotionClip:
    """The left elbow goes from 0 to ``angle_rad``; the root leans forward by ``lean_rad``."""
    poses = np.zeros((frames, 24, 3))
    poses[:, ELBOW, 1] = -np.linspace(0.0, angle_rad, frames)
    poses[:, 0, 0] = lean_rad
    return MotionClip(poses, np.zeros((frames, 3)), 30.0, name)


def test_each_pose_is_the_farthest_from_rest_and_from_those_before(body):
    chosen = hard_poses([swing(1.4)], body, 2)
    last, middle = -chosen.poses[:, ELBOW, 1]
    assert 1.2 < last <= 1.4
    assert_allclose(middle, 0.5 * last, rtol=0.0, atol=0.1)
    assert all(label.startswith("swing:") for label in chosen.labels)


def test_the_choice_is_the_same_every_time(body):
    first, second = (hard_poses([swing(1.2), swing(0.5, name="other")], body, 4) for _ in range(2))
    assert first.labels == second.labels


def test_leaning_and_flagged_frames_are_passed_over(body):
    glitch = swing(0.8, name="glitch")
    poses = np.array(glitch.poses)
    poses[30, ELBOW, 1] = 2.0
    clips = [MotionClip(poses, glitch.trans, 30.0, "glitch"), swing(1.0, lean_rad=1.2, name="lean")]
    chosen = hard_poses(clips, body, 10)
    assert not any(label.startswith("lean") for label in chosen.labels)
    assert chosen.poses[:, ELBOW, 1].max() <= 0.0
    assert (rotvec_to_matrix(chosen.poses[:, 0])[:, 1, 1] > 0.7).all()


def test_a_body_that_cuts_into_itself_is_passed_over(body):
    straight, folded = np.zeros((24, 3)), np.zeros((24, 3))
    folded[[1, 2], 0] = -2.6
    assert body_overlap_pct(body, straight) < OVERLAP_LIMIT_PCT < body_overlap_pct(body, folded)
    clip = MotionClip(np.tile(folded, (10, 1, 1)), np.zeros((10, 3)), 30.0, "folded")
    with pytest.raises(InputError, match="self-contact"):
        hard_poses([clip], body, 1)


def test_too_few_poses_are_refused(body):
    with pytest.raises(InputError, match="at least 1000 usable poses"):
        hard_poses([swing(1.0)], body, 1000)
