"""L-BFGS for an energy whose contact planes are looked up again as it goes.

Between two look-ups the energy is one fixed function; a pair (step, change of gradient) is only
ever taken within such a stretch, so that the jumps of the planes never enter the curvature that
the method learns, and the history outlives them. The result is the best point at which the
planes were those of the point itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

HISTORY = 20  # pairs
REFRESH_STEPS = 5
CHECK_STEPS = 100
STEP_LIMIT = 600
TOLERANCE = 1e-4
FIRST_STEP = 0.25  # up to four charts share a vertex, and the scaling of the variables knows only one
SUFFICIENT, HALVINGS_MAX = 1e-4, 20
NOISE = 2e-7  # of float32 sums, relative to the energies that enter
CURVED = 1e-8  # cosine between a step and the change of the gradient below which the pair is left out


class Objective(Protocol):
    """An energy [J] of n variables that are scaled so that its Hessian is near the identity."""

    def refresh(self, z: Tensor) -> None:
        """Looks up at ``z`` what is then held fixed."""
        ...

    def value_and_gradient(self, z: Tensor) -> tuple[float, Tensor]:
        """Energy [J] and gradient (n,)."""
        ...


@dataclass(frozen=True, eq=False)
class Minimum:
    """The point that was reached: ``z`` (n,) and its ``energy_j``.

    ``residual_j`` half the squared gradient: what one Newton step with the scaling for a Hessian would still gain.
    ``change`` the gain of the last 100 steps as a share of all that was gained, 0 where rounding left no descent.
    ``steps``, ``evaluations``.
    """

    z: Tensor
    energy_j: float
    residual_j: float
    change: float
    steps: int
    evaluations: int


class _Pairs:
    """The last steps and changes of the gradient, and the product of the inverse Hessian they make (Nocedal 1980)."""

    def __init__(self, count: int) -> None:
        self._pairs: deque[tuple[Tensor, Tensor, float]] = deque(maxlen=count)

    def add(self, step: Tensor, change: Tensor) -> None:
        curvature = float(step @ change)
        if curvature > CURVED * float(step.norm() * change.norm()):
            self._pairs.append((step, change, 1.0 / curvature))

    def clear(self) -> None:
        self._pairs.clear()

    def descent(self, gradient: Tensor) -> Tensor:
        """The direction to go (n,)."""
        if not self._pairs:
            return -FIRST_STEP * gradient
        q, shares = gradient.clone(), []
        for step, change, inverse in reversed(self._pairs):
            shares.append(inverse * float(step @ q))
            q -= shares[-1] * change
        _, change, inverse = self._pairs[-1]
        q /= inverse * float(change @ change)
        for (step, change, inverse), share in zip(self._pairs, reversed(shares), strict=True):
            q += (share - inverse * float(change @ q)) * step
        return -q


def minimise(
    objective: Objective, start: Tensor, *, step_limit: int = STEP_LIMIT, tolerance: float = TOLERANCE
) -> Minimum:
    """The least energy near ``start`` (n,).

    Ends when 100 steps gain less than ``tolerance`` of what was gained in all, at ``step_limit``, or where
    rounding leaves no descent.
    """
    pairs = _Pairs(HISTORY)
    z = best = start
    first = lowest = residual = checked = float("inf")
    change, evaluations, stuck = float("inf"), 0, 0
    energy, gradient = 0.0, torch.zeros_like(start)
    step = 0
    while True:
        if step % REFRESH_STEPS == 0 or step == step_limit or stuck:
            objective.refresh(z)
            energy, gradient = objective.value_and_gradient(z)
            evaluations += 1
            if step == 0:
                first = checked = energy
            if energy < lowest:
                best, lowest, residual = z, energy, 0.5 * float(gradient @ gradient)
        if stuck > 1:
            change = 0.0
            break
        if step and (step % CHECK_STEPS == 0 or step == step_limit):
            change = (checked - lowest) / max(first - lowest, 1e-30)
            checked = lowest
            if change < tolerance or step == step_limit:
                break
        moved = _search(objective, z, energy, gradient, pairs.descent(gradient))
        evaluations += moved.evaluations
        if moved.found:
            pairs.add(moved.z - z, moved.gradient - gradient)
            z, energy, gradient, stuck = moved.z, moved.energy, moved.gradient, 0
        else:
            pairs.clear()
            stuck += 1
        step += 1
    return Minimum(best, lowest, residual, change, step, evaluations)


@dataclass(frozen=True, eq=False)
class _Moved:
    found: bool
    z: Tensor
    energy: float
    gradient: Tensor
    evaluations: int


def _search(objective: Objective, z: Tensor, energy: float, gradient: Tensor, direction: Tensor) -> _Moved:
    """The first point along ``direction`` that lowers the energy enough (Armijo), found by halving or a parabola."""
    slope = float(gradient @ direction)
    length = 1.0
    if slope < 0.0:
        allowed = NOISE * max(1.0, abs(energy))
        for count in range(1, HALVINGS_MAX + 1):
            trial = z + length * direction
            reached, there = objective.value_and_gradient(trial)
            if reached <= energy + SUFFICIENT * length * slope + allowed:
                return _Moved(True, trial, reached, there, count)
            bend = reached - energy - length * slope
            shorter = -slope * length / (2.0 * bend) if bend > 0.0 else 0.5
            length *= min(0.5, max(0.1, shorter))
    return _Moved(False, z, energy, gradient, HALVINGS_MAX if slope < 0.0 else 0)
