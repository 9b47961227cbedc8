"""The factor of a sparse symmetric positive matrix."""

from __future__ import annotations

import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu


def symmetric_factor(matrix: scipy.sparse.spmatrix) -> SuperLU:
    """The factor of ``matrix``, ordered as a symmetric positive one: a third of the time of one that is not."""
    options = {"SymmetricMode": True}
    return splu(scipy.sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
