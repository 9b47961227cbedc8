"""Energy, gradient and sweeps: the engine against the reference and the energies of the product, and their laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth import energies
from drape.cloth.contact import plane_distance
from drape.cloth.energies import ClothMesh
from drape.cloth.problem import problem
from drape.cloth.rest_state import flat_rest
from drape.cloth.waistband import band_energy
from drape.exact import descent
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.cloth.solver_setup import MATERIALS, crumpled
from tests.reference import solver as reference

CASES = [(name, rest) for name in MATERIALS for rest in (False, True)]


def energy_at(scene, x):
    return descent.energy_and_gradient(x, scene.problem, scene.around, np.empty_like(x))


@pytest.mark.parametrize(("material", "flat"), CASES)
def test_the_energy_is_that_of_the_product(material, flat):
    scene = crumpled(material, flat=flat, springs=False)
    distance = plane_distance(scene.x, scene.around.point, scene.around.normal)
    parts = energies.total(scene.x, scene.cloth, scene.material, distance=distance)
    assert_allclose(energy_at(scene, scene.x), sum(parts.values()), rtol=1e-12, atol=0.0)


def test_springs_are_inertia_and_waistband():
    bare, held = crumpled(springs=False), crumpled()
    around = replace(
        bare.around,
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


@pytest.mark.parametrize(("material", "flat"), CASES)
def test_the_engine_equals_the_reference(material, flat):
    scene = crumpled(material, flat=flat)
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


@pytest.mark.parametrize(("material", "flat"), CASES)
def test_a_guarded_sweep_never_raises_the_energy(material, flat):
    scene = crumpled(material, flat=flat, noise_m=0.003)
    x, before = scene.x.copy(), energy_at(scene, scene.x)
    start = before
    for _ in range(30):
        descent.sweep(x, scene.problem, scene.around, True)
        after = energy_at(scene, x)
        assert after <= before + 1e-12 * abs(start)
        before = after
    assert after < 0.5 * start


def test_sweeps_give_the_same_bits_again():
    scene = crumpled("denim", flat=True)
    ends = [scene.x.copy() for _ in range(2)]
    for x in ends:
        for _ in range(3):
            descent.sweep(x, scene.problem, scene.around, False)
    assert_array_equal(ends[0], ends[1])


def test_the_quadratic_bending_is_that_of_the_hinges_where_they_are_nearly_flat():
    rest, faces = grid(8, 5)
    cloth = ClothMesh.of(flat_rest(rest, faces), faces, len(rest))
    made = problem(cloth, MATERIALS["rib"], dtype=np.float64)
    assert len(made.creases.corner) == 0
    bent = rest.copy()
    bent[:, 2] = 2e-5 * np.sin(300.0 * rest[:, 0])
    hinges = energies.bending(bent, cloth, MATERIALS["rib"]) - energies.bending(rest, cloth, MATERIALS["rib"])
    bend = made.quadratic
    matrix = scipy.sparse.csr_matrix((bend.value, bend.vertex, bend.start)) + scipy.sparse.diags(bend.diagonal)
    assert hinges > 0.0
    assert_allclose(0.5 * (bent * (matrix @ bent)).sum(), hinges, rtol=1e-3, atol=0.0)


def test_hinges_that_are_not_flat_at_rest_are_creases():
    rest, faces = grid(8, 5)
    state = flat_rest(rest, faces)
    angle = np.where(np.arange(len(state.hinge_angle)) < 3, 0.4, 0.0)
    cloth = ClothMesh.of(replace(state, hinge_angle=angle), faces, len(rest))
    made = problem(cloth, MATERIALS["rib"], dtype=np.float64)
    assert_array_equal(made.creases.corner, made.hinges.corner[:3])
    assert_array_equal(made.creases.stiffness, made.hinges.stiffness[:3])
    for v in range(len(rest)):
        member = made.creases.member[made.creases.start[v] : made.creases.start[v + 1]]
        assert (made.creases.corner[member // 4, member % 4] == v).all()
    assert made.creases.start[-1] == made.creases.corner.size
    whole = problem(ClothMesh.of(state, faces, len(rest)), MATERIALS["rib"], dtype=np.float64)
    assert np.abs(made.quadratic.diagonal).sum() < np.abs(whole.quadratic.diagonal).sum()


def test_a_step_is_no_longer_than_it_may_be():
    scene = crumpled("poplin", noise_m=0.02, springs=False)
    x = scene.x.copy()
    descent.sweep(x, scene.problem, scene.around, False)
    moved = np.linalg.norm(x - scene.x, axis=1)
    assert moved.max() > 0.9 * scene.problem.constants.reach
    assert (moved <= scene.problem.constants.reach * (1.0 + 1e-9)).all()
