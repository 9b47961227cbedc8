"""The coarse mesh: nodes, triangles, weights, and the matrix of the weight."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.distance import pdist

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
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
        entries = slice(mesh.weight_start[v], mesh.weight_start[v + 1])
        assert_allclose(mesh.weight[entries].sum(), 1.0, atol=1e-12)
        carried = mesh.weight[entries] @ way[mesh.vertex[mesh.weight_node[entries]]]
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
