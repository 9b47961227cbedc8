"""Level sections of cylinders and spheres, whose girths are known."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.geometry.sections import closed_rings, convex_hull, level_section
from tests.drape.cloth import cloth_shapes
from tests.drape.geometry.geometry_shapes import icosphere

AROUND = 48


def polygon_m(radius_m: float) -> float:
    """The perimeter of the polygon that a circle of that radius is here."""
    return 2.0 * AROUND * radius_m * np.sin(np.pi / AROUND)


def test_a_ring_is_as_long_as_its_circle():
    rest, faces = cloth_shapes.round_tube([0.1, 0.25, 0.4], [0.0, 0.3, 0.6], AROUND)
    (ring,) = closed_rings(level_section(faces, rest, 0.31), rest)
    assert_allclose(ring.length_m, 2.0 * np.pi * 0.255, rtol=5e-3)
    assert_allclose(ring.hull.area, ring.length_m, rtol=5e-3)
    assert not closed_rings(level_section(faces, rest, 0.7), rest)
    half = faces[(rest[faces, 2] > 0.0).any(axis=1)]
    assert not closed_rings(level_section(half, rest, 0.31), rest), "an open front"


def test_a_cylinder_is_cut_in_its_polygon_at_any_height(rng):
    rest, faces = cloth_shapes.tube(AROUND, 7, radius_m=0.2, height_m=0.5)
    for y in rng.uniform(0.01, 0.49, 5):
        section = level_section(faces, rest, y)
        (ring,) = closed_rings(section, rest)
        assert_allclose([ring.length_m, ring.hull.area], polygon_m(0.2), rtol=1e-12)
        assert_allclose(section.points(rest)[:, 1], y, rtol=0.0, atol=1e-15)
        assert len(ring.rows) == len(section.face) == 2 * AROUND


def test_a_vertex_in_the_plane_makes_no_gap():
    rest, faces = cloth_shapes.tube(AROUND, 4, radius_m=0.2, height_m=0.5)
    (ring,) = closed_rings(level_section(faces, rest, rest[2 * AROUND, 1]), rest)
    assert_allclose(ring.length_m, polygon_m(0.2), rtol=1e-12)


def test_the_section_of_a_sphere_is_its_circle():
    vertices, faces = icosphere(5)
    (ring,) = closed_rings(level_section(faces, vertices, 0.6), vertices)
    assert_allclose(ring.length_m, 2.0 * np.pi * 0.8, rtol=2e-3)


def test_what_has_no_area_has_no_hull():
    assert convex_hull(np.zeros((2, 2))) is None
    assert convex_hull(np.stack([np.arange(5.0), np.arange(5.0)], axis=1)) is None
    square = convex_hull(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    assert square is not None and square.area == 4.0
