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

from recovery.sim.model import ClothState, Parameters
from recovery.sim.solver import Factor


class Problem(Protocol):
    """Equations for node vectors (V, 3), with what their adjoint needs."""

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        """The solution s (V, 3)."""
        ...

    def factor(self, solution: Tensor, state: ClothState, parameters: Parameters) -> Factor:
        """dr/ds at the solution, factored; rows of fixed nodes those of the identity."""
        ...

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        """-w . r(s, p), differentiable by ``state`` and ``parameters``."""
        ...

    @property
    def free(self) -> Tensor:
        """1 at nodes that move and 0 elsewhere (V, 1)."""
        ...


class _Implicit(torch.autograd.Function):
    @staticmethod
    def forward(ctx, problem: Problem, *leaves: Tensor) -> Tensor:  # type: ignore[override]
        solution = problem.solve(*_unpacked(leaves))
        ctx.problem = problem
        ctx.save_for_backward(solution, *leaves)
        return solution

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[override]
        solution, *leaves = ctx.saved_tensors
        problem: Problem = ctx.problem
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


def solution(problem: Problem, state: ClothState, parameters: Parameters) -> Tensor:
    """The problem's solution (V, 3), differentiable once by ``state`` and ``parameters``."""
    return _Implicit.apply(problem, *state, *parameters)  # type: ignore[return-value]


def tangent(
    problem: Problem, state: ClothState, parameters: Parameters, changes: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """The solution (V, 3) and its derivative (V, 3) along ``changes``, directions by the names of the leaves.

    Forward mode: the scalar of the adjoint is linear in its weights, so that the derivative by them gives the
    right side of one more solve with the same factor. For sensitivities with few parameters and many outputs.
    """
    with torch.no_grad():
        solution = problem.solve(state, parameters)
    names = [*ClothState._fields, *Parameters._fields]
    values = dict(zip(names, [*state, *parameters], strict=True))
    with torch.enable_grad():
        copies = {name: value.detach().requires_grad_(name in changes) for name, value in values.items()}
        weights = torch.zeros_like(solution).requires_grad_(True)
        scalar = problem.adjoint(weights, solution, *_unpacked(list(copies.values())))
        wanted = [copies[name] for name in changes]
        slopes = torch.autograd.grad(scalar, wanted, create_graph=True, allow_unused=True, materialize_grads=True)
        along = sum((slope * change).sum() for slope, change in zip(slopes, changes.values(), strict=True))
        (rhs,) = torch.autograd.grad(torch.as_tensor(along), weights)
    factor = problem.factor(solution, state, parameters)
    moved = factor.solve(np.ascontiguousarray((problem.free * rhs).numpy()).reshape(-1))
    return solution, torch.from_numpy(moved).reshape(-1, 3)
