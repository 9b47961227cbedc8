"""Patches follow what the fit leaves over, and the worst of them gains most."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import adaptive, density, fitting
from drape.garment.adaptive import adaptive_density, patch_rmse
from drape.garment.fitting import patch_fields
from tests.drape.body.body_files import default_body
from tests.drape.garment.rest_garments import barrel, shipped


def curvature(rest: fitting.RestGarment) -> np.ndarray:
    return density.curvature_density(rest.vertices, rest.faces, rest.normals, rest.areas)


def test_patch_error_is_the_weighted_root_mean_square_of_its_residuals(rng):
    rest = barrel()
    fields = patch_fields(rest, count=5)
    found = patch_rmse(rest, fields)
    for k in range(5):
        row, slot = np.nonzero((fields["chart_patch"] == k) & (fields["chart_weight"] > 0))
        weight = fields["chart_weight"][row, slot].astype(np.float64) * rest.areas[row]
        squared = np.sum(fields["chart_residual"][row, slot].astype(np.float64) ** 2, axis=-1)
        assert_allclose(found[k], np.sqrt(weight @ squared / weight.sum()), rtol=1e-6, atol=0)


def test_without_rounds_it_is_the_curvature_alone():
    rest = barrel()
    assert_array_equal(adaptive_density(rest, count=24, rounds=0), curvature(rest))


def test_it_is_the_best_of_its_rounds_in_the_kind_of_chart_that_is_asked_for():
    garment = shipped("shorts")
    rest = fitting.rest_garment(garment.vertices, garment.fine_faces, default_body())
    for unfold in (False, True):
        found = adaptive_density(rest, rounds=1, unfold=unfold)
        error = patch_rmse(rest, patch_fields(rest, density=found, unfold=unfold)).max()
        alone = patch_rmse(rest, patch_fields(rest, density=curvature(rest), unfold=unfold)).max()
        assert error < alone


def test_equal_errors_change_nothing_and_a_bad_patch_grows_denser():
    rest = barrel()
    fields = patch_fields(rest, count=24)
    start = np.full(len(rest.vertices), 1.0)
    assert_allclose(adaptive._refined(rest, start, fields, np.full(24, 1e-3)), 1.0, rtol=1e-6, atol=0)
    error = np.full(24, 1e-3)
    error[3] = 5e-3
    raised = adaptive._refined(rest, start, fields, error)
    own = (fields["chart_patch"] == 3) & (fields["chart_weight"] > 0.5)
    assert raised[own.any(axis=1)].min() > 1.5
    assert np.median(raised) < 1.1
    assert raised.min() >= 1.0 and raised.max() <= density.DENSITY_LIMIT


def test_adaptive_patches_halve_the_worst_error_of_the_most_curved_shipped_garment():
    garment = shipped("trousers")
    rest = fitting.rest_garment(garment.vertices, garment.fine_faces, default_body())
    even = patch_fields(rest)
    fields = patch_fields(rest, density=adaptive_density(rest, rounds=1))
    assert len(fields["patch_scale"]) == len(even["patch_scale"])
    assert patch_rmse(rest, fields).max() < 0.5 * patch_rmse(rest, even).max()
    alone = patch_fields(rest, density=curvature(rest))
    assert patch_rmse(rest, fields).max() <= patch_rmse(rest, alone).max()
