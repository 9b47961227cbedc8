"""The quality numbers on drapes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.errors import InputError, MeshError
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


def test_mean_height_is_that_of_the_centre_of_mass():
    rest, faces = grid(4, 3, cell_m=0.02)
    cloth = ClothMesh.from_rest(rest, faces)
    assert_allclose(metrics.mean_height(rest[None], cloth), [0.03], rtol=1e-12, atol=0.0)


def test_static_parts_take_gravity_from_the_given_height_and_contact_from_the_posed_body():
    body, body_faces = icosphere(4, radius_m=0.1)
    rest, faces = grid(3, 3, cell_m=0.01)
    cloth = ClothMesh.from_rest(rest, faces)
    # Flat above the pole, its middle in the contact gap, and once more far away and 0.5 m higher.
    near = (rest - rest.mean(axis=0))[:, [1, 2, 0]] + [0.0, 0.102, 0.0]
    frames = np.stack([near, near + np.array([0.0, 0.5, 0.0])])
    contact, bodies = BodyContact(body_faces, len(body)), np.stack([body, body])
    parts = metrics.static_parts(frames, cloth, material(), contact, bodies, height_m=np.array([0.102, 0.102]))
    weight_n = 9.81 * 0.2 * 0.03 * 0.03
    assert_allclose(parts["gravity"], [0.0, 0.5 * weight_n], rtol=1e-9, atol=1e-15)
    assert_allclose(parts["membrane"], energies.membrane(frames, cloth, material()), rtol=1e-12, atol=0.0)
    assert parts["contact"][0] > 0.0 == parts["contact"][1]


def test_the_third_difference_sees_jerk_and_nothing_slower(rng):
    t = np.arange(8.0)[:, None, None]
    start, velocity, acceleration, jerk = rng.normal(size=(4, 5, 3))
    smooth = start + velocity * t + 0.5 * acceleration * t**2
    assert_allclose(metrics.third_difference_square(smooth), 0.0, rtol=0.0, atol=1e-24)
    # The third difference of t^3 / 6 is 1.
    expected = (jerk**2).sum(axis=-1).mean()
    assert_allclose(metrics.third_difference_square(smooth + jerk * t**3 / 6.0), expected, rtol=1e-9, atol=0.0)


def test_a_clip_too_short_for_a_third_difference_is_refused():
    with pytest.raises(InputError, match="4 frames"):
        metrics.third_difference_square(np.zeros((3, 2, 3)))


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
