"""Energy, gradient and sweeps: compiled against readable, against the energies of the product, and their laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth import energies
from drape.cloth.contact import plane_distance
from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import flat
from drape.cloth.waistband import band_energy
from drape.solver import descent, reference
from drape.solver.problem import flat_at_rest, problem, surroundings
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.solver.solver_setup import MATERIALS, crumpled

CASES = [(name, rest) for name in MATERIALS for rest in (False, True)]


def energy_at(scene, x):
    return descent.energy_and_gradient(x, scene.problem, scene.around, np.empty_like(x))


@pytest.mark.parametrize(("material", "flat_rest"), CASES)
def test_the_energy_is_that_of_the_product(material, flat_rest):
    scene = crumpled(material, flat_rest=flat_rest, springs=False)
    distance = plane_distance(scene.x, scene.around.point, scene.around.normal)
    parts = energies.total(scene.x, scene.cloth, scene.material, distance=distance)
    assert_allclose(energy_at(scene, scene.x), sum(parts.values()), rtol=1e-12, atol=0.0)


def test_springs_are_inertia_and_waistband():
    bare, held = crumpled(springs=False), crumpled()
    around = bare.around._replace(
        target=held.around.target,
        target_n_per_m=bare.cloth.vertex_mass(bare.material) / 0.02**2,
        band=held.around.band,
        band_n_per_m=500.0 * bare.cloth.vertex_area,
    )
    gradient = np.empty_like(bare.x)
    added = descent.energy_and_gradient(bare.x, bare.problem, around, gradient) - energy_at(bare, bare.x)
    still = held.around.target
    inertia = energies.inertia(bare.x, still, still, bare.cloth, bare.material, dt_s=0.02)
    band = band_energy((bare.x - around.band)[None], bare.cloth.vertex_area)[0]
    assert_allclose(added, inertia + band, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize(("material", "flat_rest"), CASES)
def test_kernels_equal_the_reference(material, flat_rest):
    scene = crumpled(material, flat_rest=flat_rest)
    gradient = np.empty_like(scene.x)
    energy = descent.energy_and_gradient(scene.x, scene.problem, scene.around, gradient)
    wanted, wanted_gradient = reference.energy_and_gradient(scene.x, scene.problem, scene.around)
    assert_allclose(energy, wanted, rtol=1e-12, atol=0.0)
    assert_allclose(gradient, wanted_gradient, rtol=0.0, atol=1e-12 * np.abs(wanted_gradient).max())
    moved = scene.x.copy()
    descent.sweep(moved, scene.problem, scene.around, False)
    assert_allclose(moved, reference.sweep(scene.x, scene.problem, scene.around), rtol=0.0, atol=1e-11)
    blocks = np.empty((len(moved), 3, 3))
    descent.diagonal_blocks(scene.x, scene.problem, scene.around, blocks)
    wanted_block = reference.vertex_block(9, scene.x, scene.problem, scene.around)[1]
    assert_allclose(blocks[9], wanted_block, rtol=1e-10, atol=1e-10 * np.abs(wanted_block).max())


@pytest.mark.parametrize("kernel", [descent.energy_and_gradient, descent.quadratic_energy_and_gradient])
def test_gradients_equal_central_differences(rng, kernel):
    scene = crumpled("rib", flat_rest=True)
    gradient, unused = np.empty_like(scene.x), np.empty_like(scene.x)
    kernel(scene.x, scene.problem, scene.around, gradient)
    step, scale = 1e-7, np.abs(gradient).max()
    for vertex, axis in rng.integers(0, scene.x.shape, size=(25, 2)):
        shift = np.zeros_like(scene.x)
        shift[vertex, axis] = step
        up, down = (kernel(scene.x + s * shift, scene.problem, scene.around, unused) for s in (1.0, -1.0))
        assert_allclose(gradient[vertex, axis], (up - down) / (2.0 * step), rtol=1e-5, atol=1e-6 * scale)


@pytest.mark.parametrize(("material", "flat_rest"), CASES)
def test_a_guarded_sweep_never_raises_the_energy(material, flat_rest):
    scene = crumpled(material, flat_rest=flat_rest, noise_m=0.003)
    x, before = scene.x.copy(), energy_at(scene, scene.x)
    start = before
    for _ in range(30):
        descent.sweep(x, scene.problem, scene.around, True)
        after = energy_at(scene, x)
        assert after <= before + 1e-12 * abs(start)
        before = after
    assert after < 0.5 * start


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("quadratic", [False, True])
def test_sweeps_give_the_same_bits_again(dtype, quadratic):
    scene = crumpled("denim", flat_rest=True, dtype=dtype)
    ends = []
    for _ in range(2):
        x = scene.x.copy()
        for _ in range(3):
            if quadratic:
                descent.quadratic_sweep(x, scene.problem, scene.around)
            else:
                descent.sweep(x, scene.problem, scene.around, False)
        ends.append(x)
    assert ends[0].dtype == dtype
    assert_array_equal(*ends)


@pytest.mark.parametrize("material", MATERIALS)
def test_float32_follows_float64(material):
    single, double = (crumpled(material, flat_rest=True, dtype=dtype) for dtype in (np.float32, np.float64))
    assert_allclose(energy_at(single, single.x), energy_at(double, double.x), rtol=2e-4, atol=0.0)
    ends = []
    for scene in (single, double):
        x = scene.x.copy()
        for _ in range(3):
            descent.quadratic_sweep(x, scene.problem, scene.around)
        ends.append(x)
    assert_allclose(ends[0], ends[1], rtol=0.0, atol=2e-5)  # metres; the grid is 60 mm wide


def test_the_quadratic_bending_is_that_of_the_hinges_where_they_are_nearly_flat():
    assert not flat_at_rest(crumpled().problem)
    rest, faces = grid(8, 5)
    cloth = ClothMesh.of(flat(rest, faces), faces, len(rest))
    made = problem(cloth, replace(MATERIALS["rib"], gravity_m_s2=0.0), dtype=np.float64)
    assert flat_at_rest(made)
    around = surroundings(made, rest - np.array([0.0, 0.0, 1.0]), np.tile([0.0, 0.0, 1.0], (len(rest), 1)))
    bent, unused = rest.copy(), np.empty_like(rest)
    bent[:, 2] = 2e-5 * np.sin(300.0 * rest[:, 0])
    kernels = (descent.energy_and_gradient, descent.quadratic_energy_and_gradient)
    hinges, quadratic = (kernel(bent, made, around, unused) - kernel(rest, made, around, unused) for kernel in kernels)
    assert hinges > 0.0
    assert_allclose(quadratic, hinges, rtol=1e-3, atol=0.0)


def test_a_step_is_no_longer_than_it_may_be():
    scene = crumpled("poplin", noise_m=0.02, springs=False)
    x = scene.x.copy()
    descent.sweep(x, scene.problem, scene.around, False)
    moved = np.linalg.norm(x - scene.x, axis=1)
    assert moved.max() > 0.9 * scene.problem.constants.reach
    assert (moved <= scene.problem.constants.reach * (1.0 + 1e-9)).all()
