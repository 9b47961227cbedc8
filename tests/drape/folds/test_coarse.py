"""Patches that move as wholes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.folds.coarse import CLAMP_M, SHARE, _solve, coarse_step
from drape.folds.constants import Constants
from drape.folds.sheet import LANES
from drape.folds.sweeps import SCRATCH, gradient_at
from tests.drape.folds.folds_setup import sleeve


def pressed(depth_m: float, *, dtype: type[np.floating] = np.float64, level=None):
    """How far [m] (P, 3) a coarse step moves a sleeve without weight that is ``depth_m`` [m] too deep in planes."""
    rest, dressed = sleeve("rib", creased=False)
    constants = Constants.of(dressed, dtype=dtype)
    sheet = constants.sheet
    level = level(constants.level) if level else constants.level
    own = sheet.own.reshape(-1, 4, LANES).copy()
    own[:, 0] = 0.0
    sheet = sheet._replace(own=own.reshape(-1))
    x = rest[sheet.vertex].astype(dtype)
    up = np.tile(np.array([0.0, 0.0, 1.0], dtype), (len(x), 1))
    point = x + dtype(depth_m - 0.004) * up  # contact begins at a gap of 4 mm
    blocks = [rows.reshape(-1, LANES, 3) for rows in (point, up, 0.0 * up, 0.0 * up)]  # no other part is near
    rows = np.concatenate(blocks, axis=2).transpose(0, 2, 1)
    planes, gradient = np.ascontiguousarray(rows).reshape(-1), np.empty_like(x)
    gradient_at(x, sheet, planes, x.copy(), np.empty(SCRATCH, dtype), gradient)
    before = x.copy()
    coarse_step(x, level, sheet, planes, gradient, dtype(SHARE))
    return (x - before)[sheet.place]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_coarse_step_lifts_what_is_pressed(dtype):
    moved = pressed(0.002, dtype=dtype)
    assert moved.dtype == dtype
    assert_allclose(moved[:, 2], SHARE * 0.002, rtol=2e-2, atol=0.0)
    assert_allclose(moved[:, :2], 0.0, rtol=0.0, atol=1e-5)


def test_a_coarse_step_is_clamped():
    assert_allclose(pressed(0.2)[:, 2], CLAMP_M, rtol=2e-2, atol=0.0)


@pytest.mark.parametrize("factor", [-1e9, np.nan])
def test_a_matrix_without_a_factor_moves_nothing(factor):
    assert_array_equal(pressed(0.002, level=lambda level: level._replace(matrix=factor * level.matrix)), 0.0)


def test_the_envelope_solves_what_a_dense_matrix_solves(rng):
    first = np.array([0, 0, 1, 0, 3, 2], np.int32)
    count = len(first)
    size = 9 * (np.arange(count) - first + 1)
    row = (np.cumsum(size) - size).astype(np.int32)
    lower = np.zeros((3 * count, 3 * count))
    for i, start in enumerate(first):
        lower[3 * i : 3 * i + 3, 3 * start : 3 * i + 3] = rng.normal(size=(3, 3 * (i - start + 1)))
    dense = np.tril(lower, -1) + np.tril(lower, -1).T + 60.0 * np.eye(3 * count)
    matrix = np.concatenate([dense[3 * i : 3 * i + 3, 3 * first[i] : 3 * i + 3].reshape(-1) for i in range(count)])
    y = rng.normal(size=(count, 3))
    wanted = np.linalg.solve(dense, y.reshape(-1)).reshape(count, 3)
    assert _solve(first, row, matrix, y)
    assert_allclose(y, wanted, rtol=0.0, atol=1e-12)
