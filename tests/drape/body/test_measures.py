"""Measures: closed forms of cylinder and sphere, laws of scale and of symmetry, landmarks of the shipped body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import body_from_arrays
from drape.body.measures import DENSITY_KG_M3, Measures, enclosed_volume, landmarks, measures, section_girth
from drape.body.model import BodyModel
from drape.errors import BodyError
from drape.geometry import meshes
from tests.drape.body.body_files import smpl_arrays
from tests.drape.cloth import cloth_shapes
from tests.drape.geometry.geometry_shapes import box, icosphere


def test_the_girth_of_a_cylinder_is_that_of_its_polygon():
    around, radius_m = 64, 0.15
    vertices, faces = cloth_shapes.tube(around, 6, radius_m=radius_m, height_m=0.4)
    girth = section_girth(vertices, meshes.unique_edges(faces), 0.17)
    assert_allclose(girth, 2.0 * around * radius_m * np.sin(np.pi / around), rtol=1e-12)
    # sin x = x - x^3 / 6: the polygon is shorter than the circle by that.
    assert_allclose(girth, 2.0 * np.pi * radius_m, rtol=1.01 * (np.pi / around) ** 2 / 6.0)


def test_a_tape_does_not_enter_hollows():
    around, radius_m = 64, 0.15
    vertices, faces = cloth_shapes.tube(around, 6, radius_m=radius_m, height_m=0.4)
    vertices[1::2, [0, 2]] *= 0.5  # every other column, so that the hull has half as many corners
    girth = section_girth(vertices, meshes.unique_edges(faces), 0.17)
    assert_allclose(girth, around * radius_m * np.sin(2.0 * np.pi / around), rtol=1e-12)


def test_a_level_without_skin_is_refused():
    vertices, faces = cloth_shapes.tube()
    with pytest.raises(BodyError, match=r"body section: expected skin at the height 2\.000 m, got none"):
        section_girth(vertices, meshes.unique_edges(faces), 2.0)


def test_volumes_are_those_of_a_box_and_a_ball():
    vertices, faces = box((0.1, 0.2, 0.3))
    assert_allclose(enclosed_volume(vertices + np.array([3.0, -1.0, 2.0]), faces), 8.0 * 0.1 * 0.2 * 0.3, rtol=1e-12)
    vertices, faces = icosphere(5, radius_m=0.5)
    assert_allclose(enclosed_volume(vertices, faces), 4.0 / 3.0 * np.pi * 0.5**3, rtol=2e-3)


def test_the_standard_body_measures_as_its_landmarks_say(body: BodyModel):
    found, place, skin = measures(body), landmarks(body), body.v_template
    assert_allclose(found.height_m, np.ptp(skin[:, 1]), rtol=1e-12)
    assert skin[place.chest, 2] > 0.1 and skin[place.seat, 2] < -0.08, "in front, and behind"
    assert abs(skin[place.crotch, 0]) < 0.005
    assert_allclose(skin[place.shoulders[0], 0], -skin[place.shoulders[1], 0], atol=1e-3)
    levels = place.levels(skin)
    assert levels.hip_m < levels.waist_m < levels.chest_m
    around = [section_girth(skin, place.trunk, y) for y in np.linspace(levels.hip_m, levels.chest_m, 40)]
    assert found.waist_m < min(around) + 1e-3, "the narrowest"
    assert found.waist_m < found.chest_m < found.hip_m < 0.6 * found.height_m
    assert 0.44 < found.inseam_m / found.height_m < 0.5
    assert_allclose(found.weight_kg, DENSITY_KG_M3 * enclosed_volume(skin, body.faces), rtol=1e-12)
    assert measures(body, np.zeros(body.shape_count)) == found


def test_lengths_grow_with_the_body_and_weight_with_its_cube(body: BodyModel, rng):
    betas, scale = rng.normal(size=10), 1.3
    larger = replace(body, v_template=scale * body.v_template, shapedirs=scale * body.shapedirs)
    small, large = np.array(measures(body, betas)), np.array(measures(larger, betas))
    assert_allclose(large, small * ([scale] * (len(Measures._fields) - 1) + [scale**3]), rtol=1e-9)


def test_measures_do_not_depend_on_where_the_body_stands(body: BodyModel):
    moved = replace(body, v_template=body.v_template + np.array([0.7, -2.0, 0.3]))
    # Rows of the regressor, float32 in the file, sum to one to 1e-7: joints move by as much less.
    assert_allclose(measures(moved), measures(body), rtol=1e-6)


def test_measures_change_smoothly_with_the_shape(body: BodyModel, rng):
    """Second differences vanish as the square of the step, so Gauss-Newton may trust slopes."""
    betas, way = rng.normal(size=10), rng.normal(size=10) / np.sqrt(10.0)
    line = np.array([measures(body, betas + t * way) for t in np.linspace(-0.5, 0.5, 21)])
    slopes = np.diff(line, axis=0)
    assert (np.abs(np.diff(slopes, axis=0))[:, :-1] < 5e-4).all(), "a jump would be a millimetre and more"


def test_a_mesh_without_landmarks_is_refused(rng):
    with pytest.raises(BodyError, match="body chest: expected a vertex there, got none"):
        landmarks(no_trunk(rng))


def no_trunk(rng: np.random.Generator) -> BodyModel:
    """A random body whose bones of the arms carry all its skin."""
    arrays = smpl_arrays(rng)
    arrays["weights"] = np.zeros_like(arrays["weights"])
    arrays["weights"][:, 18] = 1.0
    return body_from_arrays(arrays, name="small", digest="")
