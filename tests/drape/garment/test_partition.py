"""Laws of the partition, and its energy against the geodesic start and against pyacvd."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse.csgraph import connected_components

from drape.errors import MeshError
from drape.garment import partition as partition_module
from drape.garment.partition import partition, patch_count_for, vertex_graph
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.garment.rest_garments import side_by_side
from tests.drape.geometry.geometry_shapes import icosphere
from tests.fixtures.laws import each

PLANE, TUBE = grid(30, 22, cell_m=0.015), tube(36, 20, radius_m=0.15, height_m=0.5)
SHAPES = {"plane": PLANE, "tube": TUBE, "sphere": icosphere(4, radius_m=0.2)}


def piece_count(label, faces):
    """Connected pieces when every edge between clusters is cut."""
    edges = meshes.unique_edges(faces)
    inside = edges[label[edges[:, 0]] == label[edges[:, 1]]]
    shape = (len(label), len(label))
    graph = scipy.sparse.coo_matrix((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=shape)
    return connected_components(graph, directed=False)[0]


def energy(label, vertices, weight):
    """``sum_i w_i |x_i - c(i)|^2``, with c the weighted centroids."""
    mass = np.bincount(label, weight)
    centre = np.stack([np.bincount(label, weight * x) for x in vertices.T], axis=1) / mass[:, None]
    return float(weight @ ((vertices - centre[label]) ** 2).sum(axis=1))


def check_clusters(label, faces, count):
    assert_array_equal(np.unique(label), np.arange(count))
    assert piece_count(label, faces) == count


@each(mesh=SHAPES, count=[1, 2, 7, 30])
def test_clusters_are_connected_and_as_many_as_asked(mesh, count):
    vertices, faces = mesh
    check_clusters(partition(vertices, faces, meshes.vertex_areas(vertices, faces), count, seed=0), faces, count)


def test_as_many_clusters_as_vertices_makes_each_its_own():
    vertices, faces = grid(6, 5)
    label = partition(vertices, faces, meshes.vertex_areas(vertices, faces), len(vertices), seed=0)
    assert_array_equal(np.sort(label), np.arange(len(vertices)))


@settings(max_examples=40)
@given(
    width=st.integers(2, 18),
    height=st.integers(2, 18),
    share=st.floats(0.0, 0.5),
    spread=st.floats(0.0, 4.0),
    seed=st.integers(0, 10**6),
)
def test_clusters_are_connected_under_any_density(width, height, share, spread, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = grid(width, height, cell_m=0.02)
    vertices = vertices + 0.004 * rng.normal(size=vertices.shape)
    weight = meshes.vertex_areas(vertices, faces) * np.exp(spread * rng.normal(size=len(vertices)))
    count = max(1, round(share * len(vertices)))
    check_clusters(partition(vertices, faces, weight, count, seed=seed), faces, count)


def test_heavy_single_vertices_leave_no_cluster_empty():
    # Failed once: an emptied cluster took the only vertex of the heaviest one.
    rng = np.random.default_rng(0)
    for seed in range(40):
        vertices, faces = grid(12, 11, cell_m=0.02)
        weight = meshes.vertex_areas(vertices, faces) * np.exp(4.0 * rng.normal(size=len(vertices)))
        check_clusters(partition(vertices, faces, weight, 51, seed=seed), faces, 51)


def test_torn_clusters_are_mended_however_deep_the_stray_piece():
    # A ribbon one quad wide: between clusters 1 and 2 lies a second piece of cluster 0, 90 vertices long.
    vertices, faces = grid(240, 1)
    label = np.digitize(vertices[:, 0] / 0.01, [119.5, 129.5, 219.5])
    label = np.array([0, 1, 0, 2])[label]
    assert piece_count(label, faces) == 4
    check_clusters(partition_module._connect(label, meshes.unique_edges(faces), 3), faces, 3)


@each(mesh=SHAPES)
def test_energy_falls_below_that_of_the_geodesic_start(mesh, monkeypatch):
    vertices, faces = mesh
    weight = meshes.vertex_areas(vertices, faces)
    for seed in range(3):
        final = energy(partition(vertices, faces, weight, 20, seed=seed), vertices, weight)
        with monkeypatch.context() as patch:
            patch.setattr(partition_module, "MAX_SWEEPS", 0)
            start = energy(partition(vertices, faces, weight, 20, seed=seed), vertices, weight)
        assert final < 0.95 * start


@each(mesh=SHAPES, count=[12, 30])
@pytest.mark.filterwarnings("ignore:.*_connectivity_array.*")
def test_energy_is_that_of_pyacvd(mesh, count):
    import pyacvd  # with VTK, which takes a second in each process that collects tests
    import pyvista

    vertices, faces = mesh
    weight = meshes.vertex_areas(vertices, faces)
    oracle = pyacvd.Clustering(pyvista.PolyData.from_regular_faces(vertices, faces))
    want = energy(oracle.cluster(count), vertices, weight)
    got = [energy(partition(vertices, faces, weight, count, seed=seed), vertices, weight) for seed in range(4)]
    assert np.mean(got) <= 1.05 * want


def test_clusters_are_small_where_the_density_is_high():
    vertices, faces = PLANE
    left = vertices[:, 0] < 0.5 * vertices[:, 0].max()
    weight = meshes.vertex_areas(vertices, faces) * np.where(left, 8.0, 1.0)
    label = partition(vertices, faces, weight, 30, seed=0)
    assert len(np.unique(label[left])) > 1.5 * len(np.unique(label[~left]))


def test_labels_are_the_same_for_the_same_seed_and_differ_for_another():
    vertices, faces = TUBE
    weight = meshes.vertex_areas(vertices, faces)
    first, again, other = (partition(vertices, faces, weight, 15, seed=seed) for seed in (4, 4, 5))
    assert_array_equal(first, again)
    assert (first != other).any()


def test_labels_ignore_rigid_motion_and_a_graph_made_before(rng):
    vertices, faces = TUBE
    weight = meshes.vertex_areas(vertices, faces)
    want = partition(vertices, faces, weight, 15, seed=0)
    given_graph = partition(vertices, faces, weight, 15, seed=0, graph=vertex_graph(vertices, faces))
    assert_array_equal(given_graph, want)
    moved = vertices[:, [2, 0, 1]] * [1.0, -1.0, -1.0]  # a quarter turn and a half turn: exact in floating point
    assert_array_equal(partition(moved, faces, weight, 15, seed=0), want)


def test_every_piece_has_its_own_clusters():
    vertices, faces = side_by_side(grid(10, 10), tube(8, 3), grid(2, 2))
    weight = meshes.vertex_areas(vertices, faces)
    piece = connected_components(vertex_graph(vertices, faces), directed=False)[1]
    for count in (1, 3, 12):
        label = partition(vertices, faces, weight, count, seed=0)
        used = len(np.unique(label))
        assert max(count, 3) <= used <= count + 2
        check_clusters(label, faces, used)
        assert len(np.unique(np.stack([label, piece]), axis=1).T) == used


def test_pieces_share_the_clusters_by_their_mass():
    vertices, faces = side_by_side(grid(20, 20), grid(20, 20))
    piece = (vertices[:, 0] > 0.5).astype(int)
    weight = meshes.vertex_areas(vertices, faces) * np.where(piece, 3.0, 1.0)
    label = partition(vertices, faces, weight, 20, seed=0)
    assert [len(np.unique(label[piece == k])) for k in (0, 1)] == [5, 15]


def test_heavy_piece_of_few_vertices_hands_its_share_to_the_others():
    vertices, faces = side_by_side(grid(1, 1), grid(10, 10))
    weight = np.where(vertices[:, 0] < 0.5, 1e3, 1.0)
    check_clusters(partition(vertices, faces, weight, 20, seed=0), faces, 20)


def test_coincident_vertices_can_be_told_apart():
    vertices, faces = grid(4, 4)
    label = partition(np.zeros_like(vertices), faces, np.ones(len(vertices)), 5, seed=0)
    assert len(np.unique(label)) == 5


@each(count=[0, -1, 31])
def test_impossible_count_is_refused(count):
    vertices, faces = grid(5, 4)
    with pytest.raises(MeshError, match=f"between 1 and the vertex count 30, got {count}"):
        partition(vertices, faces, np.ones(30), count, seed=0)


def test_patch_count_follows_the_area_between_its_limits():
    assert [patch_count_for(area) for area in (0.1, 0.8, 1.6, 3.2, 9.0)] == [100, 100, 200, 400, 400]


def test_graph_is_symmetric_and_holds_edges_and_diagonals_by_their_length():
    vertices, faces = grid(3, 2, cell_m=0.1)
    graph = vertex_graph(vertices, faces)
    assert abs(graph - graph.T).max() == 0.0
    low, high = scipy.sparse.triu(graph).nonzero()
    assert_allclose(
        np.asarray(graph[low, high]).ravel(),
        np.linalg.norm(vertices[low] - vertices[high], axis=1),
        rtol=1e-12,
        atol=0.0,
    )
    edges = {tuple(edge) for edge in meshes.unique_edges(faces).tolist()}
    assert edges < set(zip(low.tolist(), high.tolist(), strict=True))
    # A grid of quads: both diagonals of each, and one more across every inner side of a row or column.
    assert graph.nnz == 2 * (len(edges) + 6 + (3 * 1 + 2 * 2))


def test_diagonals_take_out_the_bias_of_one_way_triangles():
    vertices, faces = grid(20, 20)
    graph = vertex_graph(vertices, faces)
    corners = [20 * 21, 20]  # the two that no mesh diagonal joins
    distance = scipy.sparse.csgraph.dijkstra(graph, indices=corners[0])[corners[1]]
    assert_allclose(distance, np.linalg.norm(vertices[corners[0]] - vertices[corners[1]]), rtol=1e-9, atol=0.0)
