"""Sparse symmetric linear systems: one factor, many right sides, and a gradient through it.

A solver is a function from a matrix to an object with ``solve``; SuperLU on the CPU is ours, and another
(on a GPU, say) fits the same two lines.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse
import torch
from scipy.sparse.linalg import SuperLU, splu
from torch import Tensor

from drape.errors import InputError


class Factor(Protocol):
    """A factored symmetric matrix."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """The solution (n,) for the right side (n,)."""
        ...

    def negative_pivots(self) -> int:
        """How many eigenvalues are negative (Sylvester's law)."""
        ...


LinearSolver = Callable[[scipy.sparse.csc_matrix], Factor]


class _SuperLu:
    """A factor P A P^T = L U with the pivots of A's own diagonal."""

    def __init__(self, factor: SuperLU) -> None:
        self._factor = factor

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        return self._factor.solve(rhs)

    def negative_pivots(self) -> int:
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
        raise InputError(
            "simulation step",
            expected="a regular system matrix",
            got=str(error),
            cure="Fix some nodes or let the garment touch the body: nothing holds it.",
        ) from error
    return _SuperLu(factor)


class _Solve(torch.autograd.Function):
    @staticmethod
    def forward(ctx, values: Tensor, rhs: Tensor, pattern, solver: LinearSolver) -> Tensor:  # type: ignore[override]
        rows, starts = pattern
        shape = (len(starts) - 1, len(starts) - 1)
        matrix = scipy.sparse.csc_matrix((values.detach().numpy(), rows, starts), shape=shape)
        ctx.factor = solver(matrix)
        ctx.rows, ctx.columns = rows, np.repeat(np.arange(shape[0]), np.diff(starts))
        solution = torch.from_numpy(ctx.factor.solve(rhs.detach().numpy()))
        ctx.save_for_backward(solution)
        return solution

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[override]
        (solution,) = ctx.saved_tensors
        weights = torch.from_numpy(ctx.factor.solve(gradient.numpy()))
        return -weights[ctx.rows] * solution[ctx.columns], weights, None, None


def solve(
    values: Tensor, rhs: Tensor, *, rows: np.ndarray, starts: np.ndarray, solver: LinearSolver = superlu
) -> Tensor:
    """x of A x = ``rhs`` for the symmetric A with CSC pattern ``rows``, ``starts``; differentiable in both.

    The derivative of every stored entry is returned, as if the two mirrored ones were independent.
    """
    return _Solve.apply(values, rhs, (rows, starts), solver)  # type: ignore[return-value]
