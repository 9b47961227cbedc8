"""Implicit Euler steps and static drapes solved to a residual by Newton's method with line search.

A step of dt minimises m / (2 dt^2) |x - x_before - dt v|^2 + elastic energy - work of the weights and given
forces + repulsion + friction potential, whose grip and normals are those of the step's beginning. A drape
minimises the same without inertia and friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.errors import InputError
from recovery.sim import elastic, implicit
from recovery.sim.contact import SkinContact
from recovery.sim.model import ClothModel, ClothState, Parameters, Rest
from recovery.sim.solver import Factor, LinearSolver, superlu

TOLERANCE_N = 1e-8  # largest component of the force left at a node; a node weighs about 1e-3 N
ITERATION_LIMIT = 200
SUFFICIENT = 1e-4  # Armijo's share of the predicted decrease
ROUNDING = 1e-12  # relative change of the potential below which the residual decides
SHORTEST_STEP = 2.0**-30


class Report(NamedTuple):
    """How a solve ended: ``residual_n`` [N] is the largest component of the force left at a free node."""

    iterations: int
    residual_n: float
    converged: bool


class _Fixed(NamedTuple):
    """What stays during the iterations."""

    rest: Rest
    mass: Tensor
    load: Tensor
    grip: tuple[Tensor, Tensor] | None


class Minimum:
    """Stationary point of the incremental potential; ``dt_s`` None for the drape at rest."""

    def __init__(
        self,
        model: ClothModel,
        contact: SkinContact | None,
        solver: LinearSolver,
        *,
        dt_s: float | None,
        tolerance_n: float,
        iteration_limit: int,
    ) -> None:
        self.model, self.contact, self.solver, self.dt_s = model, contact, solver, dt_s
        self.tolerance_n, self.iteration_limit = tolerance_n, iteration_limit
        self.report = Report(0, float("inf"), False)

    @property
    def free(self) -> Tensor:
        return self.model.free

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        with torch.no_grad():
            fixed = self._fixed(state, parameters)
            x = state.x if self.dt_s is None else state.x + self.free * self.dt_s * state.v
            value, residual = self._potential(x, state, parameters, fixed), self._residual(x, state, parameters, fixed)
            exact, shift, size = False, 0.0, float(residual.abs().max())
            iterations = 0
            while size > self.tolerance_n and iterations < self.iteration_limit:
                iterations += 1
                direction = self._direction(x, residual, state, parameters, fixed, exact=exact, shift=shift)
                slope = float((direction * residual).sum())
                length = 1.0 if slope < 0.0 else 0.0
                while length > SHORTEST_STEP:
                    trial = x + length * direction
                    trial_value = self._potential(trial, state, parameters, fixed)
                    if float(trial_value - value) <= SUFFICIENT * length * slope:
                        break
                    if float(trial_value - value) <= ROUNDING * abs(float(value)):
                        trial_size = float(self._residual(trial, state, parameters, fixed).abs().max())
                        if trial_size < size:
                            break
                    length *= 0.5
                if length <= SHORTEST_STEP:
                    if not exact and shift > 1e6:
                        break  # nothing decreases: rounding has the last word
                    # A definite Hessian only fails by rounding or where it is nearly singular.
                    exact, shift = False, (shift if exact else max(10.0 * shift, 1e-3))
                    continue
                x, value = trial, trial_value
                residual = self._residual(x, state, parameters, fixed)
                size = float(residual.abs().max())
                exact = length == 1.0
                shift = 0.0 if length == 1.0 and shift < 1e-3 else 0.1 * shift
            self.report = Report(iterations, size, size <= self.tolerance_n)
            return x

    def factor(self, solution: Tensor, state: ClothState, parameters: Parameters) -> Factor:
        if not self.report.converged:
            raise InputError(
                "gradient of a drape",
                expected=f"a converged solve (force left <= {self.tolerance_n} N)",
                got=f"{self.report.residual_n:.3g} N after {self.report.iterations} iterations",
                cure="Allow more iterations, take a smaller time step, or loosen tolerance_n.",
            )
        fixed = self._fixed(state, parameters)
        return self._factored(solution, state, parameters, fixed, exact=True, shift=0.0)

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        fixed = self._fixed(state, parameters)
        x = _held(self.model, solution, state)
        nodes = self._node_residual(x, state, fixed)
        return -(weights * nodes).sum() - elastic.work(self.model, fixed.rest, parameters, x, weights)

    def _fixed(self, state: ClothState, parameters: Parameters) -> _Fixed:
        rest = self.model.rest(parameters.panels)
        mass = parameters.density_kg_m2 * rest.node_area
        load = parameters.force_n + mass[:, None] * self.model.gravity
        held = self.contact is not None and self.dt_s is not None
        grip = self.contact.grip(state.x, rest.node_area) if held and self.contact is not None else None
        return _Fixed(rest, mass, load, grip)

    def _potential(self, x: Tensor, state: ClothState, parameters: Parameters, fixed: _Fixed) -> Tensor:
        value = elastic.energy(self.model, fixed.rest, parameters, x) - (fixed.load * x).sum()
        if self.dt_s is not None:
            off = x - state.x - self.dt_s * state.v
            value = value + (fixed.mass[:, None] * off * off).sum() / (2.0 * self.dt_s**2)
        if self.contact is not None:
            value = value + self.contact.energy(x, fixed.rest.node_area)
            if fixed.grip is not None and self.dt_s is not None:
                value = value + self.contact.friction_potential(x - state.x, *fixed.grip, dt_s=self.dt_s)
        return value

    def _node_residual(self, x: Tensor, state: ClothState, fixed: _Fixed) -> Tensor:
        """Derivative (V, 3) of the potential without its elastic part."""
        residual = -fixed.load
        if self.dt_s is not None:
            residual = residual + fixed.mass[:, None] * (x - state.x - self.dt_s * state.v) / self.dt_s**2
        return residual + self._contact_residual(x, state, fixed)

    def _contact_residual(self, x: Tensor, state: ClothState, fixed: _Fixed) -> Tensor:
        if self.contact is None:
            return torch.zeros_like(x)
        residual = -self.contact.force(x, fixed.rest.node_area)
        if fixed.grip is not None and self.dt_s is not None:
            residual = residual + self.contact.friction_resistance(x - state.x, *fixed.grip, dt_s=self.dt_s)
        return residual

    def _residual(self, x: Tensor, state: ClothState, parameters: Parameters, fixed: _Fixed) -> Tensor:
        return self.free * (
            self._node_residual(x, state, fixed) - elastic.forces(self.model, fixed.rest, parameters, x)
        )

    def _blocks(self, x: Tensor, state: ClothState, fixed: _Fixed, *, exact: bool, shift: float) -> Tensor:
        identity = torch.eye(3, dtype=x.dtype)
        inertia = 0.0 if self.dt_s is None else 1.0 / self.dt_s**2
        blocks = ((inertia + shift) * fixed.mass)[:, None, None] * identity
        if self.contact is None:
            return blocks
        if exact:
            with torch.enable_grad():
                y = x.detach().requires_grad_(True)
                residual = self._contact_residual(y, state, fixed)
                rows = [torch.autograd.grad(residual[:, c].sum(), y, retain_graph=True)[0] for c in range(3)]
            return blocks + torch.stack(rows, dim=1)
        scale, r = self.contact.stiffness(x, fixed.rest.node_area)
        blocks = blocks + scale[:, None, None] * r[:, :, None] * r[:, None, :]
        if fixed.grip is not None and self.dt_s is not None:
            held = self.contact.friction_stiffness(x - state.x, *fixed.grip, dt_s=self.dt_s)
            n = fixed.grip[1]
            blocks = blocks + held[:, None, None] * (identity - n[:, :, None] * n[:, None, :])
        return blocks

    def _factored(
        self, x: Tensor, state: ClothState, parameters: Parameters, fixed: _Fixed, *, exact: bool, shift: float
    ) -> Factor:
        blocks = self._blocks(x, state, fixed, exact=exact, shift=shift).detach().numpy()
        return self.solver(elastic.hessian(self.model, fixed.rest, parameters, x, definite=not exact, blocks=blocks))

    def _direction(
        self,
        x: Tensor,
        residual: Tensor,
        state: ClothState,
        parameters: Parameters,
        fixed: _Fixed,
        *,
        exact: bool,
        shift: float,
    ) -> Tensor:
        factor = self._factored(x, state, parameters, fixed, exact=exact, shift=shift)
        if exact and factor.negative_pivots():  # near a saddle: its Newton step would seek it
            factor = self._factored(x, state, parameters, fixed, exact=False, shift=shift)
        return -torch.from_numpy(factor.solve(np.ascontiguousarray(residual.numpy()).reshape(-1))).reshape(-1, 3)


def _held(model: ClothModel, x: Tensor, state: ClothState) -> Tensor:
    """``x`` with the fixed nodes at the state's positions, so that gradients reach those too."""
    return model.free * x + (1.0 - model.free) * state.x


def newton_step(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    dt_s: float,
    contact: SkinContact | None = None,
    tolerance_n: float = TOLERANCE_N,
    iteration_limit: int = ITERATION_LIMIT,
    solver: LinearSolver = superlu,
) -> tuple[ClothState, Report]:
    """The state ``dt_s`` [s] later by implicit Euler solved to ``tolerance_n``, and how the solve ended.

    Differentiable once: the backward pass factors the exact Hessian at the solution. It refuses after a solve
    that did not converge, because its gradient would be that of something else.
    """
    step = Minimum(model, contact, solver, dt_s=dt_s, tolerance_n=tolerance_n, iteration_limit=iteration_limit)
    x = _held(model, implicit.solution(step, state, parameters), state)
    return ClothState(x, (x - state.x) / dt_s), step.report


def equilibrium(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    contact: SkinContact | None = None,
    tolerance_n: float = TOLERANCE_N,
    iteration_limit: int = ITERATION_LIMIT,
    solver: LinearSolver = superlu,
) -> tuple[ClothState, Report]:
    """A drape at rest near ``state``, without friction, and how the solve ended; differentiable as ``newton_step``."""
    drape = Minimum(model, contact, solver, dt_s=None, tolerance_n=tolerance_n, iteration_limit=iteration_limit)
    x = _held(model, implicit.solution(drape, state, parameters), state)
    return ClothState(x, torch.zeros_like(x)), drape.report
