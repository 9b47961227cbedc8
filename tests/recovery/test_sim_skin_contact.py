"""Bodies as signed distances, repulsion, friction on an incline, and equation 4."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth.energies import ClothMesh
from drape.cloth.energies import contact as contact_energy
from drape.cloth.material import Material
from drape.errors import InputError, MeshError
from recovery.sim.cloth_model import ClothModel, ClothState
from recovery.sim.implicit import linearised_step, simulate_steps
from recovery.sim.newton_steps import equilibrium, newton_step
from recovery.sim.skin_contact import GridDistance, Grown, PlaneDistance, SkinContact, Sphere
from tests.drape.geometry.geometry_shapes import icosphere
from tests.recovery.sim_setup import WOVEN, advance, lifted, strip

RADIUS_M = 0.1


def sphere_grid(spacing_m: float) -> GridDistance:
    """The exact distance of a sphere on a grid."""
    axis = np.arange(-0.16, 0.16 + spacing_m, spacing_m)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return GridDistance(np.linalg.norm(points, axis=-1) - RADIUS_M, np.full(3, -0.16), spacing_m)


def shell(rng: np.random.Generator, count: int = 500) -> torch.Tensor:
    """Points within 2 cm of the sphere."""
    arm = rng.normal(size=(count, 3))
    arm /= np.linalg.norm(arm, axis=1, keepdims=True)
    return torch.from_numpy(arm * rng.uniform(RADIUS_M - 0.02, RADIUS_M + 0.02, size=(count, 1)))


def test_the_grid_converges_to_the_sphere_with_its_order(rng):
    """Cubic splines: fourth order in value and third in gradient; at 1 cm already microns."""
    points = shell(rng)
    value, gradient = Sphere((0.0, 0.0, 0.0), RADIUS_M)(points)
    errors = []
    for spacing in (0.02, 0.01):
        found, slope = sphere_grid(spacing)(points)
        errors.append([float((found - value).abs().max()), float((slope - gradient).abs().max())])
    assert errors[1][0] < 2e-5 and errors[1][1] < 2e-3
    assert (np.log2(np.array(errors[0]) / errors[1]) > [3.5, 2.5]).all()


@cache
def meshed_sphere() -> GridDistance:
    return GridDistance.from_mesh(*icosphere(5, radius_m=RADIUS_M), spacing_m=0.01, margin_m=0.03)


def test_a_meshed_body_has_the_distance_of_its_shape(rng):
    """0.2 mm is the paper's network; the mesh itself is 0.1 mm inside the sphere."""
    points = shell(rng)
    value, gradient = Sphere((0.0, 0.0, 0.0), RADIUS_M)(points)
    found, slope = meshed_sphere()(points)
    assert_allclose(found, value, rtol=0, atol=2e-4)
    assert_allclose((slope * gradient).sum(dim=1) / slope.norm(dim=1), 1.0, rtol=0, atol=1e-3)
    assert_allclose(slope.norm(dim=1), 1.0, rtol=0, atol=2e-2)


def test_outside_the_grid_the_distance_goes_on():
    far = torch.tensor([[0.5, 0.0, 0.0], [0.0, -2.0, 0.1]], dtype=torch.float64)
    found, slope = meshed_sphere()(far)
    assert_allclose(found, far.norm(dim=1) - RADIUS_M, rtol=0.1)
    assert (slope * far).sum(dim=1).min() > 0.0


@pytest.mark.parametrize("shape", ["plane", "sphere", "grown", "grid", "outside"])
def test_the_gradient_is_that_of_the_distance(rng, shape):
    body = {
        "plane": PlaneDistance((0.0, 0.1, 0.0), (1.0, 2.0, 0.5)),
        "sphere": Sphere((0.01, 0.0, 0.02), RADIUS_M),
        "grown": Grown(Sphere((0.01, 0.0, 0.02), RADIUS_M), 0.003),
    }.get(shape) or meshed_sphere()
    points = shell(rng, 20) * (4.0 if shape == "outside" else 1.0)
    leaf = points.clone().requires_grad_(True)
    distance, gradient = body(leaf)
    (slope,) = torch.autograd.grad(distance.sum(), leaf)
    assert_allclose(gradient.detach(), slope, rtol=0, atol=1e-12)
    if shape != "outside":
        assert torch.autograd.gradcheck(lambda p: body(p)[1].sum(), leaf[:4].detach().requires_grad_(True))


def test_bodies_that_have_no_inside_are_refused():
    vertices, faces = icosphere(0)
    with pytest.raises(MeshError, match="closed surface"):
        GridDistance.from_mesh(vertices, faces[1:])
    with pytest.raises(InputError, match="coarser spacing"):
        GridDistance.from_mesh(100.0 * vertices, faces)  # millimetres or so
    with pytest.raises(InputError, match="spacing"):
        GridDistance.from_mesh(vertices, faces, spacing_m=0.0)
    with pytest.raises(InputError, match="at least 4"):
        GridDistance(np.zeros((3, 9, 9)), np.zeros(3), 0.01)
    with pytest.raises(InputError, match="contact friction"):
        SkinContact(PlaneDistance(), friction=-0.1)


def sheet(*, tilt_rad: float = 0.0, depth_m: float = 0.0) -> tuple[ClothModel, np.ndarray, ClothState, np.ndarray]:
    """A flat sheet ``depth_m`` below the gap of a plane tilted about z; its model, panel, state, and downhill."""
    panel, faces = strip(3, 2, length_m=0.1, width_m=0.06)
    model = ClothModel(faces)
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    nodes = lifted(panel, y_m=SkinContact(PlaneDistance()).gap_m - depth_m) @ turn.T
    return model, panel, model.state(nodes), turn @ [1.0, 0.0, 0.0]


def weight_depth(tilt_rad: float) -> float:
    """Depth at which the repulsion carries the cloth: rho g cos(a) / (2 c)."""
    return WOVEN.density_kg_m2 * 9.81 * np.cos(tilt_rad) / (2.0 * SkinContact(PlaneDistance()).stiffness_j_m4)


@pytest.mark.parametrize("method", ["linearised", "newton"])
@pytest.mark.parametrize(("degrees", "slides"), [(15.0, False), (20.0, True), (35.0, True)])
def test_cloth_on_an_incline_sticks_or_slides_as_coulomb_says(method, degrees, slides):
    """mu = 0.3 = tan 16.7 deg: still below, g (sin a - mu cos a) above.

    The linearised step takes the drag at the speed before it, so what slides must be sliding already.
    """
    tilt = np.radians(degrees)
    model, panel, state, downhill = sheet(tilt_rad=tilt, depth_m=weight_depth(tilt))
    contact = SkinContact(PlaneDistance(normal=(np.sin(tilt), np.cos(tilt), 0.0)), friction=0.3, slip_speed_m_s=1e-4)
    start, parameters = state.x, model.parameters(panel, WOVEN)
    before = 1.0 if slides and method == "linearised" else 0.0
    state = state._replace(v=state.v + before * torch.from_numpy(downhill))
    steps, dt = 40, 0.005
    state = advance(method, model, state, parameters, dt_s=dt, steps=steps, contact=contact)
    moved = ((state.x - start).mean(dim=0) * torch.from_numpy(downhill)).sum()
    if slides:
        speed = 9.81 * (np.sin(tilt) - 0.3 * np.cos(tilt)) * steps * dt
        found = (state.v.mean(dim=0) * torch.from_numpy(downhill)).sum()
        assert_allclose(found - before, speed, rtol=0.02)
    else:
        # Creep is the smoothing's: less than slip speed tan a / sqrt(mu^2 - tan^2 a).
        creep = 1e-4 * np.tan(tilt) / np.sqrt(0.3**2 - np.tan(tilt) ** 2)
        assert 0.0 <= float(moved) < 1.05 * creep * steps * dt


def test_friction_takes_energy_and_never_reverses_the_sliding():
    model, panel, state, _ = sheet(depth_m=weight_depth(0.0))
    contact, parameters = SkinContact(PlaneDistance(), friction=0.3), model.parameters(panel, WOVEN)
    state = state._replace(v=state.v + torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64))
    speeds = [0.3]
    for _ in range(30):
        state = linearised_step(model, state, parameters, dt_s=0.005, contact=contact)
        speeds.append(float(state.v[:, 0].mean()))
    assert (np.diff(speeds) < 1e-12).all() and speeds[-1] > -1e-9
    assert speeds[-1] < 0.01  # stops after v / (mu g) = 0.102 s of 0.15


def test_cloth_rests_where_the_repulsion_carries_it():
    model, panel, state, _ = sheet(depth_m=0.001)
    state = state._replace(x=state.x + torch.tensor([0.0, 0.0005, 0.0], dtype=torch.float64))
    parameters = model.parameters(panel, WOVEN)
    contact = SkinContact(PlaneDistance())
    for _ in range(30):
        state, report = newton_step(model, state, parameters, dt_s=0.02, contact=contact)
        assert report.converged
    assert_allclose(state.x[:, 1], contact.gap_m - weight_depth(0.0), rtol=0, atol=1e-8)


def test_the_contact_energy_is_the_one_of_the_network(rng):
    panel, faces = strip(3, 2, length_m=0.1, width_m=0.06)
    model, mesh = ClothModel(faces), ClothMesh.from_rest(lifted(panel), faces)
    x = torch.from_numpy(lifted(panel) + 0.005 * rng.uniform(size=(len(panel), 3)))
    area = model.rest(torch.from_numpy(panel)).node_area
    distance = PlaneDistance()(x)[0].numpy()
    expected = contact_energy(distance, mesh, Material(contact_j_m4=3e5, contact_gap_m=0.004))
    assert_allclose(SkinContact(PlaneDistance()).energy(x, area), expected, rtol=1e-12)


def test_the_repulsion_is_the_derivative_of_its_energy(rng):
    contact, area = SkinContact(meshed_sphere()), torch.full((200,), 1e-4, dtype=torch.float64)
    leaf = shell(rng, 200).requires_grad_(True)
    (slope,) = torch.autograd.grad(contact.energy(leaf, area), leaf)
    assert_allclose(contact.force(leaf.detach(), area), -slope, rtol=0, atol=1e-12 * float(slope.abs().max()))
    move = 1e-4 * torch.from_numpy(rng.normal(size=(200, 3)))
    limit, normal = contact.grip(leaf.detach(), area)
    move.requires_grad_(True)
    (slope,) = torch.autograd.grad(contact.friction_potential(move, limit, normal, dt_s=0.01), move)
    found = contact.friction_resistance(move.detach(), limit, normal, dt_s=0.01)
    assert_allclose(found, slope, rtol=0, atol=1e-12 * float(slope.abs().max()))


def test_equation_4_puts_nodes_at_the_thickness(rng):
    """Exactly on plane and sphere; nodes outside and fixed ones stay; no inward velocity is left."""
    points = shell(rng)
    v = torch.from_numpy(rng.normal(size=points.shape))
    free = torch.ones(len(points), 1, dtype=torch.float64)
    for body in (PlaneDistance(), Sphere((0.0, 0.0, 0.0), RADIUS_M)):
        contact = SkinContact(body, thickness_m=0.002)
        inside = body(points)[0] < 0.0
        after = contact.corrected(ClothState(points, v), free)
        assert_allclose(body(after.x)[0][inside], 0.002, rtol=0, atol=1e-12)
        assert torch.equal(after.x[~inside], points[~inside]) and torch.equal(after.v[~inside], v[~inside])
        assert float((after.v * body(points)[1]).sum(dim=1)[inside].min()) > -1e-12
        still = contact.corrected(ClothState(points, v), 0.0 * free)
        assert torch.equal(still.x, points)


def test_a_sheet_falls_on_a_ball_and_stays_outside():
    """Linearised steps at the paper's size, then the drape at rest; nodes and edge midpoints are counted."""
    panel, faces = strip(10, 10, length_m=0.2, width_m=0.2)
    model = ClothModel(faces)
    nodes = lifted(panel, y_m=RADIUS_M + 0.01) - [0.1, 0.0, -0.1]
    parameters = model.parameters(panel, WOVEN)
    contact = SkinContact(meshed_sphere())
    state = simulate_steps(model, model.state(nodes), parameters, dt_s=0.02, steps=20, contact=contact)
    assert float(contact.body(state.x)[0].min()) > -1e-4
    assert float(state.x[:, 1].min()) < 0.07  # it hangs down
    drape, report = equilibrium(model, state, parameters, contact=contact, tolerance_n=1e-6)
    assert report.converged, report
    assert float(contact.body(drape.x)[0].min()) > -1e-4
    middle = 0.5 * (drape.x[model.hinge_nodes[:, 0]] + drape.x[model.hinge_nodes[:, 1]])
    assert float(contact.body(middle)[0].min()) > -1e-4
