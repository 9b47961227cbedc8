"""The coarse mesh: nodes, triangles, weights, and the matrix of the weight."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.distance import pdist

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.engine.library import LANES
from drape.live.swing_mesh import SPACING_M, along_cloth, swing_mesh
from tests.drape.live.swing_setup import EDGE_M, LENGTH_M, WIDTH_M, hanging, strip
from tests.reference.swing import pull_matrix, triangles


def test_nodes_are_spread_over_the_cloth():
    rest, mesh = hanging()
    places = rest[mesh.vertex]
    assert pdist(places).min() > 0.98 * SPACING_M
    assert np.linalg.norm(rest[:, None] - places[None], axis=-1).min(axis=1).max() < SPACING_M
    assert 0.7 < triangles(mesh)[1][:, 4].sum() / (LENGTH_M * WIDTH_M) < 1.0
    assert_allclose(mesh.mass_kg.sum(), 0.2 * LENGTH_M * WIDTH_M, rtol=1e-9)
    assert not (rest[mesh.vertex[mesh.order], 1] > -1e-9).any(), "held ones do not move"
    assert (np.diff(rest[mesh.vertex[mesh.order], 1]) < 2.0 * SPACING_M).all(), "from the edge down"


def test_distances_go_over_diagonals():
    rest, faces = strip(4.0 * EDGE_M)
    graph = along_cloth(ClothMesh.from_rest(rest, faces)).toarray()
    across = round(WIDTH_M / EDGE_M) + 1
    assert_allclose(graph[0, across + 1], np.hypot(EDGE_M, EDGE_M), rtol=1e-12)
    assert_allclose(graph[0, 1], EDGE_M, rtol=1e-12)
    assert_allclose(graph, graph.T)


def test_weights_carry_what_is_linear():
    rest, mesh = hanging()
    way = rest @ np.array([[0.3, 0.0, 0.1], [0.2, 0.4, 0.0], [0.0, 0.0, 0.0]]) + 0.05
    for v in range(0, len(rest), 7):
        assert_allclose(mesh.weight[v].sum(), 1.0, atol=1e-12)
        carried = mesh.weight[v] @ way[mesh.vertex[mesh.weight_node[v]]]
        assert_allclose(carried, way[v], atol=0.01)  # but for what keeps the fit regular


def test_the_weight_pulls_like_a_string():
    """Of a hanging string, u K u = integral of T (du/ds)^2, T the weight below: for u = s, half the weight times L."""
    rest, mesh = hanging()
    matrix = pull_matrix(mesh)
    assert_allclose(matrix, matrix.T, atol=1e-12)
    assert_allclose(matrix.sum(axis=1), 0.0, atol=1e-9)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9
    s = -rest[mesh.vertex, 1]
    assert_allclose(s @ matrix @ s, 0.5 * 0.2 * 9.81 * WIDTH_M * LENGTH_M**2, rtol=0.1)


def test_what_is_held_everywhere_does_not_swing():
    rest, faces = strip()
    assert swing_mesh(ClothMesh.from_rest(rest, faces), Material(), rest, np.ones(len(rest), bool)) is None


def test_blocks_keep_the_order_of_nodes():
    """Of two nodes of one triangle that which comes first moves in an earlier block."""
    _, mesh = hanging()
    rows, rank = mesh.rows, {int(i): n for n, i in enumerate(mesh.order)}
    assert sorted(rank) == sorted(set(rows.node[: LANES * rows.moving].tolist())), "what moves comes first"
    assert_array_equal(rows.node[rows.place], np.arange(len(mesh.vertex)))
    for i in range(len(mesh.vertex)):
        near = {int(j) for j in np.unique(mesh.other[mesh.start[i] : mesh.start[i + 1]])}
        earlier = {j for j in near & rank.keys() if rank[j] < rank.get(i, -1)}
        assert all(rows.place[j] // LANES < rows.place[i] // LANES for j in earlier)
        block, lane = divmod(int(rows.place[i]), LANES)
        there = slice(rows.start[block], rows.start[block + 1])
        other = rows.other.reshape(-1, 2, LANES)[there, :, lane]
        slope = rows.slope.reshape(-1, 5, LANES)[there, :, lane]
        count = mesh.start[i + 1] - mesh.start[i]
        assert_array_equal(rows.node[other[:count]], mesh.other[mesh.start[i] : mesh.start[i + 1]])
        assert_array_equal(slope[:count], mesh.slope[mesh.start[i] : mesh.start[i + 1]])
        assert not slope[count:].any() and (other[count:] == rows.place[i]).all()
