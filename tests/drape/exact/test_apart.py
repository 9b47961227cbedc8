"""The barrier of cloth that is apart, and steps on which nothing passes through anything."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.exact import apart
from drape.geometry import meshes
from drape.geometry.triangle_pairs import Pairs, crossing_pairs, pairs_within, ways
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.test_triangle_pairs import crumpled

KEPT, SLIGHT_M = 0.2, 1e-7  # of a distance, by a step; a lack that counts as none: drape/engine/source/apart.hpp


def test_the_barriers_force_is_the_slope_of_its_energy(rng):
    x, faces, edges = crumpled(rng)
    pairs, _, ways = pairs_within(x, faces, edges, apart.NEAR_M)
    assert (np.linalg.norm(ways, axis=1) < apart.REACH_M).any()
    gradient, way, step = np.zeros_like(x), rng.normal(size=x.shape), 1e-9
    apart.push_apart(x, *pairs, 30.0, gradient)
    ahead, behind = (apart.push_apart(x + sign * step * way, *pairs, 30.0, np.zeros_like(x)) for sign in (1.0, -1.0))
    assert_allclose((gradient * way).sum(), (ahead - behind) / (2.0 * step), rtol=1e-4)
    assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-9 * np.abs(gradient).sum())


def test_the_barriers_curvature_is_the_slope_of_its_force_towards_what_is_near():
    x, corner = np.array([[0.2, 0.001, 0.3], [0, 0, 0], [0, 0, 1], [1, 0, 0]]), np.arange(4, dtype=np.int32)[None]
    blocks, step, ends = np.zeros((16, 3, 3)), np.array([0.0, 1e-8, 0.0]), []
    apart.add_curvature(x, corner, 1, 30.0, np.arange(16, dtype=np.int32).reshape(1, 4, 4), blocks)
    for sign in (1.0, -1.0):
        moved, gradient = x.copy(), np.zeros_like(x)
        moved[0] += sign * step
        apart.push_apart(moved, corner, 1, 30.0, gradient)
        ends.append(gradient)
    slope = (ends[0] - ends[1]) / (2.0 * step[1])  # of the force at each corner, by the first one's height
    assert_allclose(blocks.reshape(4, 4, 3, 3)[:, 0, :, 1], slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    assert_allclose(blocks.reshape(4, 4, 3, 3), blocks.reshape(4, 4, 3, 3).transpose(1, 0, 3, 2))


def test_a_free_share_of_a_step_keeps_every_pair_apart(rng):
    x, faces, _ = two_grids()
    edges = meshes.unique_edges(faces)
    pairs, _, ways = pairs_within(x, faces, edges, apart.NEAR_M)
    before = np.linalg.norm(ways, axis=1)
    for size in (1e-4, 1e-3, 1e-2):
        step = size * rng.normal(size=x.shape)
        share = np.empty(len(x))
        least = apart.free_shares(x, step, *pairs, share)
        assert 0.0 < least <= 1.0 and least == share.min()
        for part in np.linspace(0.0, 1.0, 5):
            _, way = ways_of(x + part * least * step, pairs)
            assert (np.linalg.norm(way, axis=1) >= KEPT * before - 1e-12).all()
    assert apart.free_shares(x, np.zeros_like(x), *pairs, np.empty(len(x))) == 1.0


def test_what_touches_stays():
    x, corner = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.arange(4, dtype=np.int32)[None]
    share = np.empty(4)
    assert apart.free_shares(x, np.eye(4, 3), corner, 1, share) == 0.0


def test_a_step_that_yields_takes_along_what_is_in_its_way(rng):
    x, faces, upper = two_grids()
    pairs, weight, way = pairs_within(x, faces, meshes.unique_edges(faces), apart.NEAR_M)
    distance = np.linalg.norm(way, axis=1)
    step = 1e-4 * rng.normal(size=x.shape)
    step[upper, 1] -= 0.008
    assert apart.free_shares(x, step, *pairs, np.empty(len(x))) < apart.ENOUGH
    for least_m, more_m in (apart.PRESSED_M, apart.CARRIED_M, (0.005, 0.001)):
        bent = step.copy()
        apart.yield_to(x, bent, *pairs, (least_m, more_m))
        gained = np.einsum("nc,nci,ni->n", weight, bent[pairs.corner], way) / distance
        wanted = np.maximum(KEPT * distance, np.minimum(least_m, distance + more_m)) - distance
        assert (gained >= wanted - 20.0 * SLIGHT_M).all()
        assert apart.free_shares(x, bent, *pairs, np.empty(len(x))) > apart.ENOUGH
        assert_allclose(bent.sum(axis=0), step.sum(axis=0), atol=1e-12)  # what one gives the other takes
        assert bent[~upper, 1].mean() < -0.001


def test_a_sheet_that_goes_through_another_stops_before_it():
    x, faces, upper = two_grids()
    step = np.zeros_like(x)
    step[upper, 1] = -0.5 * x[upper, 0]
    assert len(crossing_pairs(x + 0.3 * step, faces)) > 0
    pairs, _, _ = pairs_within(x, faces, meshes.unique_edges(faces), apart.NEAR_M)
    for _ in range(40):  # as often as anybody asks: never to the last digits of a number
        x = x + apart.free_shares(x, step, *pairs, np.empty(len(x))) * step
    _, way = ways_of(x, pairs)
    assert len(crossing_pairs(x, faces)) == 0 and np.linalg.norm(way, axis=1).min() > 1e-6


def two_grids() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sheet 3 mm over another, shifted; both in one mesh, and which vertices are the upper ones."""
    rest, faces = grid(4, 4, cell_m=0.01)
    rest = np.ascontiguousarray(rest[:, [0, 2, 1]])
    both = np.concatenate([rest, rest + np.array([0.003, 0.003, 0.004])])
    return both, np.concatenate([faces, faces + len(rest)]), np.arange(len(both)) >= len(rest)


def ways_of(x: np.ndarray, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    return ways(np.ascontiguousarray(x), *pairs)
