"""The factor of a symmetric matrix against the dense solution."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.testing import assert_allclose

from drape.geometry.symmetric import ShiftedSystems, symmetric_factor


def test_it_solves_what_the_dense_matrix_solves():
    random = np.random.default_rng(0)
    half = scipy.sparse.csr_matrix(random.normal(size=(60, 60)) * (random.uniform(size=(60, 60)) < 0.1))
    matrix, right = scipy.sparse.csr_matrix(half @ half.T + scipy.sparse.identity(60)), random.normal(size=(60, 3))
    assert_allclose(symmetric_factor(matrix).solve(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-9)


def test_systems_with_other_diagonals_are_solved_in_the_order_of_the_first():
    random = np.random.default_rng(1)
    half = scipy.sparse.csr_matrix(random.normal(size=(80, 80)) * (random.uniform(size=(80, 80)) < 0.05))
    matrix, systems = half @ half.T, ShiftedSystems(half @ half.T)
    for scale in (1.0, 0.3, 2.0):
        diagonal, right = random.uniform(0.5, 1.0, 80), random.normal(size=(80, 3))
        dense = np.diag(diagonal) + scale * matrix.toarray()
        assert_allclose(systems.solve(diagonal, scale, right), np.linalg.solve(dense, right), rtol=1e-8)
