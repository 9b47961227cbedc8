"""Implicit steps: the linearised Euler step of Yu, Cordier and Seo (2024), their equation 1, and what all steps share.

Gradients go through the solution of equations by one adjoint solve and one scalar to differentiate. A problem finds s
with r(s, p) = 0, where p are the leaves: state and parameters. With A = dr/ds symmetric and A w = dL/ds, the
derivative dL/dp is that of the scalar -w . r(s, p) with w and s held. The scalar is a sum over elements, so that no
third derivative of an energy is ever stored.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from recovery.sim.cloth_model import (
    ClothModel,
    ClothState,
    Factor,
    Parameters,
    Rest,
    elastic_bilinear,
    elastic_forces,
    elastic_hessian,
    elastic_work,
    superlu,
)
from recovery.sim.skin_contact import SkinContact, tangential

DAMPED_DT_S = 0.033


class ImplicitProblem(Protocol):
    """The equations r(s, p) = 0 for node vectors s (V, 3), where p are state and parameters, with what their adjoint
    needs."""

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        """Returns the solution s (V, 3)."""
        ...

    def factor(self, solution: Tensor, state: ClothState, parameters: Parameters) -> Factor:
        """Returns dr/ds (3 V, 3 V) at the ``solution``, factored; rows of fixed nodes are those of the identity."""
        ...

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        """Returns -w . r (), differentiable by ``state`` and ``parameters``, for the ``weights`` w (V, 3) and the
        residual r (V, 3) of the equations at ``solution``."""
        ...

    @property
    def free(self) -> Tensor:
        """1 at nodes that move and 0 at fixed ones, (V, 1)."""
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


def implicit_solution(problem: ImplicitProblem, state: ClothState, parameters: Parameters) -> Tensor:
    """Returns the solution (V, 3) of ``problem``, differentiable once by ``state`` and ``parameters``."""
    return _Implicit.apply(problem, *state, *parameters)  # type: ignore[return-value]


class SpringForces(NamedTuple):
    """Springs between nodes besides the cloth: ``force`` [N] (V, 3) and ``stiffness`` [N/m] (3 V, 3 V), zero at fixed
    nodes."""

    force: Tensor
    stiffness: scipy.sparse.csc_matrix


class LinearisedStep:
    """The equations of a step for its change of velocity dv [m/s]: (M + dt^2 K + dt D) dv = dt (f - dt K v - D v), with
    masses M, forces f, K the definite part of -df/dx, and D the drag of friction.

    With the whole of -df/dx the matrix would be indefinite as soon as cloth is compressed.
    """

    def __init__(
        self, model: ClothModel, contact: SkinContact | None, *, dt_s: float, pairs: SpringForces | None = None
    ) -> None:
        self.model, self.contact, self.pairs, self.dt_s = model, contact, pairs, dt_s
        self._factor: Factor | None = None

    @property
    def free(self) -> Tensor:
        return self.model.free

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        with torch.no_grad():
            model, dt = self.model, self.dt_s
            rest = model.rest(parameters.panels)
            force = elastic_forces(model, rest, parameters, state.x) + self._outer_force(state.x, rest, parameters)
            mass = parameters.density_kg_m2 * rest.node_area
            matrix = elastic_hessian(
                model,
                rest,
                parameters,
                state.x,
                definite=True,
                scale=dt * dt,
                blocks=self._blocks(state, rest, mass).numpy(),
            )
            if self.pairs is not None:
                force = force + self.pairs.force
                matrix = (matrix + dt * dt * self.pairs.stiffness).tocsc()
            moving = (self.free * state.v).reshape(-1).numpy()
            resisted = torch.from_numpy(matrix @ moving).reshape(-1, 3) - mass[:, None] * state.v
            rhs = self.free * (dt * force - resisted)
            self._factor = superlu(matrix)
            return torch.from_numpy(self._factor.solve(np.ascontiguousarray(rhs.numpy()).reshape(-1))).reshape(-1, 3)

    def factor(self, solution: Tensor, state: ClothState, parameters: Parameters) -> Factor:
        if self._factor is None:
            self.solve(state, parameters)
        assert self._factor is not None
        return self._factor

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        model, dt = self.model, self.dt_s
        rest = model.rest(parameters.panels)
        mass = parameters.density_kg_m2 * rest.node_area
        after = self.free * (state.v + solution)
        pushed = (weights * self._outer_force(state.x, rest, parameters)).sum()
        total = dt * (pushed - elastic_work(model, rest, parameters, state.x, weights))
        total = total - (mass[:, None] * weights * solution).sum()
        total = total - dt * dt * elastic_bilinear(model, rest, parameters, state.x, weights, after)
        if self.contact is not None:
            scale, r = self.contact.stiffness(state.x, rest.node_area)
            total = total - dt * dt * (scale * (weights * r).sum(dim=1) * (after * r).sum(dim=1)).sum()
            drag, normal = self.contact.drag(state.x, state.v, rest.node_area)
            total = total - dt * (drag * (weights * tangential(after, normal)).sum(dim=1)).sum()
        return total

    def _outer_force(self, x: Tensor, rest: Rest, parameters: Parameters) -> Tensor:
        """Weight, given forces and repulsion [N] (V, 3)."""
        force = parameters.force_n + (parameters.density_kg_m2 * rest.node_area)[:, None] * self.model.gravity
        return force if self.contact is None else force + self.contact.force(x, rest.node_area)

    def _blocks(self, state: ClothState, rest: Rest, mass: Tensor) -> Tensor:
        """The system's blocks (V, 3, 3) of single nodes: mass, repulsion, drag."""
        identity = torch.eye(3, dtype=mass.dtype)
        blocks = mass[:, None, None] * identity
        if self.contact is not None:
            scale, r = self.contact.stiffness(state.x, rest.node_area)
            drag, n = self.contact.drag(state.x, state.v, rest.node_area)
            blocks = blocks + (self.dt_s**2 * scale)[:, None, None] * r[:, :, None] * r[:, None, :]
            blocks = blocks + (self.dt_s * drag)[:, None, None] * (identity - n[:, :, None] * n[:, None, :])
        return blocks


def linearised_step(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    dt_s: float,
    contact: SkinContact | None = None,
    pairs: SpringForces | None = None,
) -> ClothState:
    """Returns the state ``dt_s`` [s] later by one linear solve (``LinearisedStep``); nodes in the body are then put
    outside (``SkinContact.corrected``). Differentiable once.

    ``pairs`` are springs between parts of the cloth, constant during the step, without a gradient. The factor is kept
    for the backward pass.
    """
    step = LinearisedStep(model, contact, dt_s=dt_s, pairs=pairs)
    v = state.v + implicit_solution(step, state, parameters)
    after = ClothState(state.x + dt_s * v, v)
    return after if contact is None else contact.corrected(after, model.free)


def damped_step(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    contact: SkinContact,
    *,
    kept: float,
    longest_m: float,
    pairs: SpringForces | None = None,
) -> tuple[ClothState, float]:
    """Returns the state ``DAMPED_DT_S`` [s] later, and the longest move [m] of a node before moves are shortened.

    It lets cloth come to rest in its folds. All moves are shortened by one factor, so that none is longer than
    ``longest_m`` [m]. The new velocity is ``kept`` times move over ``DAMPED_DT_S``, with no outward part at the skin.
    """
    with torch.no_grad():
        after = linearised_step(model, state, parameters, dt_s=DAMPED_DT_S, contact=contact, pairs=pairs)
        move = after.x - state.x
        longest = float(move.norm(dim=1).max())
        move = min(1.0, longest_m / max(longest, 1e-12)) * move
        x, v = state.x + move, kept * move / DAMPED_DT_S
        # A node that lands stays: the repulsion of one step must not throw it off the skin in the next.
        distance, normal = contact.body(x)
        outward = torch.clamp((v * normal).sum(dim=1, keepdim=True), min=0.0)
        return ClothState(x, v - (distance < 1.2 * contact.gap_m)[:, None] * outward * normal), longest


def simulate_steps(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    dt_s: float,
    steps: int,
    contact: SkinContact | None = None,
) -> ClothState:
    """Returns the state after ``steps`` linearised steps of ``dt_s`` [s]."""
    for _ in range(steps):
        state = linearised_step(model, state, parameters, dt_s=dt_s, contact=contact)
    return state
