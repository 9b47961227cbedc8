"""The quality numbers on drapes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.cloth import metrics
from drape.errors import MeshError
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, random_rotation
from tests.drape.geometry.geometry_shapes import icosphere


def test_uniform_scaling_gives_its_strain():
    rest, faces = grid()
    frames = np.stack([rest, 1.1 * rest, 0.9 * rest])
    assert_allclose(metrics.edge_strain_pct(frames, rest, faces), [0.0, 10.0, 10.0], rtol=1e-12, atol=1e-10)
    assert_allclose(metrics.area_strain_pct(frames, rest, faces), [0.0, 21.0, 19.0], rtol=1e-12, atol=1e-10)


def test_strain_does_not_see_rigid_motion(rng):
    rest, faces = grid()
    moved = rest @ random_rotation(rng).T + 1.0
    assert_allclose(metrics.edge_strain_pct(moved, rest, faces), 0.0, rtol=0.0, atol=1e-10)
    assert_allclose(metrics.area_strain_pct(moved, rest, faces), 0.0, rtol=0.0, atol=1e-10)


def test_colliding_shares_count_the_points_inside_a_sphere(rng):
    vertices, faces = icosphere(3)
    directions = rng.normal(size=(2, 100, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    radius = np.ones((2, 100, 1)) * 1.1
    radius[0, :30], radius[1, :5] = 0.9, 0.9
    cloth, bodies = radius * directions, np.stack([vertices, vertices])
    by_vertex = metrics.colliding_vertex_pct(cloth, bodies, meshes.vertex_normals(bodies, faces))
    assert_allclose(by_vertex, [30.0, 5.0], rtol=1e-12, atol=0.0)
    assert_allclose(metrics.colliding_triangle_pct(cloth, bodies, faces), [30.0, 5.0], rtol=1e-12, atol=0.0)


def test_the_triangle_rule_is_right_where_the_vertex_rule_is_not():
    vertices, faces = icosphere(0)  # an octahedron: |x| + |y| + |z| = 1
    outside = np.array([[[0.4, 0.4, 0.4]]])  # yet below the tangent planes of its vertices
    normals = meshes.vertex_normals(vertices, faces)[None]
    assert metrics.colliding_vertex_pct(outside, vertices[None], normals) == [100.0]
    assert metrics.colliding_triangle_pct(outside, vertices[None], faces) == [0.0]


def test_gain_is_zero_for_skinning_one_for_physics_and_undefined_without_room():
    assert metrics.gain(2.0, 2.0, 0.5) == 0.0
    assert metrics.gain(2.0, 0.5, 0.5) == 1.0
    assert_allclose(metrics.gain(2.0, 0.8, 0.5), 0.8, rtol=1e-12, atol=0.0)
    assert metrics.gain(2.0, 3.0, 0.5) < 0.0
    assert np.isnan(metrics.gain(0.5, 0.4, 0.5))


@pytest.mark.parametrize("metric", [metrics.edge_strain_pct, metrics.area_strain_pct])
@pytest.mark.parametrize(("rest", "faces"), [(np.zeros((3, 3)), [[0, 1, 2]]), (np.eye(3), np.zeros((0, 3), dtype=int))])
def test_a_rest_mesh_without_size_is_refused(metric, rest, faces):
    with pytest.raises(MeshError, match="rest"):
        metric(np.eye(3), rest, np.asarray(faces))
