"""The whole cloth at once: its matrix, its factor, and what a step does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh, membrane
from drape.cloth.problem import problem
from drape.cloth.rest_state import flat_rest
from drape.engine.calls import call, call_with_scratch
from drape.engine.library import LANES, empty_points
from drape.live.fold_constants import WornCloth
from drape.live.whole import SPRING, stiffness
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.cloth.solver_setup import MATERIALS
from tests.drape.live.folds_setup import PLANE_ROWS, constants, planes_of, sleeve, spared
from tests.reference.folds import CLAMP_M


@pytest.fixture(scope="module")
def worn() -> WornCloth:
    return sleeve(creased=False)[1]


def matrix_of(worn: WornCloth) -> np.ndarray:
    return stiffness(worn.cloth, worn.material, worn.springs_n_per_m).toarray()


@pytest.mark.parametrize(("dtype", "within"), [(np.float32, 1e-5), (np.float64, 1e-13)])
def test_the_factor_solves_what_the_matrix_says(rng, worn, dtype, within):
    made = constants(creased=False, dtype=dtype)
    factor, place = made.factor, made.sheet.place
    force, found = rng.normal(size=(len(place), 3)), np.zeros((len(made.sheet.vertex), 3))
    found[place] = force
    y = spared(found[factor.place].astype(dtype))
    call_with_scratch("law_solve", dtype, made, y)
    found[factor.place] = y
    wanted = np.linalg.solve(matrix_of(worn), force)
    assert_allclose(found[place], wanted, rtol=0.0, atol=within * np.abs(wanted).max())


def test_a_stretch_costs_what_the_matrix_says_less_the_shear():
    """Stretched along warp or weft K costs what the membrane does, and the shear's stiffness besides."""
    vertices, faces = grid()
    warp = np.tile([1.0, 0.0, 0.0], (len(faces), 1))
    cloth = ClothMesh.of(flat_rest(vertices, faces, warp), faces, len(vertices))
    material = MATERIALS["denim"]
    matrix = stiffness(cloth, material, np.zeros(len(vertices))).toarray()
    assert_allclose(matrix, matrix.T, rtol=0.0, atol=1e-12 * matrix.max())
    springs = SPRING * problem(cloth, material, dtype=np.float64).contact_n_per_m
    assert_allclose(matrix.sum(axis=1), springs, rtol=1e-9, err_msg="a shift strains nothing")
    strain, area = 1e-6, cloth.face_area.sum()
    for axis, own in ((0, material.warp_n_per_m), (1, material.weft_n_per_m)):
        way = np.zeros_like(vertices)
        way[:, axis] = strain * vertices[:, axis]
        cost = 0.5 * np.einsum("vi,vw,wi->", way, matrix, way) - 0.5 * float(springs @ (way**2).sum(axis=1))
        assert_allclose(cost, 0.5 * (own + material.shear_n_per_m) * strain**2 * area, rtol=1e-9)
        assert_allclose(membrane(vertices + way, cloth, material), 0.5 * own * strain**2 * area, rtol=1e-4)


def test_a_vertex_without_area_has_no_springs(worn):
    area = worn.cloth.vertex_area.copy()
    area[3] = 0.0
    band = np.where(area > 0.0, worn.band_n_per_m, 0.0)
    springs = replace(worn, cloth=replace(worn.cloth, vertex_area=area), band_n_per_m=band).springs_n_per_m
    assert springs[3] == 0.0 and np.isfinite(springs).all()


def pressed(depth_m: float, *, dtype: type[np.floating] = np.float64, wrong: float = 1.0, at: slice = slice(0)):
    """How far [m] (V, 3) a step moves a sleeve without weight that is ``depth_m`` [m] too deep in planes, with a number
    that is ``wrong`` times its own ``at`` places of the factor."""
    made = constants(creased=False, dtype=dtype)
    own = made.sheet.own.reshape(-1, 4, LANES).copy()
    own[:, 0] = 0.0
    sheet = made.sheet._replace(own=own.reshape(-1))
    inverse = made.factor.inverse.copy()
    inverse[at] *= dtype(wrong)
    changed = made.factor._replace(inverse=inverse)
    made, x = replace(made, sheet=sheet, factor=changed), empty_points(len(sheet.vertex), dtype)
    x[sheet.place] = sleeve(creased=False)[0]
    up = np.array([0.0, 0.0, 1.0], dtype)
    call("law_hold", dtype, made, planes := np.empty(PLANE_ROWS * len(x), dtype))
    planes += planes_of(x + dtype(depth_m - 0.004) * up, up)  # contact begins at a gap of 4 mm
    gradient = np.empty_like(x)
    before = x.copy()
    call("law_gradient", dtype, x, made, planes, before, gradient)
    call_with_scratch("law_whole_step", dtype, x, made, gradient)
    return (x - before)[sheet.place], gradient[sheet.place]


# The sleeve is 0.1 m long: in float32 a place is known to 1e-8 m.
@pytest.mark.parametrize(("dtype", "within"), [(np.float32, 2e-8), (np.float64, 1e-14)])
def test_a_step_takes_the_answer(worn, dtype, within):
    moved, gradient = pressed(1e-5, dtype=dtype)
    assert moved.dtype == dtype
    wanted = -np.linalg.solve(matrix_of(worn), gradient.astype(np.float64))
    assert wanted[:, 2].min() > 0.0, "it lifts what is pressed"
    assert_allclose(moved, wanted, rtol=0.0, atol=within)


def test_a_step_is_clamped():
    moved, _ = pressed(0.5)
    assert_allclose(np.linalg.norm(moved, axis=1).max(), CLAMP_M, rtol=1e-9)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("at", [slice(None), slice(1)])
def test_an_answer_that_is_no_number_moves_nothing(wrong, at):
    assert_array_equal(pressed(0.002, wrong=wrong, at=at)[0], 0.0)
