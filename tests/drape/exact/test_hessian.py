"""Hessians against differences of gradients, their positive part, and conjugate gradients against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.exact import descent, hessian, linear
from tests.drape.cloth.solver_setup import MATERIALS, crumpled


def dense(pattern, blocks):
    count = len(pattern.start) - 1
    matrix = np.zeros((count, 3, count, 3))
    for v in range(count):
        for z in range(pattern.start[v], pattern.start[v + 1]):
            matrix[v, :, pattern.column[z]] = blocks[z]
    return matrix.reshape(3 * count, 3 * count)


def assembled(scene, exact):
    pattern = hessian.pattern(scene.cloth)
    blocks = np.empty((len(pattern.column), 3, 3))
    hessian.assemble(scene.x, scene.problem, scene.around, pattern, exact, blocks)
    return pattern, blocks


@pytest.mark.parametrize("material", MATERIALS)
def test_the_exact_hessian_is_the_derivative_of_the_gradient(material):
    scene = crumpled(material)._replace(around=crumpled(material, springs=False).around)
    matrix = dense(*assembled(scene, 1.0))
    step, columns = 1e-7, []
    for i in range(matrix.shape[0]):
        shift = np.zeros(matrix.shape[0])
        shift[i] = step
        ends = []
        for sign in (1.0, -1.0):
            gradient = np.empty_like(scene.x)
            x = scene.x + sign * shift.reshape(-1, 3)
            descent.energy_and_gradient(x, scene.problem, scene.around, gradient)
            ends.append(gradient.reshape(-1))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    assert_allclose(matrix, np.stack(columns, axis=1), rtol=0.0, atol=1e-6 * np.abs(matrix).max())


@pytest.mark.parametrize("material", MATERIALS)
def test_the_positive_part_is_positive_where_the_whole_is_not(material):
    scene = crumpled(material, noise_m=0.003)
    whole, part = (np.linalg.eigvalsh(dense(*assembled(scene, exact))) for exact in (1.0, 0.0))
    assert whole.min() < -1e-3 * whole.max()
    assert part.min() > -1e-10 * part.max()


def charts_of(scene, patch_count=6):
    """Every vertex between two of a few patches."""
    place = np.linspace(0.0, patch_count - 1.001, len(scene.x))
    low, share = place.astype(np.int32), place - place.astype(np.int32)
    return linear.Charts(np.stack([low, low + 1], axis=1), np.stack([1.0 - share, share], axis=1))


@pytest.mark.parametrize("with_charts", [False, True])
def test_conjugate_gradients_solve_and_charts_save_iterations(rng, with_charts):
    scene = crumpled("rib")
    pattern, blocks = assembled(scene, 0.0)
    diagonal = np.empty((len(scene.x), 3, 3))
    descent.diagonal_blocks(scene.x, scene.problem, scene.around, diagonal)
    blocks[pattern.diagonal] += 0.01 * diagonal
    charts, coarse = linear.no_charts(len(scene.x), np.float64), np.zeros((0, 0))
    matrix = dense(pattern, blocks)
    if with_charts:
        charts = charts_of(scene)
        small = np.empty((18, 18))
        linear.galerkin(charts, pattern, blocks, small)
        basis = np.zeros((len(scene.x), 6))
        np.add.at(basis, (np.arange(len(scene.x))[:, None], charts.patch), charts.weight)
        basis = np.kron(basis, np.eye(3))
        assert_allclose(small, basis.T @ matrix @ basis, rtol=1e-10, atol=1e-10 * np.abs(small).max())
        coarse = np.linalg.inv(small)
    system = linear.System(pattern, blocks, np.linalg.inv(diagonal), charts, coarse)
    force, moved = rng.normal(size=scene.x.shape), np.empty_like(scene.x)
    count = linear.conjugate_gradients(system, force, 1e-10, 500, moved)
    assert 0 < count < 500
    assert_allclose(matrix @ moved.reshape(-1), force.reshape(-1), rtol=0.0, atol=1e-6)


def test_a_direction_that_curves_down_ends_the_iteration(rng):
    scene = crumpled("isotropic", noise_m=0.003)
    pattern, blocks = assembled(scene, 1.0)
    inverse = np.tile(np.eye(3), (len(scene.x), 1, 1))
    charts = linear.no_charts(len(scene.x), np.float64)
    force, moved = rng.normal(size=scene.x.shape), np.empty_like(scene.x)
    count = linear.conjugate_gradients(
        linear.System(pattern, -blocks, inverse, charts, np.zeros((0, 0))), force, 1e-3, 200, moved
    )
    assert count < 0
    assert np.isfinite(moved).all()
    assert (moved * force).sum() > 0.0
