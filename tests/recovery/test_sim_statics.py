"""Closed forms at rest: uniform strain, uniaxial and bias stretch, hanging strip, bent plate, cantilever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.integrate import solve_bvp

from drape.cloth import bending
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from recovery.sim.cloth_model import ClothModel, elastic_energy, elastic_forces, elastic_hessian
from recovery.sim.newton_steps import equilibrium, newton_step
from recovery.sim.skin_contact import SkinContact
from tests.recovery.sim_setup import WOVEN, lifted, strip

# x and z of a flat panel in space, for in-plane deformation gradients.
PLANE = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])


def irregular_sheet(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A strip whose inner vertices are off the grid: vertices, faces, and which are inner."""
    panel, faces = strip(6, 4, length_m=0.3, width_m=0.2)
    inner = np.minimum(panel, [0.3, 0.2] - panel).min(axis=1) > 1e-9
    return panel + 0.012 * inner[:, None] * rng.uniform(-1, 1, size=panel.shape), faces, inner


def test_patch_of_uniform_strain_has_the_exact_energy_and_no_inner_force(rng):
    panel, faces, inner = irregular_sheet(rng)
    model, stretch = ClothModel(faces), WOVEN.stretch_n_per_m
    parameters = model.parameters(panel, WOVEN)
    rest = model.rest(parameters.panels)
    for _ in range(5):
        f = np.eye(2) + 0.2 * rng.normal(size=(2, 2))
        strain = 0.5 * (f.T @ f - np.eye(2))
        e = np.array([strain[0, 0], strain[1, 1], strain[0, 1]])
        h = np.array([[stretch[0], stretch[1], 0], [stretch[1], stretch[2], 0], [0, 0, 2.0 * stretch[3]]])
        x = torch.from_numpy(panel @ f.T @ PLANE.T)
        assert_allclose(elastic_energy(model, rest, parameters, x), 0.5 * 0.06 * e @ h @ e, rtol=1e-12)
        force = elastic_forces(model, rest, parameters, x).numpy()
        assert_allclose(force[inner], 0.0, rtol=0, atol=1e-12 * np.abs(force).max())


@pytest.mark.parametrize("bias", [False, True])
def test_a_pulled_strip_follows_the_closed_form(rng, bias):
    """Free sides: force per width = E lambda (lambda^2 - 1) / 2 with E = 1 / (H^-1)_11 in the turned axes."""
    panel, faces, inner = irregular_sheet(rng)
    model = ClothModel(faces)
    angle = np.pi / 4 if bias else 0.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    parameters = model.parameters(panel @ turn.T, WOVEN)
    h = WOVEN
    tensor = np.zeros((2, 2, 2, 2))
    tensor[0, 0, 0, 0], tensor[1, 1, 1, 1], tensor[0, 0, 1, 1], tensor[1, 1, 0, 0] = h.h00, h.h11, h.h01, h.h01
    for i, j, k, l in ((0, 1, 0, 1), (0, 1, 1, 0), (1, 0, 0, 1), (1, 0, 1, 0)):
        tensor[i, j, k, l] = 0.5 * h.h22
    turned = np.einsum("ia,jb,kc,ld,ijkl->abcd", turn, turn, turn, turn, tensor)
    matrix = np.array([[turned[i, j, k, l] for k, l in PAIRS] for i, j in PAIRS]) * [1, 1, 2]
    modulus = 1.0 / np.linalg.inv(matrix)[0, 0]
    if not bias:
        assert_allclose(modulus, h.h00 - h.h01**2 / h.h11, rtol=1e-12)
    stretch = 1.15
    pull = modulus * 0.5 * (stretch**2 - 1.0)
    e = np.linalg.inv(matrix) @ [pull, 0.0, 0.0]
    green = np.array([[e[0], e[2]], [e[2], e[1]]])
    f = np.linalg.cholesky(2.0 * green + np.eye(2)).T  # any F with this strain
    f = rotation_to_x(f @ [1.0, 0.0]) @ f
    x = torch.from_numpy(panel @ f.T @ PLANE.T)
    force = elastic_forces(model, model.rest(parameters.panels), parameters, x).numpy()
    end = panel[:, 0] > 0.3 - 1e-9
    side = (np.abs(panel[:, 1] - 0.1) > 0.1 - 1e-9) & (panel[:, 0] > 1e-9) & ~end
    assert_allclose(force[inner | side], 0.0, rtol=0, atol=1e-11 * np.abs(force).max())
    assert_allclose(-force[end].sum(axis=0), [0.2 * pull * stretch, 0.0, 0.0], rtol=1e-10, atol=1e-10)


PAIRS = ((0, 0), (1, 1), (0, 1))


def rotation_to_x(vector: np.ndarray) -> np.ndarray:
    """The turn that brings ``vector`` onto the x axis."""
    c, s = vector / np.linalg.norm(vector)
    return np.array([[c, s], [-s, c]])


def test_a_hanging_strip_grows_by_its_own_weight():
    """rho g L^2 / (2 H00), without lateral contraction (H01 = 0), to 1 %."""
    panel, faces = strip(10, 2, length_m=0.4, width_m=0.05)
    cloth = replace(WOVEN, h01=0.0, h00=200.0)
    model = ClothModel(faces, fixed=np.flatnonzero(panel[:, 0] == 0.0))
    nodes = np.stack([np.zeros(len(panel)), -panel[:, 0], panel[:, 1]], axis=1)
    drape, report = equilibrium(model, model.state(nodes), model.parameters(panel, cloth))
    assert report.converged
    tip = panel[:, 0] == panel[:, 0].max()
    expected = cloth.density_kg_m2 * 9.81 * 0.4**2 / (2.0 * cloth.h00)
    assert_allclose(-0.4 - drape.x.numpy()[tip, 1].mean(), expected, rtol=0.01)


def test_a_plate_on_a_cylinder_holds_half_k_per_squared_curvature_at_any_resolution():
    errors = []
    for columns in (10, 20, 40):
        panel, faces = strip(columns, 4, length_m=0.4, width_m=0.1)
        radius = 0.1
        model = ClothModel(faces)
        parameters = model.parameters(panel, replace(WOVEN, h01=0.0))
        angle = panel[:, 0] / radius
        x = np.stack([radius * np.sin(angle), radius * np.cos(angle), -panel[:, 1]], axis=1)
        corner = model.hinges(torch.from_numpy(x))
        rest = model.rest(parameters.panels)
        energy = bending.bending_energy(corner, WOVEN.bending_j * rest.hinge_weight, model.rest_angle).sum()
        # Hinges stand between columns: half a column at either end has none.
        expected = 0.5 * WOVEN.bending_j / radius**2 * 0.1 * 0.4 * (columns - 1) / columns
        errors.append(abs(float(energy) / expected - 1.0))
    assert errors[0] < 0.02
    assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.05)


def cantilever(bending_j: float, columns: int = 24, *, ruled: bool = True) -> tuple[np.ndarray, float]:
    """Tip (x, y) of a strip of 0.1 m clamped flat at x = 0, and the length that bends.

    The first hinge that bends lies on the clamp and stands for half a column behind it too. ``ruled`` makes
    the diagonals stiff, so that the strip bends as a cylinder: the plane problem of the closed forms.
    """
    cell = 0.1 / columns
    panel, faces = strip(columns + 1, 1, length_m=0.1 + cell, width_m=2 * cell)
    panel = panel - [cell, 0.0]
    cloth = OrthotropicMaterial(2000.0, 0.0, 2000.0, 1000.0, bending_j, 0.18)
    model = ClothModel(faces, fixed=np.flatnonzero(panel[:, 0] < 0.5 * cell))
    parameters = model.parameters(panel, cloth)
    ends = panel[model.hinge_nodes[:, :2], 0]
    diagonal = ruled & (np.abs(ends[:, 0] - ends[:, 1]) > 0.5 * cell)
    parameters = parameters._replace(bending_j=torch.from_numpy(np.where(diagonal, 100.0, 1.0) * bending_j))
    state = model.state(lifted(panel))
    for _ in range(4):  # falls most of the way first, the static solve then has a near start
        state, report = newton_step(model, state, parameters, dt_s=0.1, tolerance_n=1e-6)
        assert report.converged
    drape, report = equilibrium(model, state, parameters)
    assert report.converged
    tip = panel[:, 0] == panel[:, 0].max()
    return drape.x.numpy()[tip].mean(axis=0)[:2], 0.1 + 0.5 * cell


def test_a_stiff_cantilever_sags_as_a_beam():
    """rho g L^4 / (8 k); what is left of 1 % is the mesh."""
    tip, length = cantilever(0.05)
    assert_allclose(-tip[1], 0.18 * 9.81 * length**4 / (8.0 * 0.05), rtol=0.01)


def test_a_soft_cantilever_is_the_heavy_elastica():
    """k theta'' = -rho g (L - s) cos(theta), theta(0) = theta'(L) = 0: the tip within 2 % of the length."""
    tip, length = cantilever(3e-4)
    load = 0.18 * 9.81 / 3e-4

    def slope(s, y):
        return np.stack([y[1], load * (length - s) * np.cos(y[0])])

    s = np.linspace(0.0, length, 200)
    solved = solve_bvp(lambda s, y: -slope(s, y) * [[-1], [1]], lambda a, b: [a[0], b[1]], s, np.zeros((2, 200)))
    assert solved.success
    theta = solved.sol(s)[0]
    x = np.trapezoid(np.cos(theta), s) - (length - 0.1)
    y = np.trapezoid(np.sin(theta), s)
    assert abs(theta).max() > 0.7  # a large deflection indeed
    assert_allclose(tip, [x, -abs(y)], rtol=0, atol=0.02 * 0.1)


def test_the_drape_is_where_the_steps_come_to_rest():
    panel, faces = strip(4, 3, length_m=0.2, width_m=0.15)
    model = ClothModel(faces, fixed=np.flatnonzero(panel[:, 0] == 0.0))
    nodes = np.stack([panel[:, 0] * 0.6, -panel[:, 0] * 0.8, panel[:, 1]], axis=1)
    parameters = model.parameters(panel, WOVEN)
    drape, report = equilibrium(model, model.state(nodes), parameters)
    state = model.state(nodes)
    for _ in range(60):
        state, _ = newton_step(model, state, parameters, dt_s=0.2)
    assert report.residual_n < 1e-6
    assert_allclose(state.x, drape.x, rtol=0, atol=1e-6)


def test_a_drape_is_a_minimum_and_not_a_saddle():
    """A compressed flat strip is an equilibrium; the slightest dent must take it to the buckled one."""
    panel, faces = strip(12, 2, length_m=0.2, width_m=0.03)
    model = ClothModel(faces, fixed=np.flatnonzero(np.abs(panel[:, 0] - 0.1) > 0.09), gravity_m_s2=0.0)
    nodes = lifted(panel) * [0.9, 1.0, 1.0]
    nodes[:, 1] += 1e-6 * np.cos(np.pi * (panel[:, 0] - 0.1) / 0.2) ** 2 * ~model.fixed
    parameters = model.parameters(panel, WOVEN)
    drape, report = equilibrium(model, model.state(nodes), parameters)
    assert report.converged
    assert float(drape.x[:, 1].abs().max()) > 0.02
    rest = model.rest(parameters.panels)
    hessian = elastic_hessian(model, rest, parameters, drape.x, definite=False).toarray()
    assert np.linalg.eigvalsh(hessian)[0] > 0.0


def test_cloth_in_a_slit_comes_to_rest_on_the_ridge_of_the_distance():
    """As in an armpit: there the distance has no gradient, and its curvature alone keeps steps from the other wall."""

    def slit(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        z, roundness = points[:, 2], 0.005
        arm = torch.sqrt(z * z + roundness**2)
        return 0.003 + roundness - arm, torch.stack([0.0 * z, 0.0 * z, -z / arm], dim=1)

    panel, faces = strip(8, 2, length_m=0.4, width_m=0.1)
    model = ClothModel(faces, fixed=np.flatnonzero(panel[:, 0] == 0.0))
    nodes = np.stack([panel[:, 1], -panel[:, 0], 0.003 * np.sin(40.0 * panel[:, 0])], axis=1)
    contact = SkinContact(slit, friction=0.0)
    drape, report = equilibrium(
        model, model.state(nodes), model.parameters(panel, WOVEN), contact=contact, tolerance_n=1e-6, iteration_limit=10
    )
    assert report.converged  # with the walls' stiffness alone it is not after 200 steps
    assert_allclose(drape.x[:, 2], 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("uneven_m", [0.0, 1e-9, 1e-3])
def test_a_drape_that_nothing_holds_is_not_called_converged(rng, uneven_m):
    """Of the flat one the first matrix is singular; of the others rounding says whether it is."""
    panel, faces = strip(2, 1, length_m=0.2, width_m=0.1)
    model = ClothModel(faces)
    uneven = lifted(panel) + uneven_m * rng.normal(size=(len(panel), 3))
    parameters = model.parameters(panel, WOVEN)
    parameters.stretch.requires_grad_(True)
    drape, report = equilibrium(model, model.state(uneven), parameters, iteration_limit=30)
    assert not report.converged
    with pytest.raises(InputError, match="converged solve"):
        drape.x.sum().backward()
