"""Implicit Euler steps and static drapes, solved to a residual by Newton's method with a line search.

A step of dt minimises the incremental potential

    m / (2 dt^2) |x - x_before - dt v|^2 + elastic energy - work of weight and given forces + repulsion + friction,

with the grip and the normals of friction at the step's beginning. A drape minimises it without inertia and friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.errors import InputError
from recovery import progress
from recovery.sim.cloth_model import (
    ClothModel,
    ClothState,
    Factor,
    Parameters,
    SingularMatrix,
    elastic_energy,
    elastic_forces,
    elastic_hessian,
    elastic_work,
    superlu,
)
from recovery.sim.implicit import implicit_solution
from recovery.sim.skin_contact import SkinContact

TOLERANCE_N = 1e-8  # largest component of the force left at a node; a node weighs about 1e-3 N
ITERATION_LIMIT = 200
SUFFICIENT = 1e-4  # Armijo's share of the predicted decrease
ROUNDING = 1e-12  # relative change of the potential below which the residual decides
SHORTEST_STEP = 2.0**-30


class Report(NamedTuple):
    """The end of a solve: its ``iterations``, the largest component ``residual_n`` [N] of the force left at a free
    node, and whether that is within the tolerance."""

    iterations: int
    residual_n: float
    converged: bool


class _Potential:
    """The incremental potential of one solve from ``state``; ``dt_s`` None leaves inertia and friction out."""

    def __init__(
        self,
        model: ClothModel,
        contact: SkinContact | None,
        dt_s: float | None,
        state: ClothState,
        parameters: Parameters,
    ) -> None:
        self.model, self.contact, self.dt_s, self.state, self.parameters = model, contact, dt_s, state, parameters
        self.rest = model.rest(parameters.panels)
        self._mass = parameters.density_kg_m2 * self.rest.node_area
        self._load = parameters.force_n + self._mass[:, None] * model.gravity
        self._grip = None if contact is None or dt_s is None else contact.grip(state.x, self.rest.node_area)

    def energy(self, x: Tensor) -> Tensor:
        """Potential [J] () at ``x``."""
        value = elastic_energy(self.model, self.rest, self.parameters, x) - (self._load * x).sum()
        if self.dt_s is not None:
            off = x - self.state.x - self.dt_s * self.state.v
            value = value + (self._mass[:, None] * off * off).sum() / (2.0 * self.dt_s**2)
        if self.contact is not None:
            value = value + self.contact.energy(x, self.rest.node_area)
            if self._grip is not None and self.dt_s is not None:
                value = value + self.contact.friction_potential(x - self.state.x, *self._grip, dt_s=self.dt_s)
        return value

    def node_residual(self, x: Tensor) -> Tensor:
        """Derivative [N] (V, 3) of the potential without its elastic part."""
        residual = -self._load
        if self.dt_s is not None:
            off = x - self.state.x - self.dt_s * self.state.v
            residual = residual + self._mass[:, None] * off / self.dt_s**2
        return residual if self.contact is None else residual + self._contact_residual(self.contact, x)

    def residual(self, x: Tensor) -> Tensor:
        """Derivative [N] (V, 3) of the potential, zero at fixed nodes."""
        return self.model.free * (self.node_residual(x) - elastic_forces(self.model, self.rest, self.parameters, x))

    def factored(self, x: Tensor, *, exact: bool, shift: float = 0.0) -> Factor:
        """The Hessian, factored: ``exact``, or a definite one; ``shift`` [1/s^2] times the mass is added."""
        blocks = self._blocks(x, exact=exact, shift=shift).detach().numpy()
        hessian = elastic_hessian(self.model, self.rest, self.parameters, x, definite=not exact, blocks=blocks)
        return superlu(hessian)

    def direction(self, x: Tensor, residual: Tensor, *, exact: bool, shift: float) -> Tensor:
        """A step [m] (V, 3) along which the potential falls."""
        factor = self.factored(x, exact=exact, shift=shift)
        if exact and factor.negative_pivots():  # near a saddle: its Newton step would seek it
            factor = self.factored(x, exact=False, shift=shift)
        return -torch.from_numpy(factor.solve(np.ascontiguousarray(residual.numpy()).reshape(-1))).reshape(-1, 3)

    def _contact_residual(self, contact: SkinContact, x: Tensor) -> Tensor:
        residual = -contact.force(x, self.rest.node_area)
        if self._grip is not None and self.dt_s is not None:
            residual = residual + contact.friction_resistance(x - self.state.x, *self._grip, dt_s=self.dt_s)
        return residual

    def _blocks(self, x: Tensor, *, exact: bool, shift: float) -> Tensor:
        """The Hessian's blocks (V, 3, 3) of single nodes: mass, repulsion, friction."""
        identity = torch.eye(3, dtype=x.dtype)
        inertia = 0.0 if self.dt_s is None else 1.0 / self.dt_s**2
        blocks = ((inertia + shift) * self._mass)[:, None, None] * identity
        if self.contact is None:
            return blocks
        with torch.enable_grad():
            y = x.detach().requires_grad_(True)
            residual = self._contact_residual(self.contact, y)
            rows = [torch.autograd.grad(residual[:, c].sum(), y, retain_graph=True)[0] for c in range(3)]
        stiffness = torch.stack(rows, dim=1)
        return blocks + (stiffness if exact else _definite(stiffness))


def _definite(blocks: Tensor) -> Tensor:
    """Symmetric ``blocks`` (V, 3, 3) without their negative parts.

    With the body's curvature: in an armpit a node lies on the ridge of the distance, whose gradient is zero there, and
    its curvature alone keeps steps from going through the arm.
    """
    value, vector = torch.linalg.eigh(0.5 * (blocks + blocks.mT))
    return (vector * value.clamp(min=0.0)[:, None, :]) @ vector.mT


class Minimum:
    """The problem (``ImplicitProblem``) of positions x [m] (V, 3) at which the incremental potential is stationary.

    With ``dt_s`` [s] they are those of an implicit Euler step; with None those of a drape at rest, without inertia and
    friction. ``report`` tells how the last solve ended.
    """

    def __init__(
        self,
        model: ClothModel,
        contact: SkinContact | None,
        *,
        dt_s: float | None,
        tolerance_n: float,
        iteration_limit: int,
    ) -> None:
        self.model, self.contact, self.dt_s = model, contact, dt_s
        self.tolerance_n, self.iteration_limit = tolerance_n, iteration_limit
        self.report = Report(0, float("inf"), False)

    @property
    def free(self) -> Tensor:
        return self.model.free

    def solve(self, state: ClothState, parameters: Parameters) -> Tensor:
        with torch.no_grad():
            potential = self._potential(state, parameters)
            x = state.x if self.dt_s is None else state.x + self.free * self.dt_s * state.v
            value, residual = potential.energy(x), potential.residual(x)
            exact, shift, size = False, 0.0, float(residual.abs().max())
            iterations = 0
            while size > self.tolerance_n and iterations < self.iteration_limit and not progress.over():
                progress.tick(f"Newton's step {iterations + 1}, {size:.1e} N left")
                iterations += 1
                try:
                    direction = potential.direction(x, residual, exact=exact, shift=shift)
                    length = _line_search(potential, x, direction, value, residual)
                except SingularMatrix:  # no step, as where none lowers the potential: the shift makes it regular
                    direction, length = residual, 0.0
                if length <= SHORTEST_STEP:
                    if not exact and shift > 1e6:
                        break  # nothing decreases: rounding has the last word
                    # A definite Hessian only fails by rounding or where it is nearly singular.
                    exact, shift = False, (shift if exact else max(10.0 * shift, 1e-3))
                    continue
                x = x + length * direction
                value, residual = potential.energy(x), potential.residual(x)
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
        return self._potential(state, parameters).factored(solution, exact=True)

    def adjoint(self, weights: Tensor, solution: Tensor, state: ClothState, parameters: Parameters) -> Tensor:
        potential = self._potential(state, parameters)
        x = _held(self.model, solution, state)
        nodes = (weights * potential.node_residual(x)).sum()
        return -nodes - elastic_work(self.model, potential.rest, parameters, x, weights)

    def _potential(self, state: ClothState, parameters: Parameters) -> _Potential:
        return _Potential(self.model, self.contact, self.dt_s, state, parameters)


def _line_search(potential: _Potential, x: Tensor, direction: Tensor, value: Tensor, residual: Tensor) -> float:
    """The share of ``direction`` that lowers the potential enough, at most ``SHORTEST_STEP`` if none does."""
    slope = float((direction * residual).sum())
    length = 1.0 if slope < 0.0 else 0.0
    while length > SHORTEST_STEP:
        trial = x + length * direction
        change = float(potential.energy(trial) - value)
        if change <= SUFFICIENT * length * slope:
            break
        near = change <= ROUNDING * abs(float(value))
        if near and float(potential.residual(trial).abs().max()) < float(residual.abs().max()):
            break
        length *= 0.5
    return length


def _held(model: ClothModel, x: Tensor, state: ClothState) -> Tensor:
    """``x`` with the fixed nodes at the state's positions, so that gradients reach those too."""
    return model.free * x + (1.0 - model.free) * state.x


def force_left(model: ClothModel, state: ClothState, parameters: Parameters, contact: SkinContact | None) -> float:
    """Returns the largest component [N] of the force left at a free node at ``state``, without inertia and friction."""
    with torch.no_grad():
        potential = _Potential(model, contact, None, state, parameters)
        return float(potential.residual(state.x).abs().max())


def newton_step(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    dt_s: float,
    contact: SkinContact | None = None,
    tolerance_n: float = TOLERANCE_N,
    iteration_limit: int = ITERATION_LIMIT,
) -> tuple[ClothState, Report]:
    """Returns the state ``dt_s`` [s] later by implicit Euler solved to ``tolerance_n`` [N], and how the solve ended.

    Differentiable once: the backward pass factors the exact Hessian at the solution. It raises ``InputError`` after a
    solve that did not converge, because its gradient would be that of something else.
    """
    step = Minimum(model, contact, dt_s=dt_s, tolerance_n=tolerance_n, iteration_limit=iteration_limit)
    x = _held(model, implicit_solution(step, state, parameters), state)
    return ClothState(x, (x - state.x) / dt_s), step.report


def equilibrium(
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    contact: SkinContact | None = None,
    tolerance_n: float = TOLERANCE_N,
    iteration_limit: int = ITERATION_LIMIT,
) -> tuple[ClothState, Report]:
    """Returns a drape at rest near ``state``, without friction and with velocities of zero, and how the solve ended.
    Differentiable once, as ``newton_step`` is."""
    drape = Minimum(model, contact, dt_s=None, tolerance_n=tolerance_n, iteration_limit=iteration_limit)
    x = _held(model, implicit_solution(drape, state, parameters), state)
    return ClothState(x, torch.zeros_like(x)), drape.report
