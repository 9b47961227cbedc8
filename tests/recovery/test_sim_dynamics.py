"""Laws of motion: free fall, order, energy, momentum, and agreement of the two steps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.cloth.material import OrthotropicMaterial
from recovery.sim.cloth_model import elastic_energy
from recovery.sim.implicit import simulate_steps
from recovery.sim.newton_steps import newton_step
from tests.recovery.sim_setup import WOVEN, advance, crumpled, sewn_tube

# Slow enough (about 30 rad/s) that steps of milliseconds resolve every mode.
SOFT = OrthotropicMaterial(0.6, 0.1, 0.5, 0.3, 1e-5, 0.5)


@pytest.mark.parametrize("method", ["linearised", "newton"])
def test_free_fall_is_the_exact_sum_of_implicit_euler(method):
    """n steps fall by g dt^2 n (n + 1) / 2, from any shape, for the centre of mass."""
    model, panels, nodes = sewn_tube()
    state, parameters = model.state(nodes), model.parameters(panels, WOVEN)
    mass = (parameters.density_kg_m2 * model.rest(parameters.panels).node_area)[:, None]
    start = (mass * state.x).sum(dim=0) / mass.sum()
    steps, dt = 5, 0.02
    state = advance(method, model, state, parameters, dt_s=dt, steps=steps, tolerance_n=1e-12)
    found = (mass * state.x).sum(dim=0) / mass.sum() - start
    assert_allclose(found, [0.0, -9.81 * dt**2 * steps * (steps + 1) / 2, 0.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["linearised", "newton"])
def test_the_error_falls_in_proportion_to_the_time_step(method):
    """Slope 1.0 +- 0.1 of the change between halved steps."""
    model, panels, nodes = sewn_tube(3, 2, fixed=[0, 1])
    start = crumpled(model, 1.02 * nodes, size_m=0.001)
    parameters = model.parameters(panels, SOFT)
    ends = [advance(method, model, start, parameters, dt_s=0.015 / n, steps=n).x for n in (8, 16, 32, 64)]
    changes = [float((b - a).norm()) for a, b in pairwise(ends)]
    slopes = np.log2(np.array(changes[:-1]) / changes[1:])
    assert_allclose(slopes, 1.0, rtol=0, atol=0.1)


def test_a_converged_step_never_raises_the_energy():
    model, panels, nodes = sewn_tube(gravity_m_s2=0.0)
    state, parameters = crumpled(model, nodes), model.parameters(panels, WOVEN)
    rest = model.rest(parameters.panels)
    mass = (parameters.density_kg_m2 * rest.node_area)[:, None]

    def energy(at):
        return float(elastic_energy(model, rest, parameters, at.x) + 0.5 * (mass * at.v * at.v).sum())

    values = [energy(state)]
    for _ in range(15):
        state, report = newton_step(model, state, parameters, dt_s=0.02)
        assert report.converged
        values.append(energy(state))
    assert (np.diff(values) < 0.0).all()
    assert values[-1] < 0.5 * values[0]


def test_momentum_is_kept_without_outer_forces():
    model, panels, nodes = sewn_tube(gravity_m_s2=0.0)
    state, parameters = crumpled(model, nodes), model.parameters(panels, WOVEN)
    mass = (parameters.density_kg_m2 * model.rest(parameters.panels).node_area)[:, None]
    before = (mass * state.v).sum(dim=0)
    scale = float((mass * state.v.abs()).sum())
    linearised = simulate_steps(model, state, parameters, dt_s=0.02, steps=3)
    converged = newton_step(model, state, parameters, dt_s=0.02, tolerance_n=1e-12)[0]
    for after in (linearised, converged):
        assert_allclose((mass * after.v).sum(dim=0), before, rtol=0, atol=1e-10 * scale)


def test_fixed_nodes_stay():
    model, panels, nodes = sewn_tube(fixed=[0, 3, 7])
    start = crumpled(model, nodes)
    after = simulate_steps(model, start, model.parameters(panels, WOVEN), dt_s=0.05, steps=3)
    assert_allclose(after.x[[0, 3, 7]], start.x[[0, 3, 7]], rtol=0, atol=0)
    assert float((after.x - start.x).abs().max()) > 1e-3
