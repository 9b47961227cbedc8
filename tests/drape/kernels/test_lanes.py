"""Rows of numbers in kernels: what they compute is what numpy does lane by lane."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_allclose, assert_array_equal

from drape.kernels.compiled import FAST
from drape.kernels.lanes import (
    LANES,
    exponential,
    least,
    most,
    normals_at,
    number_at,
    points_at,
    points_in,
    put,
    put3,
    put_points,
    root,
    row_at,
    rows3_at,
    samples_at,
    spared_at,
    sums,
    tangent,
    where_above,
    where_other,
)

DTYPES = [np.float32, np.float64]


@njit(error_model="numpy", fastmath=FAST)
def _computed(a, b, out):
    x, y = row_at(a, 1), row_at(b, 0)
    put(out, 0, x + y)
    put(out, LANES, 2.0 - x)
    put(out, 2 * LANES, x * 0.5 / y)
    put(out, 3 * LANES, -root(y))
    put(out, 4 * LANES, where_above(x, y, x, 3.0))
    put(out, 5 * LANES, most(x, 0.25))
    put(out, 6 * LANES, least(x, y))
    put(out, 7 * LANES, number_at(b, 3))


@njit(error_model="numpy", fastmath=FAST)
def _moved(x, skin, index, other, out):
    put3(out, 0, points_at(x, index, 1))
    a, b, c, _ = samples_at(skin, index, 1)
    put3(out, 3 * LANES, (a, b, c))
    a, b, c, d = normals_at(skin, index, 1)
    put3(out, 6 * LANES, (a, b, c))
    put(out, 9 * LANES, d)
    put(out, 10 * LANES, where_other(index, 1, other, 0, row_at(out, 0)))
    put3(out, 11 * LANES, points_in(x, 2))
    a, b, c = rows3_at(out, 0)
    out[14 * LANES], out[14 * LANES + 1], out[14 * LANES + 2] = sums(a, b, c)
    put3(out, 15 * LANES, spared_at(x, index, 1))
    put_points(x, 2, points_at(x, index, 1))


@pytest.mark.parametrize("dtype", DTYPES)
def test_numbers_are_those_of_each_lane(rng, dtype):
    a, b = rng.uniform(0.1, 1.0, size=(2, LANES + 1)).astype(dtype)
    a[3] = b[5] = np.nan
    out = np.empty(8 * LANES, dtype)
    _computed(a, b, out)
    x, y, found = a[1:], b[:-1], out.reshape(8, LANES)
    wanted = [x + y, 2.0 - x, x * 0.5 / y, -np.sqrt(y), np.where(x > y, x, 3.0)]
    # Of NaN the second one stays.
    wanted += [np.where(x > 0.25, x, 0.25), np.where(y > x, x, y), np.full(LANES, b[3])]
    assert_allclose(found, wanted, rtol=2.0 * np.finfo(dtype).eps)


@pytest.mark.parametrize("dtype", DTYPES)
def test_points_come_from_their_places_and_go_there(rng, dtype):
    x, skin = rng.normal(size=(25, 3)).astype(dtype)[:24], rng.normal(size=(24, 8)).astype(dtype)
    index = np.append(5, rng.permutation(24)[:LANES]).astype(np.int32)
    index[[2, 9]] = 23, 0  # the last row, behind which nothing may be read
    other, out, before = index[1:].copy(), np.empty(18 * LANES, dtype), x.copy()
    other[7] += 1
    _moved(x, skin, index, other, out)
    taken, found = before[index[1:]], out.reshape(18, LANES)
    assert_array_equal(found[:3], taken.T)
    assert_array_equal(found[15:], taken.T)
    assert_array_equal(found[3:6], skin[index[1:], :3].T)
    assert_array_equal(found[6:10], skin[index[1:], 4:].T)
    assert_array_equal(found[10], np.where(np.arange(LANES) == 7, taken[:, 0], 0.0))
    assert_array_equal(found[11:14], before[2 : LANES + 2].T)
    assert_allclose(found[14, :3], taken.sum(axis=0), rtol=0.0, atol=LANES * np.finfo(dtype).eps * np.abs(taken).max())
    wanted = before.copy()
    wanted[2 : LANES + 2] = taken
    assert_array_equal(x, wanted)


def test_exponentials_and_tangents_are_numpys():
    for dtype, rounding in ((np.float32, 2e-7), (np.float64, 1e-8)):
        x = np.concatenate([np.linspace(-79.0, 79.0, 320), np.linspace(-1.0, 1.0, 160)]).astype(dtype)
        grown, bent = np.empty_like(x), np.empty_like(x)
        _grow_and_bend(x, grown, bent)
        assert_allclose(grown, np.exp(x.astype(np.float64)), rtol=rounding)
        assert_allclose(bent, np.tanh(x.astype(np.float64)), rtol=0, atol=rounding)
    far = np.tile([-1e9, 1e9, -200.0, 200.0], 4)
    grown, bent = np.empty_like(far), np.empty_like(far)
    _grow_and_bend(far, grown, bent)
    assert_allclose(grown, np.exp(np.clip(far, -80.0, 80.0)), rtol=1e-8)
    assert_array_equal(bent, np.sign(far))


@njit(error_model="numpy", fastmath=FAST)
def _grow_and_bend(x, grown, bent):
    for first in range(0, len(x), LANES):
        put(grown, first, exponential(row_at(x, first)))
        put(bent, first, tangent(row_at(x, first)))
