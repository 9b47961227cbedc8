"""Points in whole steps: the bits of the readable formula, whatever the number of points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.wire import messages
from drape.wire.quantised import quantise


@pytest.mark.parametrize("count", [messages.BYTE_COUNT, messages.STEP_COUNT])
@pytest.mark.parametrize("points", [1, 15, 16, 17, 500])
def test_steps_corner_and_size_are_those_of_the_formula(points: int, count: int):
    positions = np.random.default_rng(points).normal(size=(points, 3)).astype(np.float32)
    for got, want in zip(quantise(positions, count), messages.quantise(positions, count), strict=True):
        assert got.dtype == want.dtype
        assert_array_equal(got, want)


def test_a_flat_box_and_points_that_nobody_may_write():
    positions = np.full((20, 3), 0.25)
    positions[:, 0] = np.linspace(-1.0, 1.0, 20)
    positions.flags.writeable = False
    steps, low, size = quantise(positions)
    assert_array_equal(steps[:, 1:], 0)
    assert steps[0, 0] == 0 and steps[-1, 0] == messages.STEP_COUNT
    assert_array_equal(low, np.array([-1.0, 0.25, 0.25], np.float32))
    assert_array_equal(size[1:], np.float32(messages.FLAT_M))
