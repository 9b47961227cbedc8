"""The kernels of a swing mesh against NumPy, finite differences and a dense solution."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_allclose

from drape.kernels.compiled import FAST
from drape.kernels.lanes import LANES, put3
from drape.live.swing_mesh import SwingMesh
from drape.live.swing_nodes import Ground, Springs, fall_back, keep_length, pull, write_bounds
from drape.live.swing_rows import SwingRows, placed
from tests.drape.live.swing_setup import hanging
from tests.reference.swing import length_energy, pull_matrix

YOUNG = 250.0


@pytest.fixture(scope="module")
def moved() -> tuple[np.ndarray, np.ndarray, SwingMesh, np.ndarray]:
    """Still nodes, the same pulled, folded and twisted, their mesh and bound."""
    rest, mesh = hanging()
    random = np.random.default_rng(3)
    still = rest[mesh.vertex] + 0.004 * random.normal(size=(len(mesh.vertex), 3))
    c = still * [0.9, 1.03, 1.0] + 0.006 * random.normal(size=still.shape)
    bound = np.empty(6 * LANES * mesh.rows.start[mesh.rows.moving])
    write_bounds(still, mesh, bound)
    return still, c, mesh, bound


@njit(error_model="numpy", fastmath=FAST)
def write_pulls(x: np.ndarray, rows: SwingRows, young: float, bound: np.ndarray, found: np.ndarray) -> None:
    """Writes gradient and Hessian of the nodes that move to ``found``, nine rows a block."""
    for block in range(rows.moving):
        g, h = pull(x, block, rows, young, bound)
        put3(found, 9 * LANES * block, g)
        put3(found, 9 * LANES * block + 3 * LANES, h[:3])
        put3(found, 9 * LANES * block + 6 * LANES, h[3:])


def test_length_s_gradient_is_that_of_its_energy(moved: tuple[np.ndarray, np.ndarray, SwingMesh, np.ndarray]):
    still, c, mesh, bound = moved
    seen, found = 0, np.empty((mesh.rows.moving, 9, LANES))
    write_pulls(placed(c, mesh.rows), mesh.rows, YOUNG, bound, found.reshape(-1))
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


def test_cloth_is_free_between_still_and_flat(moved: tuple[np.ndarray, np.ndarray, SwingMesh, np.ndarray]):
    rest, mesh = hanging()
    flat = rest[mesh.vertex] * 0.98  # a triangle's sides at rest are shorter than ways over edges
    folded = flat * [0.7, 1.0, 1.0]
    assert length_energy(folded, folded, mesh, YOUNG) < 1e-20
    assert length_energy(0.5 * (folded + flat), folded, mesh, YOUNG) < 1e-20
    assert length_energy(0.9 * folded, folded, mesh, YOUNG) > 1e-5, "it keeps its area"
    still = moved[0]
    assert length_energy(still, still, mesh, YOUNG) < 1e-20


def test_sweeps_lower_what_they_minimise(moved: tuple[np.ndarray, np.ndarray, SwingMesh, np.ndarray]):
    still, c, mesh, bound = moved
    count, inertia = len(c), 900.0 * mesh.mass_kg
    far = np.array([[0.0, 5.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    x, ground = (
        c.copy(),
        Ground(far, np.full(count, -1, np.int32), np.zeros(count, np.int32), np.zeros(count), np.zeros((count, 2, 4))),
    )
    found = []
    for _ in range(12):
        spring = 0.5 * float((inertia[:, None] * (x - c) ** 2)[mesh.order].sum())
        found.append(length_energy(x, still, mesh, YOUNG) + spring)
        keep_length(x, mesh, YOUNG, bound, Springs(c, inertia), ground, 1)
    assert (np.diff(found) < 0.0).all() and found[-1] < 0.2 * found[0]


def test_falling_back_solves_its_equation():
    _, mesh = hanging()
    count, random = len(mesh.vertex), np.random.default_rng(5)
    inertia, hold = 900.0 * mesh.mass_kg, random.uniform(0.0, 2.0, count)
    rhs = random.normal(size=(count, 3))
    u = np.zeros((count, 3))
    fall_back(u, mesh, inertia, hold, rhs, 60)
    free = mesh.order
    matrix = pull_matrix(mesh)[np.ix_(free, free)] + np.diag((inertia + hold)[free])
    assert_allclose(u[free], np.linalg.solve(matrix, rhs[free]), rtol=1e-6, atol=1e-9)
    small = 1e-9 * u
    fall_back(small, mesh, inertia, hold, 1e-9 * rhs, 500)
    assert_allclose(small[free], 1e-9 * u[free], rtol=1e-4, atol=1e-18)  # and no rounds beyond what floats can tell
    held = np.setdiff1d(np.arange(count), free)
    assert len(held) and (u[held] == 0.0).all()
