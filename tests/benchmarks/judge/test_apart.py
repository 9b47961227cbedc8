"""Cloth that may not pass through itself: distances, the barrier, and two sheets over one ball."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.judge import apart, physics
from benchmarks.judge.physics import Task
from benchmarks.measure.intersections import intersection_count
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere


def crumpled(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sheet pressed to a fifth and rough, its triangles and edges."""
    rest, faces = grid(7, 5, cell_m=0.01)
    return rest * [0.2, 1.0, 1.0] + 0.003 * rng.normal(size=rest.shape), faces, meshes.unique_edges(faces)


def nearest_of_all(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> float:
    """The least distance of places on ``first`` (n, 3) and ``second`` (m, 3), by rows of ``share`` of both corners."""
    return np.linalg.norm(share[:, : len(first)] @ first - share[:, len(first) :] @ second, axis=1).min()


def test_distances_are_the_least_of_many_places(rng):
    x, faces, edges = crumpled(rng)
    pairs, far = apart.pairs_near(x, faces, edges)
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
    far = apart.pairs_near(x, faces, edges, 0.004)[1]
    everything, all_far = apart.pairs_near(x, faces, edges, 10.0)
    apart_edges = [(e, f) for e in range(len(edges)) for f in range(e) if not set(edges[e]) & set(edges[f])]
    assert everything.triangles == len(x) * len(faces) - faces.size
    assert len(everything.corner) - everything.triangles == len(apart_edges)
    assert_allclose(np.sort(far), np.sort(all_far[all_far < 0.004]))
    assert len(far) > 50


def test_the_barriers_force_is_the_slope_of_its_energy(rng):
    x, faces, edges = crumpled(rng)
    pairs, far = apart.pairs_near(x, faces, edges)
    assert (far < apart.REACH_M).any()
    gradient, way, step = np.zeros_like(x), rng.normal(size=x.shape), 1e-9
    apart.push_apart(x, *pairs, 30.0, gradient)
    ahead, behind = (apart.push_apart(x + sign * step * way, *pairs, 30.0, np.zeros_like(x)) for sign in (1.0, -1.0))
    assert_allclose((gradient * way).sum(), (ahead - behind) / (2.0 * step), rtol=1e-4)
    assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-9 * np.abs(gradient).sum())


@pytest.fixture(scope="module")
def two_sheets() -> tuple[Task, np.ndarray]:
    """A sheet over another one over a ball, both in one mesh, and which vertices are the upper ones."""
    rest, faces = grid(6, 6, cell_m=0.01)
    over = rest + np.array([0.003, 0.004, 0.006])
    both, faces = np.concatenate([rest, over]), np.concatenate([faces, faces + len(rest)])
    cloth = ClothMesh.from_rest(both, faces)
    start = (both - both.mean(axis=0))[None][..., [1, 2, 0]] + [0.0, 0.108, 0.0]
    ball, ball_faces = icosphere(4, radius_m=0.1)
    contact = BodyContact(ball_faces, len(ball))
    return Task(cloth, material(), contact, ball[None], (start,)), np.arange(len(both)) >= len(rest)


def test_an_upper_sheet_stays_over_a_lower_one(two_sheets):
    task, upper = two_sheets
    found = apart.minimise(task, step_limit=40)
    free = physics.minimise(task)
    height = {}
    for name, optimum in (("apart", found), ("free", free)):
        above = np.linalg.norm(optimum.vertices[0], axis=1)
        height[name] = above[upper].mean() - above[~upper].mean()
    assert found.energy_j[0] < found.start_j[0] and height["free"] < 0.0005 < height["apart"]
    assert_array_equal(intersection_count(found.vertices, task.cloth.faces), [0])
    assert intersection_count(free.vertices, task.cloth.faces)[0] > 10


def test_an_optimum_is_stored(two_sheets, tmp_path, monkeypatch):
    monkeypatch.setattr(apart, "STEPS", 2)
    task, _ = two_sheets
    (first, was), (again, is_stored) = (apart.stored_minimum(task, tmp_path) for _ in range(2))
    assert not was and is_stored
    assert_array_equal(first.vertices, again.vertices)
