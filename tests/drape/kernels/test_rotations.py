"""Rotations, compiled: those of ``drape.geometry.rotations``."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.geometry import rotations
from drape.kernels.rotations import put_matrix, put_product, put_quaternion, put_quaternions


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, np.pi, 40.0])
def test_quaternions_products_and_matrices(angle: float):
    turns = angle * np.random.default_rng(1).normal(size=(2, 3, 3))
    quaternions = np.full((2, 4, 4), 7.0)
    put_quaternions(turns, quaternions)
    assert_allclose(quaternions[:, :3], rotations.rotvec_to_quaternion(turns), rtol=0.0, atol=1e-14)
    assert (quaternions[:, 3] == 7.0).all(), "rows behind the turns are left"
    first, second, product, matrix = (np.empty(n) for n in (4, 4, 4, 9))
    put_quaternion(turns[0, 0], first)
    put_quaternion(turns[1, 0], second)
    put_product(first, second, product)
    assert_allclose(product, rotations.quaternion_multiply(first, second), rtol=0.0, atol=1e-14)
    put_matrix(3.0 * first, matrix)
    assert_allclose(matrix.reshape(3, 3), rotations.rotvec_to_matrix(turns[0, 0]), rtol=0.0, atol=1e-14)
