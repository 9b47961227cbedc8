"""Curvature is that of known surfaces, and a partition follows the density made of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.garment import density, fitting
from drape.garment.fitting import patch_fields
from tests.drape.body.body_files import default_body
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.garment.rest_garments import shipped

PLACE = np.array([0.0, 0.3, 0.4])  # before the chest of the body


def measured(vertices: np.ndarray, faces: np.ndarray) -> tuple[fitting.RestGarment, np.ndarray]:
    rest = fitting.rest_garment(vertices, faces, default_body())
    return rest, density.curvature_squared(rest.vertices, faces, rest.normals, rest.areas)


@pytest.mark.parametrize("radius_m", [0.05, 0.2])
def test_curvature_of_a_cylinder_is_one_over_its_radius(radius_m):
    vertices, faces = tube(64, 20, radius_m=radius_m, height_m=0.3)
    rest, squared = measured(vertices, faces)
    assert len(squared) == len(rest.vertices)
    assert_allclose(np.median(np.sqrt(squared)), 1.0 / radius_m, rtol=0.05, atol=0)


def test_a_plane_has_none_and_density_one():
    vertices, faces = grid(10, 10, cell_m=0.01)
    rest, squared = measured(vertices, faces)
    assert_allclose(squared, 0.0, rtol=0, atol=1e-9)
    assert_allclose(density.curvature_density(rest.vertices, faces, rest.normals, rest.areas), 1.0, rtol=0, atol=1e-9)


def test_spreading_keeps_the_total_and_brings_values_together(rng):
    vertices, faces = grid(20, 20, cell_m=0.01)
    rest, _ = measured(vertices, faces)
    values = rng.random(len(vertices))
    after = density.spread(values, rest.vertices, faces, rest.areas, width_m=0.03)
    assert_allclose(rest.areas @ after, rest.areas @ values, rtol=1e-9, atol=0)
    assert after.min() > values.min() and after.max() < values.max()


def test_density_does_not_depend_on_where_the_garment_lies(rng):
    garment = shipped("shorts")
    rest = fitting.rest_garment(garment.vertices, garment.fine_faces, default_body())
    first = density.curvature_density(rest.vertices, rest.faces, rest.normals, rest.areas)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    second = density.curvature_density(rest.vertices @ turn.T + 1.0, rest.faces, rest.normals @ turn.T, rest.areas)
    assert_allclose(second, first, rtol=1e-6, atol=0)
    assert first.min() >= 1.0 and first.max() <= density.DENSITY_LIMIT


def test_patches_are_smaller_where_the_density_is_high():
    vertices, faces = grid(40, 20, cell_m=0.01)
    rest = fitting.rest_garment(vertices + PLACE, faces, default_body())
    left = rest.vertices[:, 0] < rest.vertices[:, 0].mean()
    fields = patch_fields(rest, count=24, density=np.where(left, 16.0, 1.0))
    on_left = fields["patch_centre"][:, 0] < rest.vertices[:, 0].mean()
    ratio = np.median(fields["patch_scale"][~on_left]) / np.median(fields["patch_scale"][on_left])
    assert 1.5 < ratio < 2.7  # 16^(1/4) = 2
    assert len(fields["patch_scale"]) == 24


def test_smoothed_normals_forget_bumps_and_keep_the_cylinder():
    vertices, faces = tube(64, 20, radius_m=0.1, height_m=0.3)
    rest, clean = measured(vertices, faces)
    bumps = 0.3 * (-1.0) ** (np.arange(len(vertices)) // 3)
    noisy = rest.normals + bumps[:, None] * [0.0, 1.0, 0.0]
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    smooth = density.smoothed_normals(noisy, rest.vertices, faces, rest.areas, width_m=0.02)
    assert_allclose(np.linalg.norm(smooth, axis=1), 1.0, rtol=0, atol=1e-12)
    rough, calm = (density.curvature_squared(rest.vertices, faces, n, rest.areas) for n in (noisy, smooth))
    assert np.sqrt(np.median(rough)) > 2.0 * np.sqrt(np.median(clean))
    assert_allclose(np.sqrt(np.median(calm)), 10.0, rtol=0.1, atol=0)
