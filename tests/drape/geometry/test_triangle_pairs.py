"""Near pairs of vertices, edges and triangles: none is missed, and their distances are the least."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.geometry import meshes
from drape.geometry.triangle_pairs import pairs_within
from tests.drape.cloth.cloth_shapes import grid


def crumpled(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sheet pressed to a fifth and rough, its triangles and edges."""
    rest, faces = grid(7, 5, cell_m=0.01)
    return rest * [0.2, 1.0, 1.0] + 0.003 * rng.normal(size=rest.shape), faces, meshes.unique_edges(faces)


def nearest_of_all(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> float:
    """The least distance of places on ``first`` (n, 3) and ``second`` (m, 3), by rows of ``share`` of both corners."""
    return np.linalg.norm(share[:, : len(first)] @ first - share[:, len(first) :] @ second, axis=1).min()


def test_distances_are_the_least_of_many_places(rng):
    x, faces, edges = crumpled(rng)
    pairs, weights, way = pairs_within(x, faces, edges, 0.009)
    far = np.linalg.norm(way, axis=1)
    assert_allclose(np.einsum("nc,nci->ni", weights, x[pairs.corner]), way, rtol=0, atol=1e-15)
    part = np.linspace(0.0, 1.0, 41)
    t, u = (a.ravel() for a in np.meshgrid(part, part))
    on_triangle = np.stack([np.ones_like(t), 1.0 - t, t * (1.0 - u), t * u], axis=1)
    on_edges = np.stack([1.0 - t, t, 1.0 - u, u], axis=1)
    for n in rng.choice(len(far), 150, replace=False):
        corner, triangle = x[pairs.corner[n]], n < pairs.triangles
        split = 1 if triangle else 2
        found = nearest_of_all(corner[:split], corner[split:], on_triangle if triangle else on_edges)
        assert far[n] <= found + 1e-12 and found < far[n] + 5e-4


def test_all_pairs_that_are_near_and_share_no_corner_are_found(rng):
    x, faces, edges = crumpled(rng)
    (_, _, near), (everything, _, ways) = (pairs_within(x, faces, edges, reach_m) for reach_m in (0.004, 10.0))
    far, all_far = np.linalg.norm(near, axis=1), np.linalg.norm(ways, axis=1)
    apart_edges = [(e, f) for e in range(len(edges)) for f in range(e) if not set(edges[e]) & set(edges[f])]
    assert everything.triangles == len(x) * len(faces) - faces.size
    assert len(everything.corner) - everything.triangles == len(apart_edges)
    assert_allclose(np.sort(far), np.sort(all_far[all_far < 0.004]))
    assert len(far) > 50


def test_parallel_edges_touch_in_the_middle():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0.1, 0], [2, 0.1, 0]])
    _, weights, way = pairs_within(x, np.zeros((0, 3), int), np.array([[0, 1], [2, 3]]), 0.2)
    assert_allclose(weights, [[0.5, 0.5, -0.5, -0.5]])
    assert_allclose(way, [[0.0, -0.1, 0.0]], atol=1e-15)
