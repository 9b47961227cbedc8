"""What kernels tell of whole arrays; formulas of elements are compared in ``test_problem``."""

from __future__ import annotations

import numpy as np
import pytest

from drape.kernels.compiled import kernel
from drape.kernels.elements import are_finite, at


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 17, 99])
def test_one_number_that_is_not_finite_is_found(bad: float, place: int):
    values = np.random.default_rng(0).normal(size=100).astype(np.float32)
    values[50] = np.finfo(np.float32).max
    assert are_finite(values)
    values[place] = bad
    assert not are_finite(values)


@kernel
def row_of(x, v):
    return at(x, v)


def test_a_row_is_found_however_its_array_lies_in_memory():
    x = np.arange(40.0).reshape(5, 8)
    for laid in (x, np.asfortranarray(x), np.repeat(x, 2, axis=0)[::2]):
        for v in (0, np.int32(3), np.uint32(4)):
            assert row_of(laid, v) == at(x, v) == tuple(x[v, :3])
