"""Layers: skin raised by the cloth on it, and an outer garment that rests on an inner one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.folds.constants import Constants
from drape.folds.contact import NEIGHBOURS, SkinGraph
from drape.folds.layers import EVENED, HIGHEST_M, covered, raised
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


def flakes(places: np.ndarray, slope: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A triangle of a hundredth of a millimetre around each of ``places`` (N, 3), its normal ``slope`` [rad] from y to
    z: vertices (3N, 3) and faces."""
    corners = 1e-5 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, 0.8], [-0.5, 0.0, -0.8]])
    turned = np.stack([corners[:, 0], -np.sin(slope) * corners[:, 2], np.cos(slope) * corners[:, 2]], axis=1)
    return (places[:, None] + turned).reshape(-1, 3), np.arange(3 * len(places), dtype=np.int32).reshape(-1, 3)[:, ::-1]


def test_a_sample_is_raised_to_the_highest_cloth_over_it_and_evened_with_its_neighbours():
    skin, graph = floor()
    places = np.array([[0.001, 0.010, 0.0], [0.001, 0.006, 0.0], [0.03, 0.004, 0.0], [0.08, -0.002, 0.0]])
    own = np.repeat([0, 0, 1, 4], 3).astype(np.int32)
    alone = np.array([0.010, 0.010, 0.004, 0.0, 0.0, 0.0])
    mean = 0.5 * (alone[[0, 0, 1, 2, 3, 4]] + alone[[1, 2, 3, 4, 5, 5]])  # the floor's ends are their own neighbours
    evened = np.where(alone > 0.0, alone + EVENED * (mean - alone), 0.0)
    assert_allclose(covered(*flakes(places), own, skin, graph), evened, atol=1e-12)
    high = covered(*flakes(np.array([[0.0, 0.5, 0.0]])), np.zeros(3, np.int32), skin, graph)
    assert high.max() == pytest.approx(HIGHEST_M)


def test_cloth_that_spans_a_crease_raises_its_walls_by_the_cosine():
    skin, graph = floor()
    own, places = np.zeros(3, np.int32), np.array([[0.0, 0.010, 0.0]])
    level = covered(*flakes(places), own, skin, graph)
    assert_allclose(covered(*flakes(places, 1.0), own, skin, graph), np.cos(1.0) * level, rtol=2e-3)
    vertices, faces = flakes(places)
    assert covered(vertices, faces[:, ::-1], own, skin, graph).max() == 0.0, "folded over"
    upright, faces = flakes(places, 0.5 * np.pi)
    assert covered(upright, faces, own, skin, graph).max() < 1e-6
    upright[:] = places
    assert covered(upright, faces, own, skin, graph).max() == 0.0, "no area, no normal, and finite"


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
    ground = raised(skin, covered(inner, made.faces, own, skin, made.graph))
    outer, _, _ = fold(made, None, replace(one, skin=ground), effort)
    radius = [np.linalg.norm(x[:, [0, 2]], axis=1) for x in (inner, outer)]
    free = (
        (rest[:, 1] > 0.02) & (rest[:, 1] < 0.09) & (inner[:, 0] < 0.5 * RADIUS_M)
    )  # not at the rims, nor at the wall
    assert (radius[1] - radius[0])[free].mean() > 0.002 and radius[0][free].mean() < RADIUS_M + EASE_M + 0.002
    assert_array_equal(outer, fold(made, None, replace(one, skin=ground), effort)[0])
