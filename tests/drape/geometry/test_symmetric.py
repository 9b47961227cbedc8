"""The factor of a symmetric matrix against the dense solution."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.testing import assert_allclose

from drape.geometry.symmetric import symmetric_factor


def test_it_solves_what_the_dense_matrix_solves():
    random = np.random.default_rng(0)
    half = scipy.sparse.csr_matrix(random.normal(size=(60, 60)) * (random.uniform(size=(60, 60)) < 0.1))
    matrix, right = scipy.sparse.csr_matrix(half @ half.T + scipy.sparse.identity(60)), random.normal(size=(60, 3))
    assert_allclose(symmetric_factor(matrix).solve(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-9)
