"""Gradients through steps and drapes against differences, forward mode and Taylor's remainder."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from recovery.sim import elastic
from recovery.sim.linearised import linearised_step, simulate
from recovery.sim.model import ClothState, Parameters
from recovery.sim.newton import equilibrium, newton_step
from recovery.sim.sdf import Sphere
from recovery.sim.skin_contact import SkinContact
from tests.fixtures.laws import each
from tests.recovery.sim_setup import WOVEN, crumpled, directional_error, leaves_of, sewn_tube, with_leaf

MODEL, PANELS, NODES = sewn_tube(fixed=[0, 1])
START, CLOTH = crumpled(MODEL, NODES), MODEL.parameters(PANELS, WOVEN)
WEIGHTS = torch.from_numpy(np.random.default_rng(7).normal(size=NODES.shape))
LEAVES = ["x", "v", "panels", "stretch", "bending_j", "density_kg_m2", "force_n"]
# Inside the tube: three nodes touch it at the start, and one ends a step inside and is put outside.
BALL = SkinContact(Sphere((0.1, 0.075, 0.0), 0.0455))
# Relative differences small enough for the sharp curvature of membranes, large enough for rounding.
STEPS = {"x": 1e-6, "panels": 1e-6}
DT_S = 0.02


def loss(state: ClothState) -> Tensor:
    return (WEIGHTS * state.x).sum() + 0.05 * (WEIGHTS * state.v).sum() + (state.x**2).sum()


def best_error(function, name: str, *, enough: float, start: ClothState = START) -> float:
    """The smallest error of up to three step sizes, the bottom of the V of truncation and rounding."""
    free = MODEL.free if name == "v" else None
    best = float("inf")
    for factor in (1.0, 0.1, 10.0):
        step = factor * STEPS.get(name, 1e-4)
        best = min(best, directional_error(function, start, CLOTH, name, step=step, free=free))
        if best < enough:
            break
    return best


def converged_step(state: ClothState, parameters: Parameters) -> ClothState:
    state, report = newton_step(MODEL, state, parameters, dt_s=DT_S, contact=BALL, tolerance_n=1e-11)
    assert report.converged
    return state


def drape(state: ClothState, parameters: Parameters) -> ClothState:
    state, report = equilibrium(MODEL, state, parameters, contact=BALL, tolerance_n=1e-11)
    assert report.converged
    return state


# What is differentiated, and the error that is allowed.
WAYS = {
    "one step": (lambda s, p: linearised_step(MODEL, s, p, dt_s=DT_S), 1e-7),
    "twenty steps": (lambda s, p: simulate(MODEL, s, p, dt_s=DT_S, steps=20), 1e-5),
    "three steps in contact": (lambda s, p: simulate(MODEL, s, p, dt_s=DT_S, steps=3, contact=BALL), 1e-3),
    "a converged step in contact": (converged_step, 1e-5),
}


@each(name=LEAVES, way=WAYS)
def test_steps_have_the_gradient_of_differences(name, way):
    function, allowed = way
    assert best_error(lambda s, p: loss(function(s, p)), name, enough=min(allowed, 1e-5)) < allowed


def test_repulsion_friction_and_equation_4_are_all_active_in_these_steps():
    assert int((BALL.body(START.x)[0] < BALL.gap_m).sum()) >= 3
    free_step = linearised_step(MODEL, START, CLOTH, dt_s=DT_S)
    assert bool((BALL.body(free_step.x)[0] < 0.0).any())


@each(name=[name for name in LEAVES if name != "v"])
def test_drapes_at_rest_have_the_gradient_of_differences(name):
    """Of x only the fixed nodes matter: a drape forgets where it came from."""
    start = drape(START, CLOTH)
    assert best_error(lambda s, p: loss(drape(s, p)), name, enough=1e-5, start=start) < 1e-5


def gradient_of(name: str, function) -> Tensor:
    leaf = leaves_of(START, CLOTH)[name].clone().requires_grad_(True)
    return torch.autograd.grad(function(*with_leaf(START, CLOTH, name, leaf)), leaf)[0]


def remainders(name: str, function, *, largest: float) -> np.ndarray:
    """|L(p + h d) - L(p) - h g.d| for h = largest / 2^i."""
    slope, leaf = gradient_of(name, function), leaves_of(START, CLOTH)[name]
    generator = torch.Generator().manual_seed(2)
    direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
    start, along = float(function(START, CLOTH)), float((slope * direction).sum())
    sizes = largest * 0.5 ** np.arange(6)
    values = [float(function(*with_leaf(START, CLOTH, name, leaf + h * direction))) for h in sizes]
    return np.abs(np.array(values) - start - sizes * along)


@pytest.mark.parametrize(("name", "largest"), [("panels", 2e-5), ("x", 1e-6), ("stretch", 0.5)])
def test_taylors_remainder_falls_with_the_square(name, largest):
    """Slope 1.9 to 2.1 over five halvings, 20 steps."""
    found = remainders(name, lambda s, p: loss(simulate(MODEL, s, p, dt_s=DT_S, steps=20)), largest=largest)
    slopes = np.log2(found[:-1] / found[1:])
    assert_allclose(slopes, 2.0, rtol=0, atol=0.1)


def test_a_frozen_system_matrix_is_found(monkeypatch):
    """Mutation: without the derivative of the Hessian the gradient is wrong, and the check says so."""
    whole = elastic.bilinear

    def frozen(model, rest, parameters, x, left, right):
        still = Parameters(*(leaf.detach() for leaf in parameters))
        return whole(model, model.rest(still.panels), still, x.detach(), left, right)

    monkeypatch.setattr(elastic, "bilinear", frozen)
    for name in ("x", "panels", "stretch"):
        error = best_error(lambda s, p: loss(linearised_step(MODEL, s, p, dt_s=DT_S)), name, enough=1e-3)
        assert error > 1e-3


def test_a_leaf_that_wants_no_gradient_gets_none():
    parameters = CLOTH._replace(stretch=CLOTH.stretch.clone().requires_grad_(True))
    loss(linearised_step(MODEL, START, parameters, dt_s=DT_S)).backward()
    assert parameters.stretch.grad is not None and CLOTH.panels.grad is None
