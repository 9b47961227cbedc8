"""The slopes of measures are those of small steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.measure_slopes import measure_slopes
from drape.body.measures import measures
from drape.body.model import BodyModel

STEP = 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_slopes_are_those_of_small_steps(body: BodyModel, seed: int):
    betas = np.random.default_rng(seed).normal(size=10)
    steps = STEP * np.eye(10)
    pairs = [(measures(body, betas + step), measures(body, betas - step)) for step in steps]
    want = np.array([np.subtract(more, less) for more, less in pairs]).T / (2.0 * STEP)
    # A measure's rounding over the step: that of metres, and that of 100 kg which are a sum of some 10^5 products.
    lengths, weight = (slice(0, 7), slice(7, 8))
    found = measure_slopes(body, betas)
    assert_allclose(found[lengths], want[lengths], rtol=1e-6, atol=16.0 * np.finfo(float).eps / STEP)
    assert_allclose(found[weight], want[weight], rtol=1e-6, atol=100.0 * np.sqrt(1e5) * np.finfo(float).eps / STEP)


def test_steps_as_wide_as_edges_keep_to_the_slopes(body: BodyModel, rng):
    """A section passes from edge to edge on the way, and its kinks stay small."""
    betas, way = 0.5 * rng.normal(size=10), 0.05 * rng.normal(size=10)
    change = np.subtract(measures(body, betas + way), measures(body, betas - way)) / 2.0
    assert_allclose(measure_slopes(body, betas) @ way, change, rtol=0.02, atol=3e-4)
