"""Layers: skin raised by the cloth on it, and an outer garment that rests on an inner one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.folds.constants import Constants
from drape.folds.contact import NEIGHBOURS, SkinGraph
from drape.folds.layers import HIGHEST_M, covered, raised
from drape.folds.step import Effort, fold
from drape.push.samples import sample_table
from tests.drape.folds.folds_setup import EASE_M, RADIUS_M, frame, sleeve

SPACING_M = 0.02


def floor(count: int = 6) -> tuple[np.ndarray, SkinGraph]:
    """Samples of a level floor in a row along x, each the neighbour of the next two, as a table (S, 8)."""
    point = np.stack([SPACING_M * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    neighbour = np.clip(np.arange(count)[:, None] + np.tile([-1, 1], NEIGHBOURS // 2), 0, count - 1)
    graph = SkinGraph(neighbour.astype(np.int32), np.full(count, SPACING_M**2), point)
    return np.asarray(sample_table(point, np.tile([0.0, 1.0, 0.0], (count, 1)))), graph


def test_a_sample_is_raised_to_the_highest_cloth_over_it():
    skin, graph = floor()
    cloth = np.array([[0.001, 0.010, 0.0], [0.001, 0.006, 0.0], [0.03, 0.004, 0.0], [0.08, -0.002, 0.0]])
    height = covered(cloth, np.array([0, 0, 1, 4], np.int32), skin, graph)
    assert_allclose(height, [0.010, 0.010, 0.004, 0.0, 0.0, 0.0], atol=1e-12)
    assert covered(np.array([[0.0, 0.5, 0.0]]), np.zeros(1, np.int32), skin, graph).max() == HIGHEST_M


def test_raised_samples_are_a_table_of_samples_again(rng):
    normal = rng.normal(size=(2, 5, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    point, height = rng.normal(size=(2, 5, 3)), rng.uniform(0.0, 0.05, size=(2, 5))
    found = raised(np.asarray(sample_table(point, normal)), height)
    assert_allclose(found, sample_table(point + height[..., None] * normal, normal), rtol=0.0, atol=1e-15)


def test_an_outer_sleeve_rests_on_an_inner_one():
    rest, dressed = sleeve(creased=False)
    made, effort = Constants.of(dressed), Effort(sweeps=2, settle=2, cloth_contact=True)
    one = frame(rest, 0, noise_m=0.0)
    skin = one.skin.astype(np.float32)
    inner, memory, _ = fold(made, None, replace(one, skin=skin), effort)
    own = memory.touched.own[made.sheet.place]
    ground = raised(skin, covered(inner, own, skin, made.graph))
    outer, _, _ = fold(made, None, replace(one, skin=ground), effort)
    radius = [np.linalg.norm(x[:, [0, 2]], axis=1) for x in (inner, outer)]
    free = (
        (rest[:, 1] > 0.02) & (rest[:, 1] < 0.09) & (inner[:, 0] < 0.5 * RADIUS_M)
    )  # not at the rims, nor at the wall
    assert (radius[1] - radius[0])[free].mean() > 0.002 and radius[0][free].mean() < RADIUS_M + EASE_M + 0.002
    assert_array_equal(outer, fold(made, None, replace(one, skin=ground), effort)[0])
