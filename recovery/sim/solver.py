"""Factors of sparse symmetric matrices, by SuperLU."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu

from drape.errors import InputError


class SingularMatrix(InputError):
    """A matrix without an inverse. Whether one that is nearly so has a factor is rounding's choice."""


class Factor:
    """A sparse symmetric matrix A, factored: P A P^T = L U with pivots on its diagonal and a permutation P."""

    def __init__(self, factor: SuperLU) -> None:
        self._factor = factor

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """The solution (n,) for the right side (n,)."""
        return self._factor.solve(rhs)

    def negative_pivots(self) -> int:
        """The number of negative eigenvalues (Sylvester's law)."""
        return int((self._factor.U.diagonal() < 0.0).sum())


def superlu(matrix: scipy.sparse.csc_matrix) -> Factor:
    """SuperLU in its symmetric mode: ordering of A^T + A, pivots on the diagonal (half the time of the default)."""
    if not np.isfinite(matrix.data).all():
        raise InputError(
            "simulation step",
            expected="finite forces",
            got="NaN or infinity in the system matrix",
            cure="Check the start shape for collapsed triangles, or take a smaller time step.",
        )
    try:
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise SingularMatrix(
            "simulation step",
            expected="a regular system matrix",
            got=str(error),
            cure="Fix some nodes or let the garment touch the body: nothing holds it.",
        ) from error
    return Factor(factor)
