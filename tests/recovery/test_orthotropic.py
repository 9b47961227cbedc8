"""Element energies: derivatives, symmetries and the shared formulas, in numpy and torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth import energies, orthotropic
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.cloth.orthotropic import OrthotropicMaterial
from drape.errors import InputError
from tests.recovery.sim_setup import WOVEN, lifted, strip

STRETCH = WOVEN.stretch_n_per_m


def numeric(function, position: np.ndarray, *, step: float = 1e-6) -> np.ndarray:
    """Central differences by every corner coordinate, (9 or 12, ...)."""
    slopes = []
    for corner in range(position.shape[0]):
        for axis in range(3):
            move = np.zeros_like(position)
            move[corner, axis] = step
            slopes.append((function(position + move) - function(position - move)) / (2.0 * step))
    return np.array(slopes)


def triangles(rng: np.random.Generator, count: int = 200) -> tuple[np.ndarray, orthotropic.RestShape]:
    """Random deformed triangles over random rest triangles of size 1."""
    panel = np.array([[0.0, 0.0], [1.0, 0.1], [0.2, 0.9]])[:, :, None] + 0.15 * rng.normal(size=(3, 2, count))
    return rng.normal(size=(3, 3, count)), orthotropic.rest_shape(panel)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error over all elements, relative to each element's largest entry."""
    axes = tuple(range(expected.ndim - 1))
    return float((np.abs(found - expected).max(axis=axes) / np.abs(expected).max(axis=axes)).max())


def hinges(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    """Hinges of size 1 with every fold between -pi and pi."""
    fold = rng.uniform(-3.1, 3.1, size=count)
    zero, one = np.zeros(count), np.ones(count)
    flat = np.array([[zero, zero, zero], [one, zero, zero], [0.4 * one, one, zero]])
    folded = np.array([[0.6 * one, -0.9 * np.cos(fold), 0.9 * np.sin(fold)]])
    return np.concatenate([flat, folded]) + 0.05 * rng.normal(size=(4, 3, count))


def gradient_error(energy, gradient, position: np.ndarray) -> float:
    found = gradient(position)
    return relative(found.reshape(-1, found.shape[-1]), numeric(energy, position))


def test_membrane_gradient_is_the_derivative_of_the_energy(rng):
    position, rest = triangles(rng)
    error = gradient_error(
        lambda x: orthotropic.membrane_energy(x, rest, STRETCH),
        lambda x: orthotropic.membrane_gradient(x, rest, STRETCH),
        position,
    )
    assert error < 1e-7


def test_bending_gradient_is_the_derivative_of_the_energy(rng):
    position, weight = hinges(rng), rng.uniform(0.5, 2.0, size=200)
    error = gradient_error(
        lambda x: orthotropic.bending_energy(x, weight, 0.3),
        lambda x: orthotropic.bending_gradient(x, weight, 0.3),
        position,
    )
    assert error < 1e-7


def test_a_wrong_sign_in_the_force_is_found(rng):
    """Mutations: the derivative check must fail on each of them."""
    position, rest = triangles(rng)

    def shear_flipped(x):
        return orthotropic.membrane_gradient(x, rest, STRETCH * np.array([1.0, 1.0, 1.0, -1.0]))

    assert gradient_error(lambda x: orthotropic.membrane_energy(x, rest, STRETCH), shear_flipped, position) > 1e-2
    position, weight = hinges(rng), np.ones(200)

    def one_corner_flipped(x):
        return orthotropic.bending_gradient(x, weight, 1.0) * np.array([1.0, 1.0, 1.0, -1.0])[:, None, None]

    assert gradient_error(lambda x: orthotropic.bending_energy(x, weight, 1.0), one_corner_flipped, position) > 1e-2


def test_hessians_are_the_derivatives_of_the_gradients_and_symmetric(rng):
    position, rest = triangles(rng)
    found = orthotropic.membrane_hessian(position, rest, STRETCH, definite=False)
    slope = numeric(lambda x: orthotropic.membrane_gradient(x, rest, STRETCH).reshape(9, -1), position)
    assert relative(found, slope) < 1e-6
    assert_allclose(found, found.transpose(1, 0, 2), rtol=0, atol=1e-12 * np.abs(found).max())
    position, weight = hinges(rng), rng.uniform(0.5, 2.0, size=200)
    found = orthotropic.bending_hessian(position, weight, 0.3, definite=False)
    slope = numeric(lambda x: orthotropic.bending_gradient(x, weight, 0.3).reshape(12, -1), position)
    assert relative(found, slope) < 1e-6
    assert_allclose(found, found.transpose(1, 0, 2), rtol=0, atol=1e-12 * np.abs(found).max())


def test_definite_hessians_have_no_negative_eigenvalue(rng):
    """1,000 random states: compression, inversion and folds up to nearly +-pi among them."""
    position, rest = triangles(rng, 1000)
    position[:, :, ::2] *= 0.2
    for hessian in (
        orthotropic.membrane_hessian(position, rest, STRETCH, definite=True),
        orthotropic.bending_hessian(hinges(rng, 1000), np.ones(1000), 1.0, definite=True),
    ):
        values = np.linalg.eigvalsh(hessian.transpose(2, 0, 1))
        assert (values[:, 0] > -1e-12 * values[:, -1]).all()
    exact = orthotropic.membrane_hessian(position, rest, STRETCH, definite=False)
    assert np.linalg.eigvalsh(exact.transpose(2, 0, 1))[:, 0].min() < -1.0  # else the test above shows nothing


def test_the_definite_hessian_is_the_exact_one_in_tension(rng):
    position, rest = triangles(rng)
    position = 4.0 * position
    values = orthotropic.stress(orthotropic.green_strain(orthotropic.deformation(position, rest)), STRETCH)
    centre, radius = 0.5 * (values[0] + values[1]), np.hypot(0.5 * (values[0] - values[1]), values[2])
    taut = centre - radius > 1.0
    assert taut.sum() > 20
    exact, definite = (
        orthotropic.membrane_hessian(position, rest, STRETCH, definite=flag)[:, :, taut] for flag in (False, True)
    )
    assert_allclose(definite, exact, rtol=0, atol=1e-3 * np.abs(exact).max())


@pytest.mark.parametrize("definite", [False, True])
def test_contractions_equal_the_stored_derivatives(rng, definite):
    position, rest = triangles(rng)
    left, right = rng.normal(size=(2, *position.shape))
    hessian = orthotropic.membrane_hessian(position, rest, STRETCH, definite=definite)
    found = orthotropic.membrane_bilinear(position, rest, STRETCH, left, right, definite=definite)
    expected = np.einsum("in,ijn,jn->n", left.reshape(9, -1), hessian, right.reshape(9, -1))
    assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    found = orthotropic.membrane_work(position, rest, STRETCH, left)
    expected = (orthotropic.membrane_gradient(position, rest, STRETCH) * left).sum(axis=(0, 1))
    assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    position, weight = hinges(rng), np.ones(200)
    left, right = rng.normal(size=(2, *position.shape))
    hessian = orthotropic.bending_hessian(position, weight, 1.0, definite=definite)
    found = orthotropic.bending_bilinear(position, weight, 1.0, left, right, definite=definite)
    expected = np.einsum("in,ijn,jn->n", left.reshape(12, -1), hessian, right.reshape(12, -1))
    assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_an_isotropic_cloth_has_the_energy_of_the_network(rng):
    """H00 = lambda + 2 mu, H01 = lambda, H22 = 2 mu; near the plane both hinges agree."""
    panel, faces = strip(4, 3, length_m=0.2, width_m=0.15)
    positions = lifted(panel) + 1e-3 * rng.normal(size=(len(panel), 3))
    jersey = material("jersey")
    mesh = ClothMesh.from_rest(lifted(panel), faces)
    woven = jersey.woven
    rest = orthotropic.rest_shape(panel.T[:, faces.T].transpose(1, 0, 2))
    found = orthotropic.membrane_energy(positions.T[:, faces.T].transpose(1, 0, 2), rest, woven.stretch_n_per_m)
    assert_allclose(found.sum(), energies.membrane(positions, mesh, jersey), rtol=1e-10)
    corners = orthotropic.corners(positions.T, mesh.hinge_index, 4)
    found = orthotropic.bending_energy(corners, mesh.hinge_weight, woven.bending_j)
    assert_allclose(found.sum(), energies.bending(positions, mesh, jersey), rtol=1e-3)


def test_the_moment_of_a_hinge_grows_up_to_a_full_fold():
    fold = np.linspace(0.1, 3.1, 31)
    zero, one = np.zeros_like(fold), np.ones_like(fold)
    flat = np.array([[zero, zero, zero], [one, zero, zero], [zero, one, zero]])
    position = np.concatenate([flat, [[zero, -np.cos(fold), -np.sin(fold)]]])
    assert_allclose(np.abs(orthotropic.hinge_angle(position)), fold, rtol=1e-12)
    moment = np.linalg.norm(orthotropic.bending_gradient(position, one, 1.0)[3], axis=0)
    assert_allclose(moment, 2.0 * np.sin(0.5 * fold), rtol=1e-10)


def test_tension_is_positive_smooth_and_leaves_large_tension_alone(rng):
    values = rng.normal(size=(3, 1000))
    found = orthotropic.tension(values, 1e-3)
    centre, radius = 0.5 * (values[0] + values[1]), np.hypot(0.5 * (values[0] - values[1]), values[2])
    expected = [0.5 * (p + np.sqrt(p * p + 1e-6)) for p in (centre + radius, centre - radius)]
    matrices = np.stack([[found[0], found[2]], [found[2], found[1]]]).transpose(2, 0, 1)
    assert_allclose(np.linalg.eigvalsh(matrices).T[::-1], expected, rtol=1e-6, atol=1e-9)
    at_zero = torch.zeros(3, 1, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: orthotropic.tension(s, 1e-3), at_zero, eps=1e-9)


def test_numpy_and_torch_agree(rng):
    position, rest = triangles(rng)
    moved = orthotropic.RestShape(*(torch.from_numpy(part) for part in rest))
    found = orthotropic.membrane_hessian(torch.from_numpy(position), moved, torch.from_numpy(STRETCH), definite=True)
    expected = orthotropic.membrane_hessian(position, rest, STRETCH, definite=True)
    assert_allclose(found.numpy(), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    position, weight = hinges(rng), np.ones(200)
    found = orthotropic.bending_hessian(torch.from_numpy(position), torch.from_numpy(weight), 1.0, definite=False)
    expected = orthotropic.bending_hessian(position, weight, 1.0, definite=False)
    assert_allclose(found.numpy(), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("change", [{"h00": 0.0}, {"h01": 60.0}, {"bending_j": -1.0}, {"density_kg_m2": np.nan}])
def test_a_cloth_that_gives_way_is_refused(change):
    numbers = {**vars(WOVEN), **change}
    with pytest.raises(InputError, match="orthotropic material"):
        OrthotropicMaterial(**numbers)
