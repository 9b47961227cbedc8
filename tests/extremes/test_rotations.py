"""Rotations where a formula divides by nothing: next to 0, pi and 2 pi, and descriptors that describe none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.geometry.rotations import (
    matrix_to_quaternion,
    matrix_to_rotvec,
    quaternion_slerp,
    quaternion_to_matrix,
    quaternion_to_rotvec,
    rotvec_to_matrix,
    rotvec_to_quaternion,
    sixd_to_matrix,
)

_DRAWN = np.random.default_rng(3).normal(size=(50, 3))
AXES = _DRAWN / np.linalg.norm(_DRAWN, axis=1, keepdims=True)
ANGLES = [
    middle + sign * away for middle in (0.0, np.pi, 2.0 * np.pi) for sign in (-1, 1)
    for away in (0.0, 1e-300, 1e-40, 1e-15, 1e-8, 1e-5, 1e-4, 1e-3)
]  # fmt: skip


@pytest.mark.parametrize(("dtype", "limit"), [(np.float64, 1e-14), (np.float32, 2e-6)])
def test_turns_next_to_none_half_and_whole_are_rotations(dtype: type, limit: float):
    """Guards against sin(x) / x of a subnormal, and against the jump of the axis at a half turn."""
    rotvec = (np.array(ANGLES)[:, None, None] * AXES).reshape(-1, 3).astype(dtype)
    wanted = Rotation.from_rotvec(rotvec.astype(np.float64)).as_matrix()
    for found in (rotvec_to_matrix(rotvec), quaternion_to_matrix(rotvec_to_quaternion(rotvec))):
        assert_allclose(found, wanted, rtol=0.0, atol=limit)
        assert_allclose(rotvec_to_matrix(matrix_to_rotvec(found)), wanted, rtol=0.0, atol=8.0 * limit)


@pytest.mark.parametrize(
    "sixd",
    [np.zeros(6), [1, 0, 0, 1, 0, 0], [1, 0, 0, -2, 0, 0], [0, 0, 0, 0, 1, 0], np.full(6, 1e-40), np.full(6, 1e30)],
    ids=["none", "parallel", "against", "no first", "subnormal", "huge"],
)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_degenerate_6d_descriptor_gives_finite_numbers(sixd: list[float], dtype: type):
    """Guards against NaN that spreads from one joint to the drape: such a descriptor names no rotation."""
    with np.errstate(over="ignore", under="ignore"):
        found = sixd_to_matrix(np.asarray(sixd, dtype=dtype))
    assert np.isfinite(found).all() and np.abs(found).max() <= 1.0 + 1e-6


def test_degenerate_quaternions_give_finite_numbers():
    """Guards against the division by the length of a quaternion that has none, or by the sine of no angle."""
    ends = np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 1e-9, 0, 0], [np.cos(1e-8), 1e-8, 0, 0]])
    for start in ends:
        between = quaternion_slerp(np.broadcast_to(start, ends.shape), ends, np.full(len(ends), 0.5))
        assert_allclose(np.linalg.norm(between, axis=1), 1.0, rtol=0.0, atol=1e-12)
    assert_allclose(quaternion_to_rotvec(np.zeros(4)), np.zeros(3))
    assert_allclose(quaternion_to_matrix(np.zeros(4)), np.eye(3))
    assert_allclose(matrix_to_quaternion(np.zeros((3, 3))), [1.0, 0.0, 0.0, 0.0])
