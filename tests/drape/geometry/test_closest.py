"""Nearest points and signed distances against a sphere, a box and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import MeshError
from drape.geometry import closest
from tests.drape.geometry.geometry_shapes import box, box_distance, icosphere


def test_signed_distance_to_a_box_is_exact(rng):
    half = (0.1, 0.2, 0.3)
    vertices, faces = box(half)
    points = rng.uniform(-0.5, 0.5, size=(2000, 3))
    expected = box_distance(points, half)
    assert (expected < 0.0).any()
    assert_allclose(closest.signed_distance(points, vertices, faces), expected, rtol=1e-10, atol=1e-12)


def test_signed_distance_to_a_sphere_converges_with_the_square_of_the_edge(rng):
    points = rng.normal(size=(300, 3))
    exact = np.linalg.norm(points, axis=1) - 1.0
    errors = [np.abs(closest.signed_distance(points, *icosphere(level)) - exact).max() for level in (2, 3, 4)]
    assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.15, atol=0.0)


def test_closest_point_agrees_with_its_parts(rng):
    vertices, faces = icosphere(2)
    points = rng.normal(size=(500, 3))
    found = closest.closest_point(points, vertices, faces)
    rebuilt = (found.barycentric[..., None] * vertices[faces[found.face]]).sum(axis=1)
    assert_allclose(rebuilt, found.point, rtol=0.0, atol=1e-12)
    assert_allclose(np.linalg.norm(points - found.point, axis=1), found.distance, rtol=1e-12, atol=1e-15)
    assert_allclose(found.distance, np.abs(closest.signed_distance(points, vertices, faces)), rtol=1e-12, atol=1e-15)


def test_no_sampled_point_of_the_mesh_is_nearer(rng):
    vertices, faces = icosphere(1)
    points = 1.5 * rng.normal(size=(50, 3))
    weights = rng.dirichlet([1.0, 1.0, 1.0], size=(len(faces), 60))
    samples = (weights[..., None] * vertices[faces][:, None]).sum(2).reshape(-1, 3)
    nearest = np.linalg.norm(points[:, None] - samples, axis=-1).min(axis=1)
    distance = closest.closest_point(points, vertices, faces).distance
    assert (distance <= nearest + 1e-12).all()
    assert_allclose(distance, nearest, rtol=0.0, atol=0.05)


def test_points_on_the_mesh_come_back(rng):
    vertices, faces = icosphere(2)
    weights = rng.dirichlet([1.0, 1.0, 1.0], size=len(faces))
    points = (weights[..., None] * vertices[faces]).sum(axis=1)
    found = closest.closest_point(points, vertices, faces)
    assert_allclose(found.distance, 0.0, rtol=0.0, atol=1e-9)
    assert_allclose(found.point, points, rtol=0.0, atol=1e-9)


def test_a_needle_gives_its_nearest_corner():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]])
    assert_allclose(closest.barycentric(np.array([[0.9, 0.0, 0.0]]), corners), [[0.0, 1.0, 0.0]], rtol=0.0, atol=0.0)


def test_no_points_give_empty_answers():
    vertices, faces = box()
    assert closest.signed_distance(np.zeros((0, 3)), vertices, faces).shape == (0,)
    assert closest.closest_point(np.zeros((0, 3)), vertices, faces).barycentric.shape == (0, 3)


@pytest.mark.parametrize("function", [closest.closest_point, closest.signed_distance])
@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"points": np.zeros((2, 2))}, "points"),
        ({"points": np.full((1, 3), np.nan)}, "points"),
        ({"vertices": np.full((8, 3), np.inf)}, "vertices"),
        ({"faces": np.array([[0, 1, 8]])}, "faces"),
        ({"faces": np.zeros((0, 3), dtype=int)}, "triangle"),
    ],
)
def test_broken_input_is_refused(function, change, match):
    vertices, faces = box()
    arguments = {"points": np.zeros((2, 3)), "vertices": vertices, "faces": faces} | change
    with pytest.raises(MeshError, match=match):
        function(**arguments)


def test_a_closed_mesh_that_is_asked_again_has_the_same_distances_and_signs(rng):
    vertices, faces = icosphere(2)
    vertices = vertices * rng.uniform(0.4, 1.0, size=(len(vertices), 1))  # spikes: edges and corners are nearest
    mesh = closest.ClosedMesh(vertices, faces)
    for points in (rng.normal(size=(3000, 3)), 1.3 * vertices, 0.7 * vertices):
        signed, found = mesh.signed_closest(points)
        assert_allclose(signed, closest.signed_distance(points, vertices, faces), rtol=1e-12, atol=1e-15)
        expected = closest.closest_point(points, vertices, faces)
        assert_allclose(found.point, expected.point, rtol=0.0, atol=1e-12)
        assert_allclose(found.distance, np.abs(signed), rtol=0.0, atol=0.0)
    assert len(mesh.signed_closest(np.zeros((0, 3)))[0]) == 0
