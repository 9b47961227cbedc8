"""The minimiser on functions whose minimum is known, and on one whose contact plane jumps."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from benchmarks.papers.representation_minimise import REFRESH_STEPS, minimise


class Smooth:
    """A function of torch as an objective; counts what is asked of it."""

    def __init__(self, function: Callable[[Tensor], Tensor]) -> None:
        self.function, self.refreshed, self.evaluated = function, 0, 0

    def refresh(self, z: Tensor) -> None:
        self.refreshed += 1

    def value_and_gradient(self, z: Tensor) -> tuple[float, Tensor]:
        self.evaluated += 1
        moving = z.detach().requires_grad_()
        value = self.function(moving)
        (gradient,) = torch.autograd.grad(value, moving)
        return float(value.detach()), gradient


class Walled(Smooth):
    """A spring to 0 and a wall at 1 from one of two sides: which, is looked up by the sign of the first number."""

    def __init__(self) -> None:
        super().__init__(lambda z: 0.5 * (z * z).sum() + 50.0 * torch.clamp(1.0 - self.side * z[0], min=0.0) ** 2)
        self.side = 1.0

    def refresh(self, z: Tensor) -> None:
        super().refresh(z)
        self.side = 1.0 if float(z[0]) >= 0.0 else -1.0


def quadratic(count: int, condition: float) -> tuple[Smooth, Tensor]:
    """An objective with curvatures from 1 to ``condition`` in turned axes, least (zero) at the tensor returned."""
    generator = torch.Generator().manual_seed(0)
    axes = torch.linalg.qr(torch.randn(count, count, generator=generator))[0]
    curvature = torch.logspace(0.0, torch.log10(torch.tensor(condition)).item(), count)
    matrix, least = axes @ torch.diag(curvature) @ axes.T, torch.randn(count, generator=generator)
    return Smooth(lambda z: 0.5 * (z - least) @ (matrix @ (z - least))), least


def test_an_ill_conditioned_quadratic_is_solved():
    objective, least = quadratic(40, 1e3)
    found = minimise(objective, torch.zeros(40), step_limit=400)
    assert found.energy_j < 1e-6
    assert torch.allclose(found.z, least, atol=1e-3)
    assert found.residual_j < 1e-5
    assert found.evaluations == objective.evaluated


def test_a_curved_valley_is_followed():
    def rosenbrock(z: Tensor) -> Tensor:
        return (1.0 - z[0]) ** 2 + 100.0 * (z[1] - z[0] ** 2) ** 2

    found = minimise(Smooth(rosenbrock), torch.tensor([-1.2, 1.0]), step_limit=300)
    assert torch.allclose(found.z, torch.ones(2), atol=5e-3)


def test_a_wall_that_is_looked_up_again_is_met():
    objective = Walled()
    found = minimise(objective, torch.tensor([3.0, 2.0, -1.0]), step_limit=200)
    assert torch.allclose(found.z, torch.tensor([100.0 / 101.0, 0.0, 0.0]), atol=1e-3)
    assert objective.refreshed > 1


def test_more_steps_are_never_worse():
    start = torch.zeros(40)
    first, _ = quadratic(40, 1e4)[0].value_and_gradient(start)
    energies = [minimise(quadratic(40, 1e4)[0], start, step_limit=n).energy_j for n in (1, REFRESH_STEPS, 30)]
    assert first > energies[0] > energies[1] > energies[2]


def test_it_stops_when_a_hundred_steps_gain_too_little():
    found = minimise(quadratic(40, 1e3)[0], torch.zeros(40), step_limit=5000)
    assert found.steps in (200, 300)
    assert found.change < 1e-4
    limited = minimise(quadratic(40, 1e6)[0], torch.zeros(40), step_limit=20)
    assert (limited.steps, limited.change) == (20, pytest.approx(1.0))


def test_it_stops_where_rounding_leaves_no_descent():
    found = minimise(quadratic(10, 10.0)[0], torch.ones(10), step_limit=5000)
    assert found.steps < 100
    assert found.change == 0.0
    assert found.energy_j < 1e-10


def test_a_start_without_descent_is_returned():
    found = minimise(Smooth(lambda z: (z * z).sum()), torch.zeros(3))
    assert (found.energy_j, found.residual_j, found.change) == (0.0, 0.0, 0.0)
    assert found.steps == 2
