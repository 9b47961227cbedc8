"""Laws of the charts: blend weights, their continuity, patch centres and frames."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import charts
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.partition import partition, vertex_graph
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.garment.rest_garments import barrel, side_by_side
from tests.fixtures.laws import each

EXACT = 1e-12
WIDTH, HEIGHT = 20, 15  # cells of the coarsest plane


def dense_weights(blend, count):
    """Blend weights (N, K) with a column for every patch."""
    dense = np.zeros((len(blend.patch), count))
    np.add.at(dense, (np.arange(len(dense))[:, None], blend.patch), blend.weight)
    return dense


def plane(refinement=1):
    return grid(WIDTH * refinement, HEIGHT * refinement, cell_m=0.02 / refinement)


def plane_seeds(count):
    """Places of the patch seeds of a partition of the coarsest plane."""
    vertices, faces = plane()
    area = meshes.vertex_areas(vertices, faces)
    label = partition(vertices, faces, area, count, seed=0)
    return vertices[charts.cluster_centres(label, vertices, area)[1]]


@pytest.fixture
def clusters():
    """Labels, vertices, normals, areas and bone directions of the barrel."""
    rest = barrel()
    label = partition(rest.vertices, rest.faces, rest.areas, 24, seed=0)
    bone = np.random.default_rng(1).normal(size=(24, 3))
    return label, rest.vertices, rest.normals, rest.areas, bone


def check_no_patch_twice(blend):
    for patch, weight in zip(blend.patch, blend.weight, strict=True):
        used = patch[weight > 0.0]
        assert len(np.unique(used)) == len(used)


def blended(count, *, spacing_m=0.1, refinement=1):
    """Blend of ``count`` charts over the plane, its weights by patch (N, K), the rows of its seeds and its faces."""
    vertices, faces = plane(refinement)
    seeds = nearest_vertices(plane_seeds(count), vertices)[1]
    blend = charts.blend_charts(vertex_graph(vertices, faces), seeds, spacing_m=spacing_m)
    return blend, dense_weights(blend, count), seeds, faces


def test_rows_of_patches_are_all_rows_each_once_and_ascending(rng):
    patch = rng.integers(-1, 7, 200)
    rows = charts.rows_of_patches(patch, 8)
    assert_array_equal(np.sort(np.concatenate(rows)), np.flatnonzero(patch >= 0))
    for k, mine in enumerate(rows):
        assert_array_equal(mine, np.flatnonzero(patch == k))


@each(count=[1, 2, 3, 4, 5, 12])
def test_blend_weights_are_a_partition_of_unity_and_no_patch_is_blended_twice(count):
    blend, _, _, _ = blended(count)
    assert blend.patch.shape == blend.weight.shape == (len(plane()[0]), CHARTS_PER_VERTEX)
    assert blend.patch.dtype == np.int32
    assert (blend.weight >= 0.0).all()
    assert_allclose(blend.weight.sum(axis=1), 1.0, rtol=0.0, atol=EXACT)
    assert blend.patch.min() >= 0 and blend.patch.max() < count
    check_no_patch_twice(blend)


def test_patches_come_nearest_first_and_nearer_ones_weigh_more():
    blend, _, seeds, _ = blended(12)
    assert (np.diff(blend.weight, axis=1) <= EXACT).all()
    assert_array_equal(blend.patch[seeds, 0], np.arange(len(seeds)))


@each(spacing_m=[1e-3, 0.02, 0.1])
def test_search_radius_does_not_change_the_blend(spacing_m):
    assert_allclose(blended(12, spacing_m=spacing_m)[1], blended(12, spacing_m=10.0)[1], rtol=0.0, atol=EXACT)


@each(count=[2, 4, 8, 20])
def test_blend_weights_are_continuous_over_the_surface(count):
    steps = []
    for refinement in (2, 4, 8):
        _, dense, _, faces = blended(count, refinement=refinement)
        edges = meshes.unique_edges(faces)
        steps.append(np.abs(dense[edges[:, 0]] - dense[edges[:, 1]]).max(axis=1))
    largest = [step.max() for step in steps]
    # A jump would keep its height under refinement; the largest step falls with the edge.
    assert largest[2] < 0.7 * largest[1]
    assert largest[2] < 0.5 * largest[0]
    assert_allclose([steps[k].mean() / steps[k + 1].mean() for k in (0, 1)], 2.0, rtol=0.1, atol=0.0)


def test_pieces_of_few_patches_blend_only_their_own():
    vertices, faces = side_by_side(plane(), grid(3, 3, cell_m=0.02), grid(4, 2, cell_m=0.02))
    piece = np.round(vertices[:, 0] - 0.2).astype(int).clip(0)
    seeds = np.concatenate(
        [
            nearest_vertices(plane_seeds(8), vertices)[1],
            [np.flatnonzero(piece == 1)[0]],
            np.flatnonzero(piece == 2)[[0, -1]],
        ]
    )
    blend = charts.blend_charts(vertex_graph(vertices, faces), seeds, spacing_m=0.1)
    check_no_patch_twice(blend)
    dense = dense_weights(blend, len(seeds))
    assert_array_equal(dense[piece[seeds][None] != piece[:, None]], 0.0)
    assert_allclose(dense[piece == 1, 8], 1.0, rtol=0.0, atol=EXACT)
    assert_allclose(dense[piece == 2][:, [9, 10]].sum(axis=1), 1.0, rtol=0.0, atol=EXACT)
    assert np.ptp(dense[piece == 2, 9]) > 0.1


def test_centres_are_centroids_and_seeds_their_nearest_members(clusters):
    label, vertices, _, area, _ = clusters
    centre, seed = charts.cluster_centres(label, vertices, area)
    for k in range(24):
        members = np.flatnonzero(label == k)
        assert_allclose(centre[k], np.average(vertices[members], axis=0, weights=area[members]), rtol=0.0, atol=EXACT)
        distance = np.linalg.norm(vertices[members] - centre[k], axis=1)
        assert seed[k] in members
        assert_allclose(np.linalg.norm(vertices[seed[k]] - centre[k]), distance.min(), rtol=0.0, atol=EXACT)


def test_frames_are_rotations_with_the_mean_normal_third_and_the_first_axis_along_the_bone(clusters):
    label, _, normals, area, bone = clusters
    frames = charts.patch_frames(label, normals, area, bone)
    assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.tile(np.eye(3), (24, 1, 1)), rtol=0.0, atol=EXACT)
    assert_allclose(np.linalg.det(frames), 1.0, rtol=0.0, atol=EXACT)
    mean = np.stack([np.bincount(label, area * n) for n in normals.T], axis=1)
    assert ((frames[:, :, 2] * mean).sum(axis=1) > 0.0).all()
    assert_allclose(np.cross(frames[:, :, 2], mean), 0.0, rtol=0.0, atol=EXACT)
    assert ((frames[:, :, 0] * bone).sum(axis=1) > 0.0).all()
    assert_allclose((frames[:, :, 1] * bone).sum(axis=1), 0.0, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize(
    ("normal", "bone"),
    [
        ([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]),
        ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),  # the tip of a shoe
        ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),  # normals that cancel
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    ],
)
def test_frames_are_rotations_where_normal_and_bone_do_not_say_them(normal, bone):
    label, area = np.zeros(4, dtype=int), np.ones(4)
    (frame,) = charts.patch_frames(label, np.tile(normal, (4, 1)), area, np.array([bone]))
    assert_allclose(frame @ frame.T, np.eye(3), rtol=0.0, atol=EXACT)
    assert_allclose(np.linalg.det(frame), 1.0, rtol=0.0, atol=EXACT)
    if any(normal):
        assert_allclose(frame[:, 2], normal, rtol=0.0, atol=EXACT)
