"""Sparse matrices of the cloth: assembled by static maps, since the mesh never changes, and factored by SuperLU.

Section 3.4.3 and appendix B of Yu, Cordier and Seo (2024): one constant matrix of ones sums all element gradients into
the nodes, another all element Hessians into the entries of the global matrix, whose pattern is fixed too.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import SuperLU, splu

from drape.errors import InputError


class StaticAssembly:
    """Maps for groups of elements: ``elements`` are arrays (corner, n) of node numbers.

    The unknowns are numbered ``3 node + coordinate``. ``fixed`` (V,) marks nodes that do not move: their rows and
    columns of an assembled matrix are those of the identity.
    """

    def __init__(self, elements: list[np.ndarray], node_count: int, *, fixed: np.ndarray) -> None:
        self.node_count = node_count
        self.size = 3 * node_count
        self.free = np.repeat(~fixed, 3)
        unknowns = [
            (3 * nodes[:, None] + np.arange(3)[None, :, None]).reshape(-1, nodes.shape[1]) for nodes in elements
        ]
        diagonal = np.arange(self.size).reshape(-1, 3)
        row_groups = [np.broadcast_to(u[:, None], (len(u), *u.shape)) for u in unknowns]
        column_groups = [np.broadcast_to(u[None], (len(u), *u.shape)) for u in unknowns]
        row_groups.append(np.repeat(diagonal[:, :, None], 3, axis=2))
        column_groups.append(np.repeat(diagonal[:, None, :], 3, axis=1))
        # Column-major keys: SuperLU wants CSC, and the pattern is symmetric.
        keys = [(c.reshape(-1) * self.size + r.reshape(-1)) for r, c in zip(row_groups, column_groups, strict=True)]
        pattern, place = np.unique(np.concatenate(keys), return_inverse=True)
        splits = np.cumsum([len(key) for key in keys])[:-1]
        places = np.split(place.reshape(-1), splits)
        self.entry_count = len(pattern)
        self._rows = (pattern % self.size).astype(np.int32)
        columns = pattern // self.size
        self._starts = np.searchsorted(columns, np.arange(self.size + 1)).astype(np.int32)
        self._hessian_maps = [_ones(where, self.entry_count) for where in places[:-1]]
        self._block_places = places[-1].reshape(-1, 3, 3)
        self._gradient_maps = [_ones(u.reshape(-1), self.size) for u in unknowns]
        self._kept = self.free[self._rows] & self.free[columns]
        self._fixed_diagonal = (self._rows == columns) & ~self.free[columns]

    def gradient(self, stacks: list[np.ndarray]) -> np.ndarray:
        """Sum (V, 3) of element gradients (corner, 3, n), one stack per group."""
        pairs = zip(self._gradient_maps, stacks, strict=True)
        return sum((one @ stack.reshape(-1) for one, stack in pairs), np.zeros(self.size)).reshape(-1, 3)

    def matrix(self, stacks: list[np.ndarray], *, blocks: np.ndarray, scale: float) -> scipy.sparse.csc_matrix:
        """Returns ``scale`` times the sum of element Hessians (3 corner, 3 corner, n), plus ``blocks`` (V, 3, 3) of
        nodes.
        """
        data = np.zeros(self.entry_count)
        for one, stack in zip(self._hessian_maps, stacks, strict=True):
            data += one @ stack.reshape(-1)
        data *= scale
        data[self._block_places] += blocks
        data *= self._kept
        data[self._fixed_diagonal] = 1.0
        return scipy.sparse.csc_matrix((data, self._rows, self._starts), shape=(self.size, self.size))


def _ones(target: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """The matrix (count, n) that adds entry i of a vector to ``target[i]``."""
    n = len(target)
    return scipy.sparse.csr_matrix((np.ones(n), (target, np.arange(n))), shape=(count, n))


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
