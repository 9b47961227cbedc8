"""A row that turns and moves a point."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_allclose, assert_array_equal

from drape.kernels.affine import put_moved
from drape.kernels.compiled import FAST
from drape.kernels.lanes import row_at


@njit(error_model="numpy", fastmath=FAST)
def _moved(x, row, out):
    put_moved(out, x, 1, row_at(row, 0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_row_moves_a_point(rng, dtype):
    x, out = rng.normal(size=(3, 3)).astype(dtype), np.full((3, 3), 7.0, dtype)
    columns = rng.normal(size=(4, 4)).astype(dtype)
    columns[:, 3] = np.nan
    _moved(x, columns.reshape(-1), out)
    assert_allclose(
        out[1], x[1] + columns[:3, :3].T @ x[1] + columns[3, :3], rtol=10.0 * np.finfo(dtype).eps, atol=1e-6
    )
    assert_array_equal(out[[0, 2]], 7.0)
