"""Clips keep their soles over the ground on bodies of other proportions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import MotionError
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.grounding import floor_note, place_on_ground, sole_heights
from drape.motion.samples import SAMPLES, walk
from drape.motion.t_pose import CANONICAL_FLOOR, CANONICAL_JOINTS

EXACT = 1e-12
# Skin under the soles bends where the points of the test skeleton do not.
SKIN_TOLERANCE_M = 0.03


def test_canonical_body_keeps_its_translations():
    clip = walk()
    assert_allclose(
        place_on_ground(clip, CANONICAL_JOINTS, floor=CANONICAL_FLOOR).trans, clip.trans, rtol=0.0, atol=EXACT
    )


@pytest.mark.parametrize("name", SAMPLES)
def test_soles_touch_the_ground_on_any_proportions(name, rng):
    clip = SAMPLES[name]()
    joints = 1.2 * CANONICAL_JOINTS * rng.uniform(0.9, 1.1, (1, 3)) + [0.1, 0.7, -0.2]
    floor = float(joints[7, 1] - 0.09)
    placed = place_on_ground(clip, joints, floor=floor)
    heights = sole_heights(rotvec_to_matrix(clip.poses), joints, floor=floor) + placed.trans[:, 1, None, None]
    assert_allclose(heights.min(axis=(1, 2)), np.zeros(clip.frame_count), rtol=0.0, atol=1e-9)


def test_a_jump_scales_with_the_legs_and_the_rest_place_does_not_matter():
    clip = walk()
    jump = type(clip)(poses=clip.poses, trans=clip.trans + np.array([0.0, 0.3, 0.0]), fps=60.0, name="jump")
    joints = 1.5 * CANONICAL_JOINTS
    placed = place_on_ground(jump, joints, floor=1.5 * CANONICAL_FLOOR)
    heights = sole_heights(rotvec_to_matrix(clip.poses), joints, floor=1.5 * CANONICAL_FLOOR)
    low = (heights + placed.trans[:, 1, None, None]).min(axis=(1, 2))
    assert_allclose(low, np.full(clip.frame_count, 0.45), rtol=0.0, atol=1e-9)
    shift = np.array([0.3, 0.9, -0.1])
    moved = place_on_ground(jump, joints + shift, floor=1.5 * CANONICAL_FLOOR + shift[1])
    assert_allclose(moved.trans, placed.trans - shift, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("name", SAMPLES)
def test_shipped_body_stands_on_the_ground_in_the_sample_clips(name, body):
    clip = SAMPLES[name]()
    placed = place_on_ground(clip, body.rest_joints(), floor=float(body.v_template[:, 1].min()))
    frames = slice(0, None, 20)
    lowest = body.posed_vertices(placed.poses[frames], placed.trans[frames])[..., 1].min(axis=1)
    assert np.abs(lowest).max() < SKIN_TOLERANCE_M


@pytest.mark.parametrize(("lift_m", "said"), [(0.0, ""), (0.1, ""), (0.5, "0.50 m above"), (-0.93, "0.93 m below")])
def test_feet_that_are_not_on_the_floor_are_told(lift_m, said):
    clip = place_on_ground(walk(), CANONICAL_JOINTS, floor=CANONICAL_FLOOR)
    note = floor_note(clip.poses, clip.trans + np.array([0.0, lift_m, 0.0]), CANONICAL_JOINTS, floor=CANONICAL_FLOOR)
    assert said in note if said else note == ""


@pytest.mark.parametrize("joints", [np.zeros((22, 3)), np.full((24, 3), np.nan)])
def test_wrong_joints_are_refused(joints):
    with pytest.raises(MotionError, match="rest_joints"):
        place_on_ground(walk(), joints, floor=0.0)
