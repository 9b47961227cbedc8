"""Motions as they come in: what is no motion of a person in radians."""

from __future__ import annotations

import numpy as np
import pytest

from drape.errors import MotionError
from drape.motion.samples import SAMPLES
from drape.stages.batch import check_poses

STILL = np.zeros((1, 3))


@pytest.mark.parametrize("name", SAMPLES)
def test_a_clip_in_degrees_is_told_so_and_the_same_in_radians_is_taken(name: str):
    clip = SAMPLES[name]()
    check_poses(clip.poses, clip.trans)
    with pytest.raises(MotionError, match=r"expected rotation vectors in radians, got up to .* look like degrees"):
        check_poses(np.degrees(clip.poses), clip.trans)


def test_rotation_vectors_of_any_length_stay_what_they_are():
    generator = np.random.default_rng(0)
    for spread in (0.5, 3.0, 1000.0):  # a turn has many vectors: these are odd, and no degrees
        poses = np.clip(generator.normal(0.0, spread, (50, 24, 3)), -1000.0, 1000.0)
        for pose in poses:
            check_poses(pose[None], STILL)
    spun = np.zeros((200, 24, 3))
    spun[:, :3, 1] = np.linspace(0.0, 120.0, 200)[:, None]  # three joints whose angles were never brought back
    check_poses(spun, np.zeros((200, 3)))
