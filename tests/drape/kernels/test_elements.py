"""What kernels tell of whole arrays; formulas of elements are compared in ``test_problem``."""

from __future__ import annotations

import numpy as np
import pytest

from drape.kernels.elements import are_finite


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 17, 99])
def test_one_number_that_is_not_finite_is_found(bad: float, place: int):
    values = np.random.default_rng(0).normal(size=100).astype(np.float32)
    values[50] = np.finfo(np.float32).max
    assert are_finite(values)
    values[place] = bad
    assert not are_finite(values)
