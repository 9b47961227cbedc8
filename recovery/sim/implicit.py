"""Gradients through the solution of equations: one adjoint solve, then one scalar to differentiate.

A problem finds s with r(s, p) = 0, where p are the leaves: state and parameters. With A = dr/ds symmetric and
A w = dL/ds, the derivative dL/dp is that of the scalar -w . r(s, p) with w and s held. The scalar is a sum
over elements, so that no third derivative of an energy is ever stored.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from recovery.sim.assembly import Factor
from recovery.sim.cloth_model import ClothState, Parameters


class ImplicitProblem(Protocol):
    """Equations for node vectors (V, 3), with what their adjoint needs."""

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        """The solution s (V, 3)."""
        ...

    def factor(self, solution: Tensor, state: ClothState, parameters: Parameters) -> Factor:
        """dr/ds at the solution, factored; rows of fixed nodes those of the identity."""
        ...

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        """Returns -w . r (), differentiable by ``state`` and ``parameters``, for the ``weights`` w (V, 3) and the
        residual r (V, 3) of the equations at ``solution``."""
        ...

    @property
    def free(self) -> Tensor:
        """1 at nodes that move and 0 elsewhere (V, 1)."""
        ...


class _Implicit(torch.autograd.Function):
    @staticmethod
    def forward(ctx, problem: ImplicitProblem, *leaves: Tensor) -> Tensor:  # type: ignore[override]
        solution = problem.solve(*_unpacked(leaves))
        ctx.problem = problem
        ctx.save_for_backward(solution, *leaves)
        return solution

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[override]
        solution, *leaves = ctx.saved_tensors
        problem: ImplicitProblem = ctx.problem
        wanted = [i for i in range(len(leaves)) if ctx.needs_input_grad[i + 1]]
        factor = problem.factor(solution, *_unpacked(leaves))
        weights = factor.solve(np.ascontiguousarray((problem.free * gradient).numpy()).reshape(-1))
        with torch.enable_grad():
            copies = [leaf.detach().requires_grad_(i in wanted) for i, leaf in enumerate(leaves)]
            scalar = problem.adjoint(torch.from_numpy(weights).reshape(-1, 3), solution, *_unpacked(copies))
            found = torch.autograd.grad(scalar, [copies[i] for i in wanted], allow_unused=True)
        gradients: list[Tensor | None] = [None] * len(leaves)
        for i, value in zip(wanted, found, strict=True):
            gradients[i] = value
        return None, *gradients


def _unpacked(leaves: tuple[Tensor, ...] | list[Tensor]) -> tuple[ClothState, Parameters]:
    return ClothState(*leaves[:2]), Parameters(*leaves[2:])


def solution(problem: ImplicitProblem, state: ClothState, parameters: Parameters) -> Tensor:
    """The problem's solution (V, 3), differentiable once by ``state`` and ``parameters``."""
    return _Implicit.apply(problem, *state, *parameters)  # type: ignore[return-value]
