"""The score of poses unlike training: distances, limits, and the file that keeps them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drape.artifacts import DEFAULT_MODEL, load_manifest, model_folder
from drape.body.pose_distance import LEGS, TRUNK, PoseSupport, mixed_poses, pose_parts, read_pose_support
from drape.catalog import MOTIONS_DIR
from drape.errors import ArtifactError
from drape.geometry.rotations import matrix_to_rotvec, matrix_to_sixd, rotvec_to_matrix
from drape.motion.readers import read_motion
from tests.extremes.test_poses import NAMED


@pytest.fixture(scope="module")
def support() -> PoseSupport:
    """That of the shipped model."""
    spec = load_manifest(model_folder(DEFAULT_MODEL)).poses
    assert spec is not None
    return read_pose_support(model_folder(DEFAULT_MODEL) / spec.file)


def test_a_distance_is_that_to_the_nearest_kept_pose_per_joint():
    kept = {name: np.rint(127.0 * rows).astype(np.int8) for name, rows in pose_parts(np.zeros((1, 24, 3))).items()}
    support = PoseSupport(**kept, limits=np.array([0.5, 0.25, 0.1]))
    pose = np.zeros((2, 24, 3))
    pose[1, LEGS[0], 2] = np.pi  # two columns turn round: a way of sqrt(8) in one of eight joints
    pose[1, TRUNK[0], 1] = 0.0
    way = np.sqrt(8.0 / len(LEGS))
    np.testing.assert_allclose(support.distances(pose), [[0, 0, 0], [way, 0, 0]], rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(support.novelty(pose), [0.0, way / 0.5], rtol=0.0, atol=3e-3)


def test_clips_that_training_never_saw_are_within_and_poses_that_nobody_takes_beyond(support: PoseSupport):
    clips = [read_motion(path).poses for path in sorted(MOTIONS_DIR.glob("*.npz"))]
    assert (support.novelty(np.concatenate(clips)) <= 1.0).mean() >= 0.99
    assert support.novelty(np.zeros((1, 24, 3)))[0] == 0.0, "garments are made in the T-pose"
    for name, pose in NAMED.items():
        assert support.novelty(pose)[0] > 1.0, name
    generator = np.random.default_rng(0)
    for spread_rad in (0.7, np.pi, 1000.0):
        uniform = generator.uniform(-spread_rad, spread_rad, (200, 24, 3))
        assert (support.novelty(uniform) > 1.0).mean() >= 0.99, spread_rad


def test_rows_are_the_matrices_of_drape_geometry_and_poses_may_be_read_only():
    poses = np.random.default_rng(1).normal(size=(20, 24, 3))
    poses[0] = 0.0
    poses.flags.writeable = False
    matrices = rotvec_to_matrix(poses)
    sixd, parts = matrix_to_sixd(matrices), pose_parts(poses)
    for name, joints in (("legs", LEGS), ("trunk", TRUNK)):
        np.testing.assert_allclose(parts[name], sixd[:, joints].reshape(20, -1), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(parts["tilt"], matrices[:, 0, 1], rtol=0.0, atol=1e-14)


def test_where_a_body_faces_does_not_count_but_its_tilt_does(support: PoseSupport):
    poses = read_motion(MOTIONS_DIR / "walk.npz").poses[::20].copy()
    before = support.distances(poses)
    for turn, same in (((0.0, 2.0, 0.0), True), ((2.0, 0.0, 0.0), False)):
        turned = poses.copy()
        turned[:, 0] = matrix_to_rotvec(rotvec_to_matrix(np.array(turn)) @ rotvec_to_matrix(poses[:, 0]))
        found = support.distances(turned)
        np.testing.assert_allclose(found[:, :2], before[:, :2], rtol=0.0, atol=1e-6)
        assert np.allclose(found[:, 2], before[:, 2], rtol=0.0, atol=1e-3) == same


def test_frames_scored_together_are_those_scored_alone(support: PoseSupport):
    poses = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 24, 3))
    alone = [support.novelty(pose[None])[0] for pose in poses]
    np.testing.assert_allclose(support.novelty(poses), alone, rtol=1e-5)


def test_what_is_written_is_read_and_anything_else_refused(support: PoseSupport, tmp_path: Path):
    path = tmp_path / "poses.npz"
    path.write_bytes(support.to_bytes())
    again = read_pose_support(path)
    assert all(np.array_equal(getattr(again, name), getattr(support, name)) for name in ("legs", "trunk", "limits"))
    np.savez(path, legs=support.legs, trunk=support.trunk, tilt=support.tilt, limits=np.zeros(3))
    with pytest.raises(ArtifactError, match=r"poses.npz: expected kept poses.*limits.*pose_support"):
        read_pose_support(path)
    path.write_bytes(b"no archive")
    with pytest.raises(ArtifactError, match=r"poses\.npz: expected kept poses"):
        read_pose_support(path)


def test_mixed_poses_mix_what_is_kept_and_are_none_that_training_never_saw(support: PoseSupport):
    poses = mixed_poses(support, 40)
    assert poses.shape == (40, 24, 3) and support.novelty(poses).max() < 0.05
    np.testing.assert_array_equal(poses, mixed_poses(support, 40))
    assert len(np.unique(poses.round(6), axis=0)) == 40
    assert len(mixed_poses(support, 10_000)) == len(support.legs)
