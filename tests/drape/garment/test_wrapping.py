"""A coarse tube around a fine round one: its triangles are chords, and go out until they cut nothing off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment.fine import corner_weights
from drape.garment.wrapping import DEEP_STEPS, RELAXATION, STEPS, Wrapping
from drape.geometry.meshes import vertex_normals
from tests.fixtures.garments import COLUMNS, coarse_tube

RADIUS_M = 0.2
COARSE = coarse_tube()
SAGITTA_M = RADIUS_M * (1.0 - np.cos(np.pi / COLUMNS))


@pytest.fixture(scope="module")
def round_cloth() -> np.ndarray:
    """The tube's fine vertices [m] (N, 3) on a circle of ``RADIUS_M``."""
    away = COARSE.vertices.astype(np.float64) - COARSE.vertices.mean(axis=0)
    out = away * [1.0, 0.0, 1.0]
    out *= RADIUS_M / np.linalg.norm(out, axis=1, keepdims=True)
    return out + away * [0.0, 1.0, 0.0]


def below_m(corners: np.ndarray) -> np.ndarray:
    """How far [m] (N,) the delivered triangles lie inside the fine vertices on the tube."""
    placed = corner_weights(COARSE) @ corners
    return RADIUS_M - np.linalg.norm(placed[:, [0, 2]], axis=1)


def test_triangles_go_out_to_what_bulges_between_their_corners(round_cloth: np.ndarray):
    count = COARSE.vertex_count
    before = below_m(round_cloth[:count])
    bulge_m = before.max()  # the coarse corners are not evenly spread
    assert SAGITTA_M <= bulge_m < 2.0 * SAGITTA_M
    wrapped = Wrapping(COARSE).wrap(round_cloth)
    assert wrapped.shape == (count, 3)
    assert below_m(wrapped).max() < 0.15 * bulge_m
    assert np.linalg.norm(wrapped - round_cloth[:count], axis=1).max() < 1.5 * bulge_m


def test_steps_are_those_of_the_formula_with_sparse_matrices(round_cloth: np.ndarray):
    cloth = round_cloth + np.random.default_rng(0).normal(scale=2e-3, size=round_cloth.shape)
    placing = corner_weights(COARSE)
    corners, normals = cloth[: COARSE.vertex_count].copy(), vertex_normals(cloth, COARSE.fine_faces)
    for step in range(STEPS + DEEP_STEPS):
        below = np.maximum(np.einsum("nc,nc->n", normals, cloth - placing @ corners), 0.0)
        counted = below if step >= STEPS else np.ones_like(below) / RELAXATION
        way = placing.T @ (np.where(step >= STEPS, below, 1.0)[:, None] * below[:, None] * normals)
        corners += way / np.maximum(placing.T @ counted, 1e-9)[:, None]
    assert_allclose(Wrapping(COARSE).wrap(cloth), corners, rtol=0, atol=1e-12)
    assert_allclose(Wrapping(COARSE).wrap(cloth.astype(np.float32)), corners, rtol=0, atol=1e-6)


def test_what_bulges_in_one_place_of_a_large_triangle_is_not_cut_off(round_cloth: np.ndarray):
    """A thigh came through a dress of 32 vertices: places that were far enough out had the most to say."""
    middle = round_cloth[COARSE.vertex_count :].mean(axis=0)
    knee = round_cloth.copy()
    away = np.linalg.norm(knee - middle - np.array([0.0, 0.0, -RADIUS_M]), axis=1)
    knee[:, 2] += 0.06 * np.exp(-0.5 * (away / 0.05) ** 2)
    normals = vertex_normals(knee, COARSE.fine_faces)
    below = np.einsum("nc,nc->n", normals, knee - corner_weights(COARSE) @ Wrapping(COARSE).wrap(knee))
    assert below.max() < 5e-4  # 1.7 mm by means alone


def test_flat_cloth_and_hollows_stay_and_types_are_kept():
    flat = COARSE.vertices.astype(np.float64) * [1.0, 1.0, 0.0]  # the tube pressed flat: midpoints stay midpoints
    wrapping = Wrapping(COARSE)
    assert_allclose(wrapping.wrap(flat), flat[: COARSE.vertex_count], rtol=0, atol=1e-7)
    hollow = COARSE.vertices.copy()
    normals = hollow * [1.0, 0.0, 1.0]
    hollow[COARSE.vertex_count :] -= 0.02 * normals[COARSE.vertex_count :]
    found = wrapping.wrap(hollow)
    assert found.dtype == np.float32
    assert_allclose(found, hollow[: COARSE.vertex_count], rtol=0, atol=2e-4)


def test_the_same_cloth_gives_the_same_bits_from_any_wrapping(round_cloth: np.ndarray):
    other = Wrapping(replace(COARSE))
    assert_array_equal(other.wrap(round_cloth), Wrapping(COARSE).wrap(round_cloth))
