"""The equations of a swing mesh against NumPy, finite differences and a dense solution."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES, empty_points
from drape.engine.packer import Record
from drape.live.swing_mesh import SwingMesh
from tests.drape.live.swing_setup import hanging
from tests.reference.swing import length_energy, pull_matrix

YOUNG = 250.0


@pytest.fixture(scope="module")
def moved() -> tuple[np.ndarray, np.ndarray, SwingMesh]:
    """Still nodes, the same pulled, folded and twisted, and their mesh."""
    rest, mesh = hanging()
    random = np.random.default_rng(3)
    still = rest[mesh.vertex] + 0.004 * random.normal(size=(len(mesh.vertex), 3))
    return still, still * [0.9, 1.03, 1.0] + 0.006 * random.normal(size=still.shape), mesh


def placed(c: np.ndarray, mesh: SwingMesh) -> np.ndarray:
    """The nodes ``c`` [m] (N, 3) at their places (P, 3)."""
    found = empty_points(len(mesh.rows.node), np.float64)
    found[:] = c[mesh.rows.node]
    return found


def test_length_s_gradient_is_that_of_its_energy(moved: tuple[np.ndarray, np.ndarray, SwingMesh]):
    still, c, mesh = moved
    seen, found = 0, np.empty((mesh.rows.moving, 9, LANES))
    given = placed(c, mesh), placed(still, mesh), Record("SwingRows", mesh.rows), YOUNG, found
    call_with_scratch("law_length", np.float64, *given)
    for i in mesh.order:
        gradient, hessian = np.split(found[mesh.rows.place[i] // LANES, :, mesh.rows.place[i] % LANES], [3])
        for axis in range(3):
            ahead, behind = c.copy(), c.copy()
            ahead[i, axis] += 1e-6
            behind[i, axis] -= 1e-6
            slope = (length_energy(ahead, still, mesh, YOUNG) - length_energy(behind, still, mesh, YOUNG)) / 2e-6
            assert_allclose(gradient[axis], slope, rtol=1e-4, atol=1e-6)
            seen += abs(slope) > 1e-3
        h = hessian
        full = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
        assert np.linalg.eigvalsh(full).min() > -1e-9 * abs(full).max()
    assert seen > len(mesh.order), "most of it is pulled"


def test_cloth_is_free_between_still_and_flat(moved: tuple[np.ndarray, np.ndarray, SwingMesh]):
    rest, mesh = hanging()
    flat = rest[mesh.vertex] * 0.98  # a triangle's sides at rest are shorter than ways over edges
    folded = flat * [0.7, 1.0, 1.0]
    assert length_energy(folded, folded, mesh, YOUNG) < 1e-20
    assert length_energy(0.5 * (folded + flat), folded, mesh, YOUNG) < 1e-20
    assert length_energy(0.9 * folded, folded, mesh, YOUNG) > 1e-5, "it keeps its area"
    still = moved[0]
    assert length_energy(still, still, mesh, YOUNG) < 1e-20


def test_sweeps_lower_what_they_minimise(moved: tuple[np.ndarray, np.ndarray, SwingMesh]):
    still, c, mesh = moved
    inertia, record = 900.0 * mesh.mass_kg, Record("SwingMesh", mesh)
    x, found = c.copy(), []
    for _ in range(12):
        spring = 0.5 * float((inertia[:, None] * (x - c) ** 2)[mesh.order].sum())
        found.append(length_energy(x, still, mesh, YOUNG) + spring)
        call_with_scratch("law_keep_length", np.float64, x, c, inertia, still, record, YOUNG, 1)
    assert (np.diff(found) < 0.0).all() and found[-1] < 0.2 * found[0]


def test_falling_back_solves_its_equation():
    _, mesh = hanging()
    count, random, record = len(mesh.vertex), np.random.default_rng(5), Record("SwingMesh", mesh)
    inertia, hold = 900.0 * mesh.mass_kg, random.uniform(0.0, 2.0, count)
    rhs = random.normal(size=(count, 3))
    u = np.zeros((count, 3))
    call_with_scratch("law_fall_back", np.float64, u, record, inertia, hold, rhs, 60)
    free = mesh.order
    matrix = pull_matrix(mesh)[np.ix_(free, free)] + np.diag((inertia + hold)[free])
    assert_allclose(u[free], np.linalg.solve(matrix, rhs[free]), rtol=1e-6, atol=1e-9)
    small = 1e-9 * u
    call_with_scratch("law_fall_back", np.float64, small, record, inertia, hold, 1e-9 * rhs, 500)
    assert_allclose(small[free], 1e-9 * u[free], rtol=1e-4, atol=1e-18)  # and no rounds beyond what floats can tell
    held = np.setdiff1d(np.arange(count), free)
    assert len(held) and (u[held] == 0.0).all()
