"""Sweeps of vertex block descent: how far free cloth goes."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.engine.calls import call
from drape.engine.library import LANES
from tests.drape.live.folds_setup import PLANE_ROWS as ROWS
from tests.drape.live.folds_setup import constants, sleeve, spared

OTHER, NEAR = 6, 18  # of the rows of a block of planes: the other plane, and where other cloth is near


def test_free_cloth_goes_half_as_far_again_in_a_sweep_that_others_follow(rng):
    """The first block moves before its neighbours do: 1.5 of its step off the skin, all of it beside skin or cloth."""
    made = constants(creased=False, dtype=np.float64)
    x = spared(sleeve(creased=False)[0][made.sheet.vertex] + 0.001 * rng.normal(size=(len(made.sheet.vertex), 3)))
    planes = np.empty(ROWS * len(x))
    call("law_hold", np.float64, made, planes)
    first = planes[: ROWS * LANES].reshape(ROWS, LANES)
    first[1], first[4] = x[:LANES, 1] - np.where(np.arange(LANES) % 2, 0.021, 0.019), 1.0  # points below, normals
    first[0], first[2] = x[:LANES, 0], x[:LANES, 2]
    first[OTHER + 4, 1:8:3], first[NEAR, 9::3] = 1.0, 1.0
    first[OTHER + 1, 1:8:3] = -10.0
    steps = []
    for over in (0, 1):
        call("law_sweep", np.float64, found := spared(x), made, planes, x, over)
        steps.append((found - x)[:LANES])
    free = (np.arange(LANES) % 2 == 1) & (first[OTHER + 4] == 0.0) & (first[NEAR] == 0.0)
    assert 2 < free.sum() < LANES - 6 and (np.linalg.norm(steps[0], axis=1) > 1e-6).all()
    assert_allclose(steps[1], np.where(free, 1.5, 1.0)[:, None] * steps[0], rtol=1e-9)
