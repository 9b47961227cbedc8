"""Energies against closed forms, finite differences, and numpy against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth import energies
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material, material
from drape.errors import MeshError
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import equilateral, grid, random_rotation, tube

JERSEY = material()
MU, LAMBDA = 11.1, 20.9  # of it [N/m]
DT_S = 1.0 / 30.0
# The guard of the hinge angle costs 1e-8 of its cosine; a sheet of 100 hinges then rests at some 1e-10 J.
REST_J = 1e-9


def sheet(shape=grid, *size, **settings):
    """The rest positions and the constants of a small mesh."""
    rest, faces = shape(*size, **settings)
    return rest, ClothMesh.from_rest(rest, faces)


def crumpled(rng, *, batch=(), noise_m=0.002):
    """A bent and stretched grid, and its rest mesh."""
    rest, faces = grid(6, 5)
    rest[:, 2] = 0.004 * np.sin(150.0 * rest[:, 0])
    return rest + noise_m * rng.normal(size=(*batch, *rest.shape)), ClothMesh.from_rest(rest, faces)


def parts_of(positions, mesh, earlier):
    """Every part at once; the contact is with the plane z = 0."""
    parts = energies.total(positions, mesh, JERSEY, distance=positions[..., 2])
    return parts | {"inertia": energies.inertia(positions, earlier[0], earlier[1], mesh, JERSEY, dt_s=DT_S)}


PARTS = ("membrane", "bending", "gravity", "contact", "inertia")


@pytest.mark.parametrize("part", PARTS)
def test_gradient_equals_central_differences(rng, part):
    positions, mesh = crumpled(rng)
    earlier = positions + 0.01 * rng.normal(size=(2, *positions.shape))
    moving = torch.tensor(positions, requires_grad=True)
    moved_mesh = mesh.like(moving)
    energy = parts_of(moving, moved_mesh, torch.tensor(earlier))[part]
    gradient = torch.autograd.grad(energy, moving)[0].numpy()
    step = 1e-7
    for vertex, axis in rng.integers(0, (len(positions), 3), size=(25, 2)):
        shift = np.zeros_like(positions)
        shift[vertex, axis] = step
        up, down = (parts_of(positions + sign * shift, mesh, earlier)[part] for sign in (1.0, -1.0))
        scale = np.abs(gradient).max()
        assert_allclose(gradient[vertex, axis], (up - down) / (2.0 * step), rtol=1e-5, atol=1e-6 * scale)


def test_torch_equals_numpy_and_batches_equal_singles(rng):
    positions, mesh = crumpled(rng, batch=(2, 3))
    earlier = positions + 0.01 * rng.normal(size=(2, *positions.shape))
    reference = parts_of(positions, mesh, earlier)
    tensor = torch.tensor(positions)
    in_torch = parts_of(tensor, mesh.like(tensor), torch.tensor(earlier))
    assert set(reference) == set(PARTS)
    for part in PARTS:
        assert reference[part].shape == (2, 3)
        assert_allclose(in_torch[part].numpy(), reference[part], rtol=1e-12, atol=1e-15)
        single = parts_of(positions[1, 2], mesh, earlier[:, 1, 2])[part]
        assert_allclose(single, reference[part][1, 2], rtol=1e-12, atol=1e-15)


def test_float32_agrees_with_float64(rng):
    positions, mesh = crumpled(rng)
    tensor = torch.tensor(positions, dtype=torch.float32)
    for part in (energies.membrane, energies.bending, energies.gravity):
        in_single = float(part(tensor, mesh.like(tensor), JERSEY))
        assert_allclose(in_single, part(positions, mesh, JERSEY), rtol=2e-5, atol=1e-9)


@pytest.mark.parametrize("shape", [grid, lambda: equilateral(5, 4), tube])
def test_rest_has_no_elastic_energy(shape):
    rest, mesh = sheet(shape)
    assert_allclose(energies.membrane(rest, mesh, JERSEY), 0.0, rtol=0.0, atol=1e-20)
    assert_allclose(energies.bending(rest, mesh, JERSEY), 0.0, rtol=0.0, atol=REST_J)


def test_elastic_energies_do_not_see_rigid_motion(rng):
    positions, mesh = crumpled(rng)
    moved = positions @ random_rotation(rng).T + rng.normal(size=3)
    for part in (energies.membrane, energies.bending):
        assert_allclose(part(moved, mesh, JERSEY), part(positions, mesh, JERSEY), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    "deformed",
    [np.diag([0.8, 1.0]), np.eye(2), np.diag([1.3, 1.0]), np.array([[1.0, 0.3], [0.0, 1.0]])],
    ids=["pushed", "at rest", "stretched", "sheared"],
)
def test_uniform_strain_is_analytic_stvk(deformed):
    rest, mesh = sheet(grid, 4, 3, cell_m=0.02)
    green = 0.5 * (deformed.T @ deformed - np.eye(2))
    density = MU * (green**2).sum() + 0.5 * LAMBDA * np.trace(green) ** 2
    moved = rest.copy()
    moved[:, :2] = rest[:, :2] @ deformed.T
    assert_allclose(energies.membrane(moved, mesh, JERSEY), 0.08 * 0.06 * density, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("angle", [-2.5, -0.7, 0.0, 0.4, 3.0])
def test_a_fold_costs_one_minus_cosine(angle):
    side = 0.02
    rest = side * np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0], [1.0, 0.5, 0.0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    mesh = ClothMesh.from_rest(rest, faces)
    folded = rest.copy()
    folded[3] = side * np.array([np.cos(angle), 0.5, np.sin(angle)])
    weight = side**2 / (side**2 / 2.0 + side**2 / 2.0)
    expected = JERSEY.bending_j * weight * (1.0 - np.cos(angle))
    assert_allclose(energies.bending(folded, mesh, JERSEY), expected, rtol=1e-6, atol=1e-11)
    # Measured from a folded rest shape, only the difference of the signed angles counts.
    from_folded = ClothMesh.from_rest(folded, faces)
    opposite = rest.copy()
    opposite[3] = side * np.array([np.cos(angle), 0.5, -np.sin(angle)])
    expected = JERSEY.bending_j * weight * (1.0 - np.cos(2.0 * angle))
    assert_allclose(energies.bending(opposite, from_folded, JERSEY), expected, rtol=1e-6, atol=1e-11)


def test_a_bent_equilateral_sheet_is_a_plate_of_that_rigidity():
    rest, mesh = sheet(equilateral, 60, 61)
    curvature = 2.0
    for axis in (0, 1):  # along and across one family of edges
        bent = rest.copy()
        bent[:, axis] = np.sin(curvature * rest[:, axis]) / curvature
        bent[:, 2] = (1.0 - np.cos(curvature * rest[:, axis])) / curvature
        expected = 0.5 * JERSEY.bending_j * curvature**2 * mesh.face_area.sum()
        assert_allclose(energies.bending(bent, mesh, JERSEY), expected, rtol=0.03, atol=0.0)  # the border lacks hinges


def test_mass_is_density_times_area_and_weight_is_its_slope():
    rest, mesh = sheet(tube)
    area = meshes.face_areas(rest, mesh.faces).sum()
    heavy = Material(density_kg_m2=0.35)
    assert_allclose(mesh.vertex_mass(heavy).sum(), 0.35 * area, rtol=1e-12, atol=0.0)
    rise = energies.gravity(rest + np.array([0.0, 0.2, 0.0]), mesh, heavy) - energies.gravity(rest, mesh, heavy)
    assert_allclose(rise, 0.35 * area * 9.81 * 0.2, rtol=1e-12, atol=0.0)
    lowered = energies.gravity(rest, mesh, heavy, height_m=0.2)
    assert_allclose(lowered, energies.gravity(rest, mesh, heavy) - rise, rtol=1e-12, atol=1e-15)


def test_inertia_is_half_m_a2_dt2():
    rest, mesh = sheet()
    moved = rest + np.array([0.0, 3.0, 4.0]) * DT_S**2
    half = 0.5 * mesh.vertex_mass(JERSEY).sum() * 25.0 * DT_S**2
    assert_allclose(energies.inertia(moved, rest, rest, mesh, JERSEY, dt_s=DT_S), half, rtol=1e-12, atol=0.0)


def test_inertia_over_uneven_steps_vanishes_for_uniform_motion_and_takes_times_per_frame():
    rest, mesh = sheet()
    velocity, push = np.array([1.0, -2.0, 0.5]), np.array([0.0, 3e-3, 4e-3])
    dt_s, dt_before_s = np.array([0.01, 0.03, 0.05]), np.array([0.04, 0.02, 0.05])
    before = np.stack([rest] * 3)
    before_that = before - velocity * dt_before_s[:, None, None]
    moved = before + velocity * dt_s[:, None, None] + push
    mass = mesh.vertex_mass(JERSEY).sum()
    got = energies.inertia(moved, before, before_that, mesh, JERSEY, dt_s=dt_s, dt_before_s=dt_before_s)
    assert_allclose(got, 0.5 * mass * 25e-6 / dt_s**2, rtol=1e-9, atol=0.0)
    one = energies.inertia(moved[1], before[1], before_that[1], mesh, JERSEY, dt_s=0.03, dt_before_s=0.02)
    assert_allclose(one, got[1], rtol=1e-12, atol=0.0)


def test_contact_acts_inside_the_gap_only_and_is_independent_of_the_mesh():
    depth = 0.001
    expected = JERSEY.contact_j_m4 * 0.05 * 0.04 * depth**2
    for cells, cell_m in ((1, 0.01), (2, 0.005)):
        rest, mesh = sheet(grid, 5 * cells, 4 * cells, cell_m=cell_m)
        away = np.full(len(rest), JERSEY.contact_gap_m)
        assert energies.contact(away, mesh, JERSEY) == 0.0
        assert_allclose(energies.contact(away - depth, mesh, JERSEY), expected, rtol=1e-12, atol=0.0)
        stiffness = energies.contact_n_per_m(mesh, JERSEY)
        assert_allclose(0.5 * np.sum(stiffness) * depth**2, expected, rtol=1e-12, atol=0.0)


def test_collapsed_triangles_keep_energy_and_gradient_finite():
    rest, mesh = sheet()
    for dtype in (torch.float32, torch.float64):
        for collapsed in (rest * 0.0, rest * [1.0, 0.0, 0.0]):
            positions = torch.tensor(collapsed, dtype=dtype, requires_grad=True)
            parts = energies.total(positions, mesh.like(positions), JERSEY)
            (gradient,) = torch.autograd.grad(torch.stack(list(parts.values())).sum(), positions)
            assert all(torch.isfinite(value) for value in parts.values())
            assert torch.isfinite(gradient).all()


def test_a_hinge_of_needles_bends_freely_and_the_rest_does_not():
    needles = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-5, 0], [0.5, -1e-5, 0]])
    rest = np.concatenate([needles, needles * [1.0, 1e5, 1.0] + [0.0, 0.0, 5.0]])
    faces = np.array([[0, 1, 2], [1, 0, 3], [4, 5, 6], [5, 4, 7]])
    weight = ClothMesh.from_rest(rest, faces).hinge_weight
    assert weight[0] == 0.0
    assert_allclose(weight[1], 1.0, rtol=1e-12, atol=0.0)


def test_total_leaves_out_contact_where_it_is_not_given_a_distance():
    rest, mesh = sheet()
    assert set(energies.total(rest, mesh, JERSEY)) == {"membrane", "bending", "gravity"}


def test_like_keeps_integers_and_takes_the_dtype():
    rest, mesh = sheet()
    mesh = mesh.like(torch.zeros(1, dtype=torch.float32))
    assert mesh.face_index.dtype == torch.int64
    assert mesh.face_area.dtype == torch.float32
    assert mesh.vertex_count == len(rest)


@pytest.mark.parametrize(
    ("vertices", "faces", "match"),
    [
        (np.zeros((4, 2)), np.array([[0, 1, 2]]), "shape"),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), "finite"),
        (np.eye(3), np.zeros((0, 3), dtype=int), "at least one triangle"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]), np.array([[0, 1, 3], [0, 1, 2]]), "area zero"),
        (np.eye(3), np.array([[0, 1, 3]]), "indices"),
    ],
)
def test_meshes_without_a_rest_shape_are_refused(vertices, faces, match):
    with pytest.raises(MeshError, match=match):
        ClothMesh.from_rest(vertices, faces)
