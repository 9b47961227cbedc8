"""Bindings of a rest garment to the body: weights near the skin, far from it, and mirrored."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import KDTree

from drape.body.skeleton import JOINT_NAMES
from drape.garment import skin
from drape.geometry.closest import closest_point, nearest_vertices
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.garment.rest_garments import barrel
from tests.fixtures.garments import default_body

EXACT = 1e-12
TWIN = {"left": "right", "right": "left"}
MIRRORED = [JOINT_NAMES.index("_".join(TWIN.get(part, part) for part in name.split("_"))) for name in JOINT_NAMES]
LEFT = [JOINT_NAMES.index(name) for name in JOINT_NAMES if name.startswith("left")]
RIGHT = [MIRRORED[joint] for joint in LEFT]
# Finely modelled parts, where 12 mm between samples is coarse and no garment lies.
BARE_PARTS = ("head", "neck", "ankle", "foot", "wrist", "hand")


def clothed_points(rng, count, gap_m):
    """Points ``gap_m`` outside random places of trunk, arms and legs."""
    body = default_body()
    bare = [any(part in name for part in BARE_PARTS) for name in JOINT_NAMES]
    faces = body.faces[~np.array(bare)[body.weights.argmax(axis=1)][body.faces].any(axis=1)]
    corners = body.v_template[faces[rng.integers(0, len(faces), count)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.einsum("nk,nka->na", rng.dirichlet(np.ones(3), count), corners) + gap_m * normal


def test_weights_are_a_partition_of_unity():
    binding = barrel().binding
    assert (binding.weights >= 0.0).all()
    assert_allclose(binding.weights.sum(axis=1), 1.0, rtol=0.0, atol=EXACT)
    assert binding.shapedirs.shape == (len(barrel().vertices), 3, default_body().shape_count)


def test_next_to_the_skin_the_nearest_triangle_says_weights_and_shape_movement(rng):
    body, points = default_body(), clothed_points(rng, 600, 0.002)
    kernel = skin.body_kernel(points, body)
    near = closest_point(points, body.v_template, body.faces)
    weights, shapes = body.weights, body.shapedirs.reshape(body.vertex_count, -1)
    want = [np.einsum("nk,nkj->nj", near.barycentric, field[body.faces[near.face]]) for field in (weights, shapes)]
    error = np.abs(kernel @ weights - want[0]).max(axis=1)
    assert error.mean() < 0.015
    assert np.quantile(error, 0.95) < 0.06
    error, size = (field.reshape(600, 3, -1) for field in (kernel @ shapes - want[1], want[1]))
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.05 * np.sqrt((size**2).sum(axis=1).mean())


@pytest.mark.parametrize("height", [-0.3, -0.5, -0.7])
def test_loose_point_between_the_legs_hangs_on_both(height):
    body = default_body()
    (weights,) = skin.body_kernel(np.array([[0.0, height, 0.0]]), body) @ body.weights
    assert_allclose([weights[LEFT].sum(), weights[RIGHT].sum()], 0.5, rtol=0.0, atol=0.01)
    (beside,) = skin.body_kernel(np.array([[0.15, height, 0.0]]), body) @ body.weights
    assert beside[LEFT].sum() > 0.95


def test_kernel_spreads_with_the_distance_from_the_body():
    body = default_body()
    spread = []
    for z in (0.2, 0.3, 0.5):
        row = skin.body_kernel(np.array([[0.0, 0.3, z]]), body)
        assert_allclose(row.sum(), 1.0, rtol=0.0, atol=EXACT)
        points = body.v_template[row.indices]
        centre = row.data @ points
        spread.append(np.sqrt(row.data @ ((points - centre) ** 2).sum(axis=1)))
    assert spread[0] < spread[1] < spread[2]


def test_symmetric_garment_hangs_symmetrically():
    body, rest = default_body(), barrel()
    twin = nearest_vertices(rest.vertices * [-1.0, 1.0, 1.0], rest.vertices)[1]
    # Triangles and their mirror images together: smoothing sees a symmetric net of edges.
    binding = skin.bind_to_body(rest.vertices, np.concatenate([rest.faces, twin[rest.faces]]), body)
    assert_allclose(binding.weights[twin][:, MIRRORED], binding.weights, rtol=0.0, atol=0.01)
    mirrored = binding.shapedirs[twin] * np.array([-1.0, 1.0, 1.0])[:, None]
    assert_allclose(mirrored, binding.shapedirs, rtol=0.0, atol=0.05 * np.abs(binding.shapedirs).max())


def test_body_samples_are_spread_evenly():
    body = default_body()
    points = skin.thinned_vertices(body)
    assert len(points) < body.vertex_count
    assert_array_equal(points, np.unique(points))
    cell = np.floor(body.v_template[points] / skin.SAMPLE_SPACING_M).astype(int)
    assert len(np.unique(cell, axis=0)) == len(points)
    reach = KDTree(body.v_template[points]).query(body.v_template)[0]
    assert reach.max() <= np.sqrt(3.0) * skin.SAMPLE_SPACING_M


def test_smoothing_keeps_constants_and_lone_vertices_and_shrinks_waves():
    vertices, faces = grid(10, 10)
    count = len(vertices) + 1
    smooth = skin.smoothing_matrix(faces, count)
    assert_allclose(smooth @ np.ones(count), 1.0, rtol=0.0, atol=EXACT)
    assert (smooth.data >= 0.0).all()
    lone = np.eye(count)[-1]
    assert_array_equal(smooth @ lone, lone)
    wave = np.append(np.cos(np.pi * vertices[:, 0] / 0.01), 0.0)
    assert np.abs(smooth @ wave).max() < 0.8 * np.abs(wave).max()


def test_passes_smooth_the_weights_over_the_mesh(monkeypatch):
    rest = barrel()
    monkeypatch.setattr(skin, "SMOOTHING_PASSES", 0)
    sharp = skin.bind_to_body(rest.vertices, rest.faces, default_body())
    edges = np.sort(rest.faces[:, :2], axis=1)

    def roughness(binding):
        return np.abs(binding.weights[edges[:, 0]] - binding.weights[edges[:, 1]]).sum(axis=1).mean()

    assert roughness(rest.binding) < roughness(sharp)


def test_weights_too_small_to_matter_are_dropped():
    weights = barrel().binding.weights
    assert weights[weights > 0.0].min() > 1e-3


def test_garment_follows_a_body_that_is_shifted():
    body, rest = default_body(), barrel()
    # Whole cells, so that the thinning picks the same vertices.
    shift = skin.SAMPLE_SPACING_M * np.array([0.0, 64.0, 0.0])
    moved = dataclasses.replace(body, v_template=body.v_template + shift)
    got = skin.bind_to_body(rest.vertices + shift, rest.faces, moved)
    assert_allclose(got.weights, rest.binding.weights, rtol=0.0, atol=1e-3)
