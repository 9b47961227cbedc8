"""Poses: mirroring and mixing are what they say; nothing flagged or held out is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.catalog import MOTIONS_DIR
from drape.errors import MotionError
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip
from tests.training.training_setup import body
from training.config import DataConfig
from training.poses import LEGS, MIRROR, PoseBank, draw_betas, mirror_poses, read_training_clips, rows_of_three

PLAIN = DataConfig(mix_share=0.0, mirror_share=0.0)


def test_mirroring_reflects_the_posed_skeleton():
    rng = np.random.default_rng(0)
    poses = rng.normal(0.0, 0.4, size=(4, 24, 3))
    joints = 0.5 * (body().joints_template + body().joints_template[list(MIRROR)] * [-1.0, 1.0, 1.0])
    place, other = (forward_kinematics(rotvec_to_matrix(p), joints, PARENTS)[1] for p in (poses, mirror_poses(poses)))
    assert_allclose(other[:, list(MIRROR)] * [-1.0, 1.0, 1.0], place, rtol=0, atol=1e-9)
    assert_allclose(mirror_poses(mirror_poses(poses)), poses, rtol=0, atol=0)


def test_rows_of_three_lie_on_a_straight_way_and_keep_the_root():
    poses = np.random.default_rng(0).normal(size=(400, 24, 3))
    before, at, after = rows_of_three(poses, 0.01, np.random.default_rng(1)).reshape(-1, 3, 24, 3).swapaxes(0, 1)
    assert_allclose(at, poses, atol=0)
    assert_allclose(before + after, 2.0 * at, atol=1e-12)
    assert_allclose(after[:, 0], at[:, 0], atol=0)
    assert (after - at)[:, 1:].std() == pytest.approx(0.01, rel=0.02)


def test_left_and_right_are_each_others_mirror():
    for joint, other in enumerate(MIRROR):
        assert MIRROR[other] == joint
        assert JOINT_NAMES[joint].split("_")[-1] == JOINT_NAMES[other].split("_")[-1]


def test_mixing_takes_legs_from_one_frame_and_the_rest_from_another():
    low, high = np.zeros((50, 24, 3)), np.full((50, 24, 3), 0.01)
    clips = [MotionClip(low, np.zeros((50, 3)), 60.0, "low"), MotionClip(high, np.zeros((50, 3)), 60.0, "high")]
    drawn = PoseBank(clips, replace(PLAIN, mix_share=1.0)).draw(200, np.random.default_rng(0))
    trunk = np.setdiff1d(np.arange(24), LEGS)
    assert len(np.unique(drawn[:, trunk].reshape(200, -1), axis=0)) == 2
    assert (drawn[:, LEGS[0], 0] != drawn[:, trunk[0], 0]).any()


def test_frames_beside_a_glitch_are_never_drawn():
    poses = np.zeros((61, 24, 3))
    poses[30, 18] = 2.0
    bank = PoseBank([MotionClip(poses, np.zeros((61, 3)), 15.0, "glitch")], PLAIN)
    assert float(np.abs(bank.draw(300, np.random.default_rng(0))).max()) == 0.0
    assert bank.frame_count == 58


def test_held_out_clips_are_not_read():
    names = {clip.name for clip in read_training_clips([MOTIONS_DIR], held_out=("walk",))}
    assert "walk" not in names
    assert names >= {"squat", "reach", "turn"}


def test_no_clips_is_refused():
    with pytest.raises(MotionError, match="training clips"):
        PoseBank([], PLAIN)


def test_shapes_are_drawn_for_the_share_that_asks():
    betas = draw_betas(4000, 10, replace(PLAIN, shape_share=0.25, shape_deviation=0.5), np.random.default_rng(0))
    moved = (betas != 0).any(axis=1)
    assert 0.2 < moved.mean() < 0.3
    assert_allclose(betas[moved].std(), 0.5, rtol=0.05, atol=0)
