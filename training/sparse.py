"""Sparse products with a gradient: the blend of patches into vertices as one matrix, on CPU and GPU."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import torch
from torch import Tensor


@dataclass(frozen=True)
class SparsePair:
    """A constant sparse matrix and its transpose, both CSR, so that neither direction scatters."""

    forward: Tensor
    transposed: Tensor

    @classmethod
    def from_scipy(cls, matrix: scipy.sparse.csr_matrix, *, device: torch.device) -> SparsePair:
        return cls(_csr(matrix, device), _csr(scipy.sparse.csr_matrix(matrix.T), device))


def _csr(matrix: scipy.sparse.csr_matrix, device: torch.device) -> Tensor:
    matrix.sort_indices()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            torch.from_numpy(matrix.indptr.astype(np.int32)),
            torch.from_numpy(matrix.indices.astype(np.int32)),
            torch.from_numpy(matrix.data.astype(np.float32)),
            size=matrix.shape,
            device=device,
            check_invariants=False,
        )


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, dense: Tensor, forward: Tensor, transposed: Tensor) -> Tensor:  # type: ignore[override]
        ctx.transposed = transposed
        return forward @ dense

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[override]
        return ctx.transposed @ gradient.contiguous(), None, None


def product(pair: SparsePair, dense: Tensor) -> Tensor:
    """``matrix @ dense`` (V, n), differentiable in ``dense`` (m, n)."""
    return _Product.apply(dense, pair.forward, pair.transposed)
