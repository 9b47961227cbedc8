"""Gradients through steps and drapes against differences."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from recovery.sim.cloth_model import ClothState, Parameters
from recovery.sim.implicit import linearised_step, simulate_steps
from recovery.sim.newton_steps import equilibrium, newton_step
from recovery.sim.skin_contact import SkinContact, Sphere
from tests.fixtures.laws import each
from tests.recovery.sim_setup import WOVEN, crumpled, directional_error, sewn_tube

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
    "twenty steps": (lambda s, p: simulate_steps(MODEL, s, p, dt_s=DT_S, steps=20), 1e-5),
    "three steps in contact": (lambda s, p: simulate_steps(MODEL, s, p, dt_s=DT_S, steps=3, contact=BALL), 1e-3),
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


def test_a_leaf_that_wants_no_gradient_gets_none():
    parameters = CLOTH._replace(stretch=CLOTH.stretch.clone().requires_grad_(True))
    loss(linearised_step(MODEL, START, parameters, dt_s=DT_S)).backward()
    assert parameters.stretch.grad is not None and CLOTH.panels.grad is None
