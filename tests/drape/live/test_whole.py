"""The whole cloth at once: its matrix, its factor, and what a step does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh, membrane
from drape.cloth.rest_state import flat
from drape.kernels.problem import problem
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.sheet import LANES
from drape.live.sweeps import PLANES, SCRATCH, gradient_at, leash
from drape.live.whole import CLAMP_M, SPRING, solve, stiffness, whole_step
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.kernels.solver_setup import MATERIALS
from tests.drape.live.folds_setup import sleeve

DTYPES = [np.float32, np.float64]


@pytest.fixture(scope="module")
def dressed() -> WornCloth:
    return sleeve("rib", creased=False)[1]


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_factor_solves_what_the_matrix_says(rng, dressed, dtype):
    constants = FoldConstants.of(dressed, dtype=dtype)
    factor, place = constants.factor, constants.sheet.place
    force = rng.normal(size=(len(place), 3))
    y = np.zeros((len(constants.sheet.vertex), 3))
    y[place] = force
    y = y[factor.place].astype(dtype)
    solve(factor, y)
    found = np.zeros((len(constants.sheet.vertex), 3))
    found[factor.place] = y
    matrix = stiffness(dressed.cloth, dressed.material, dressed.springs_n_per_m)
    wanted = np.linalg.solve(matrix.toarray(), force)
    assert_allclose(
        found[place], wanted, rtol=0.0, atol=(1e-5 if dtype == np.float32 else 1e-13) * np.abs(wanted).max()
    )


def test_a_stretch_costs_what_the_matrix_says_less_the_shear():
    """Stretched along warp or weft K costs what the membrane does, and the shear's stiffness besides."""
    vertices, faces = grid()
    warp = np.tile([1.0, 0.0, 0.0], (len(faces), 1))
    cloth = ClothMesh.of(flat(vertices, faces, warp), faces, len(vertices))
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


def test_a_vertex_without_area_has_no_springs(dressed):
    area = dressed.cloth.vertex_area.copy()
    area[3] = 0.0
    band = np.where(area > 0.0, dressed.band_n_per_m, 0.0)
    springs = replace(dressed, cloth=replace(dressed.cloth, vertex_area=area), band_n_per_m=band).springs_n_per_m
    assert springs[3] == 0.0 and np.isfinite(springs).all()


def pressed(dressed: WornCloth, depth_m: float, *, dtype: type[np.floating] = np.float64, factor: float = 1.0):
    """How far [m] (V, 3) a step moves a sleeve without weight that is ``depth_m`` [m] too deep in planes."""
    constants = FoldConstants.of(dressed, dtype=dtype)
    sheet = constants.sheet
    own = sheet.own.reshape(-1, 4, LANES).copy()
    own[:, 0] = 0.0
    sheet = sheet._replace(own=own.reshape(-1))
    x = np.zeros((len(sheet.vertex), 3), dtype)
    x[sheet.place] = sleeve("rib", creased=False)[0]
    up = np.tile(np.array([0.0, 0.0, 1.0], dtype), (len(x), 1))
    point = x + dtype(depth_m - 0.004) * up  # contact begins at a gap of 4 mm
    # No other part is near, nothing holds or rubs.
    blocks = [rows.reshape(-1, LANES, rows.shape[1]) for rows in (point, up, *4 * [0.0 * up])]
    planes = np.ascontiguousarray(np.concatenate(blocks, axis=2).transpose(0, 2, 1)).reshape(-1)
    assert len(planes) == PLANES // LANES * len(x)
    leash(sheet, planes)
    gradient = np.empty_like(x)
    gradient_at(x, sheet, planes, x.copy(), np.empty(SCRATCH, dtype), gradient)
    before = x.copy()
    level = constants.factor._replace(inverse=constants.factor.inverse * dtype(factor))
    whole_step(x, level, gradient, dtype(0.5))
    return (x - before)[sheet.place], gradient[sheet.place]


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_step_takes_a_share_of_the_answer(dressed, dtype):
    moved, gradient = pressed(dressed, 1e-5, dtype=dtype)
    assert moved.dtype == dtype
    matrix = stiffness(dressed.cloth, dressed.material, dressed.springs_n_per_m).toarray()
    wanted = -0.5 * np.linalg.solve(matrix, gradient.astype(np.float64))
    assert wanted[:, 2].min() > 0.0, "it lifts what is pressed"
    # The sleeve is 0.1 m long, in float32 a place is known to 1e-8 m.
    assert_allclose(moved, wanted, rtol=0.0, atol=2e-8 if dtype == np.float32 else 1e-14)


def test_a_step_is_clamped(dressed):
    moved, _ = pressed(dressed, 0.5)
    assert_allclose(np.linalg.norm(moved, axis=1).max(), 0.5 * CLAMP_M, rtol=1e-9)


@pytest.mark.parametrize("factor", [np.nan, np.inf])
def test_an_answer_that_is_no_number_moves_nothing(dressed, factor):
    assert_array_equal(pressed(dressed, 0.002, factor=factor)[0], 0.0)
