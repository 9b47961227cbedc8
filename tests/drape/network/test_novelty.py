"""Novelty by the engine: the numbers of ``PoseSupport``, frame by frame."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.artifacts import DEFAULT_MODEL, load_manifest, model_folder
from drape.body.pose_distance import read_pose_support
from drape.network.novelty import kept_poses, novelty


def test_it_is_that_of_the_readable_formula_and_of_each_frame_alone():
    spec = load_manifest(model_folder(DEFAULT_MODEL)).poses
    assert spec is not None
    support = read_pose_support(model_folder(DEFAULT_MODEL) / spec.file)
    generator = np.random.default_rng(3)
    poses = generator.normal(size=(30, 24, 3)) * generator.uniform(0.0, 2.0, (30, 1, 1))
    poses[0] = 0.0
    poses.flags.writeable = False
    kept = kept_poses(support)
    found = novelty(kept, poses)
    assert found[0] < 1e-3
    assert_allclose(found, support.novelty(poses), rtol=1e-4, atol=1e-3)
    assert_array_equal(found, [novelty(kept, pose[None])[0] for pose in poses])
