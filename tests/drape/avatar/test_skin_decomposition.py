"""Frames that bones and weights made are taken apart into such bones and weights; every step lowers the error."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.affine_maps import affine_inverse, compose, rigid_fit
from drape.avatar.skin_decomposition import (
    blend_vertices,
    farthest_points,
    fit_moves,
    fit_weights,
    rigid_clusters,
    simplex_fit,
)
from drape.geometry.rotations import rotvec_to_matrix

BONES, VERTICES, FRAMES = 4, 80, 12


def motions(rng: np.random.Generator, frames: int = FRAMES, bones: int = BONES) -> np.ndarray:
    turns = rotvec_to_matrix(rng.normal(0.0, 0.5, (frames, bones, 3)))
    return np.concatenate([turns, rng.normal(0.0, 0.2, (frames, bones, 3, 1))], axis=-1)


@pytest.fixture(scope="module")
def skinned() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A mesh, its weights on bones in a row, two or one a vertex, motions, and the frames."""
    rng = np.random.default_rng(3)
    rest = rng.uniform(-1.0, 1.0, (VERTICES, 3)) * [1.0, 0.2, 0.2]
    away = np.abs(rest[:, :1] - np.linspace(-1.0, 1.0, BONES)) * (BONES - 1) / 2.0
    weights = np.clip(1.0 - away, 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    moves = motions(rng)
    return rest, weights, moves, blend_vertices(weights, rest, moves)


def rms(rest: np.ndarray, weights: np.ndarray, moves: np.ndarray, frames: np.ndarray) -> float:
    return float(np.sqrt(((blend_vertices(weights, rest, moves) - frames) ** 2).sum(axis=-1).mean()))


def everything() -> np.ndarray:
    return np.tile(np.arange(BONES), (VERTICES, 1))


def test_a_rigid_motion_is_found_again_and_never_mirrors():
    rng = np.random.default_rng(1)
    points, moves = rng.normal(size=(9, 3)), motions(rng)[:, 0]
    moved = points @ moves[:, :, :3].swapaxes(-1, -2) + moves[:, None, :, 3]
    assert_allclose(rigid_fit(points, moved, rng.uniform(0.1, 1.0, 9)), moves, atol=1e-13)
    assert_allclose(np.linalg.det(rigid_fit(points, -moved)[:, :, :3]), 1.0, atol=1e-12)
    flat = points * [1.0, 1.0, 0.0]
    turned = flat @ moves[:, :, :3].swapaxes(-1, -2)
    assert_allclose(rigid_fit(flat, turned)[:, :, :3], moves[:, :, :3], atol=1e-13)


def test_maps_and_their_inverses_come_to_nothing():
    moves = motions(np.random.default_rng(2))
    stretched = moves * [1.0, 2.0, 0.5, 1.0]
    none = np.broadcast_to(np.eye(3, 4), moves.shape)
    assert_allclose(compose(affine_inverse(stretched), stretched), none, atol=1e-13)


def test_weights_of_known_motions_are_found(skinned: tuple[np.ndarray, ...]):
    rest, weights, moves, frames = skinned
    found = fit_weights(rest, frames, moves, everything()[:, ::-1], most=2)
    assert_allclose(found, weights, atol=1e-7)
    assert (found >= 0.0).all() and ((found > 0.0).sum(axis=1) <= 2).all()
    assert_allclose(found.sum(axis=1), 1.0, atol=1e-12)


def test_sparse_weights_are_the_best_of_all_choices():
    """Where all pairs of four bones are tried, no pair is better than what is found by more than a little."""
    rng = np.random.default_rng(7)
    ways = rng.normal(size=(40, 4, 6))
    targets = np.einsum("vb,vbk->vk", rng.dirichlet([0.3] * 4, 40), ways) + rng.normal(0.0, 0.01, (40, 6))
    gram, right = np.einsum("vbk,vck->vbc", ways, ways), np.einsum("vbk,vk->vb", ways, targets)
    found = simplex_fit(gram, right, 2)

    def cost(weights: np.ndarray) -> np.ndarray:
        return ((np.einsum("vb,vbk->vk", weights, ways) - targets) ** 2).sum(axis=1)

    best = np.full(40, np.inf)
    for a, b in itertools.combinations(range(4), 2):
        for share in np.linspace(0.0, 1.0, 201):
            weights = np.zeros((40, 4))
            weights[:, a], weights[:, b] = share, 1.0 - share
            best = np.minimum(best, cost(weights))
    assert (cost(found) <= best + 1e-4).mean() > 0.85  # the least costly one leaves first, which may be the wrong one
    assert (found >= 0.0).all() and ((found > 0.0).sum(axis=1) <= 2).all()


def test_equal_bones_share_a_vertex():
    gram, right = np.ones((1, 3, 3)), np.ones((1, 3))
    assert_allclose(simplex_fit(gram, right, 3), 1.0 / 3.0, atol=1e-3)
    assert_allclose(np.sort(simplex_fit(gram, right, 1)), [[0.0, 0.0, 1.0]], atol=1e-3)


def test_a_stiff_pull_wins(skinned: tuple[np.ndarray, ...]):
    rest, weights, moves, frames = skinned
    even = np.full_like(weights, 1.0 / BONES)
    found = fit_weights(rest, frames, moves, everything(), most=BONES, pull=even, stiffness=1e6)
    assert_allclose(found, even, atol=1e-5)


def test_motions_of_known_weights_are_found(skinned: tuple[np.ndarray, ...]):
    rest, weights, moves, frames = skinned
    rng = np.random.default_rng(4)
    start = moves.copy()
    start[:, 1:, :, 3] += rng.normal(0.0, 0.05, (FRAMES, BONES - 1, 3))
    found = fit_moves(weights, rest, frames, start, np.arange(1, BONES), rounds=300)
    assert_allclose(found, moves, atol=1e-6)
    assert_allclose(found[:, 0], moves[:, 0], atol=0)  # not free
    held = fit_moves(weights, rest, frames, start, np.arange(1, BONES), steadiness=1e9)
    assert_allclose(held, start, atol=1e-6)


def test_skinned_frames_are_taken_apart_to_the_micrometre(skinned: tuple[np.ndarray, ...]):
    """Clusters, weights, motions by turns: the error never grows, and what was skinned exactly is skinned so again."""
    rest, _, _, frames = skinned
    _, moves = rigid_clusters(rest, frames, BONES)
    errors, weights = [], None
    for _ in range(800):
        new = fit_weights(rest, frames, moves, everything(), most=2, past=weights)
        assert weights is None or rms(rest, new, moves, frames) <= errors[-1] * (1.0 + 1e-9) + 1e-12
        weights = new
        moves = fit_moves(weights, rest, frames, moves, np.arange(BONES))
        errors.append(rms(rest, weights, moves, frames))
        if errors[-1] < 1e-6:
            break
    assert errors[-1] < 1e-6
    assert errors == sorted(errors, reverse=True)


def test_clusters_are_the_rigid_parts():
    rng = np.random.default_rng(5)
    rest = rng.uniform(-0.3, 0.3, (90, 3)) + np.repeat([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], 30, axis=0)
    moves, part = motions(rng, bones=3), np.repeat([0, 1, 2], 30)
    frames = blend_vertices(np.eye(3)[part], rest, moves)
    found, fitted = rigid_clusters(rest, frames, 3)
    assert len({(a, b) for a, b in zip(part, found, strict=True)}) == 3
    assert_allclose(blend_vertices(np.eye(3)[found], rest, fitted), frames, atol=1e-12)


def test_farthest_points_are_corners():
    line = np.linspace(0.0, 1.0, 11)[:, None] * [1.0, 0.0, 0.0]
    assert set(farthest_points(line, 3)) == {0, 5, 10}


def test_steadiness_counts_as_points_that_stay(skinned: tuple[np.ndarray, ...]):
    """As if each point were there twice, the second time where the bone was at first, with that share of its mass."""
    rest, weights, _, frames = skinned
    bone, rows = 1, weights[:, 1] > 0.0
    start = np.tile(np.eye(3, 4), (len(frames), BONES, 1, 1))
    found = fit_moves(weights, rest, frames, start, np.array([bone]), steadiness=0.3)[:, bone]
    share = weights[rows, bone]
    aims = rest[rows] + (frames[:, rows] - rest[rows]) / share[:, None]
    twice = np.concatenate([aims, np.broadcast_to(rest[rows], aims.shape)], axis=1)
    expected = rigid_fit(np.tile(rest[rows], (2, 1)), twice, np.concatenate([share**2, 0.3 * share**2]))
    assert np.allclose(found, expected, atol=1e-9)
