"""Bodies as the network sees them: what motion is told of them is what the readable formulas say."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.graph.feeds import kinematics
from drape.network.bodies import moments
from tests.fixtures.poses import random_motion


@pytest.mark.parametrize("shaped", [False, True])
def test_moments_are_the_kinematics_of_features(shaped: bool):
    body, (poses, trans) = load_body(), random_motion(5, seed=1)
    poses[0] = 0.0
    poses[1] *= 1e-9  # where the angle is too small to divide by
    betas = np.linspace(-1.0, 1.0, body.shape_count) if shaped else None
    got, want = moments(body, poses, trans, betas), kinematics(body, poses, trans, betas)
    for name in ("static", "joints", "rotations"):
        assert_allclose(getattr(got, name), getattr(want, name), rtol=0, atol=1e-12, err_msg=name)
