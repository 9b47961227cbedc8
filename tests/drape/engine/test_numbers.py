"""Functions of single numbers are those of NumPy, to two units in the last place."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_max_ulp

from drape.engine.calls import call


def test_exponentials_and_logarithms_are_numpys():
    x = np.concatenate([np.linspace(-690.0, 690.0, 1001), np.linspace(-1.0, 1.0, 1001)])
    exponential, logarithm = np.empty_like(x), np.empty_like(x)
    call("law_exponentials", x.dtype, x, len(x), exponential, logarithm)
    assert_array_max_ulp(exponential, np.exp(x), 2)
    assert_array_max_ulp(logarithm, np.log(exponential), 2)
