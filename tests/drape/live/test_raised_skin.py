"""Layers: skin raised by the cloth on it, and an outer garment that rests on an inner one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.samples import sample_table
from drape.live.fold_constants import LaidCloth
from drape.live.fold_step import fold
from drape.live.raised_skin import heights_over, raise_skin
from drape.live.sheet import sheet
from drape.live.skin_walks import NEIGHBOURS, SkinGraph
from tests.drape.live.folds_setup import EASE_M, HELD, RADIUS_M, constants, frame, sleeve

SPACING_M = 0.02
CLOSE_M, HIGHEST_M, STEEPEST = 0.02, 0.06, 0.7


def floor(count: int = 6) -> tuple[np.ndarray, SkinGraph]:
    """Samples of a level floor in a row along x, each the neighbour of the next two, as a table (S, 8)."""
    point = np.stack([SPACING_M * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    neighbour = np.clip(np.arange(count)[:, None] + np.tile([-1, 1], NEIGHBOURS // 2), 0, count - 1)
    graph = SkinGraph(neighbour.astype(np.int32), np.full(count, SPACING_M**2), point)
    return np.asarray(sample_table(point, np.tile([0.0, 1.0, 0.0], (count, 1)))), graph


def flakes(places: np.ndarray, slope: float = 0.0) -> np.ndarray:
    """A triangle of a hundredth of a millimetre around each of ``places`` (N, 3), its normal ``slope`` [rad] from y to
    z: vertices (3N, 3)."""
    corners = 1e-5 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, -0.8], [-0.5, 0.0, 0.8]])
    turned = np.stack([corners[:, 0], -np.sin(slope) * corners[:, 2], np.cos(slope) * corners[:, 2]], axis=1)
    return (places[:, None] + turned).reshape(-1, 3)


def heights(
    vertices: np.ndarray, own: int | list[int], skin: np.ndarray, graph: SkinGraph, *, flipped: bool = False
) -> np.ndarray:
    """Those over ``skin`` of flakes, each at the sample ``own``; ``flipped``: their triangles wound the other way."""
    count = len(vertices) // 3
    faces = np.arange(3 * count).reshape(-1, 3)
    cloth = ClothMesh.from_rest(flakes(np.zeros((count, 3))), faces[:, ::-1] if flipped else faces)
    made = sheet(cloth, Material(), np.zeros(3 * count), dtype=np.float64)
    sample = np.repeat(own, 3 * count // np.size(own)).astype(np.int32)
    laid = LaidCloth(made, graph, np.zeros(len(made.vertex), np.int32))
    return heights_over(vertices, laid, sample[made.vertex], skin)


def test_a_sample_is_raised_to_the_highest_cloth_over_it():
    skin, graph = floor()
    places = np.array([[0.001, 0.010, 0.0], [0.001, 0.006, 0.0], [0.03, 0.004, 0.0], [0.08, -0.002, 0.0]])
    height = heights(flakes(places), [0, 0, 1, 4], skin, graph)
    assert_allclose(height, [0.010, 0.010, 0.004, 0.0, 0.0, 0.0], atol=1e-9)
    high = heights(flakes(np.array([[0.0, 0.5, 0.0]])), 0, skin, graph)
    assert high.max() == pytest.approx(HIGHEST_M)


def test_a_high_sample_does_not_stand_out_from_its_neighbours_below_cloth():
    skin, graph = floor()
    places = SPACING_M * np.arange(6)[:, None] * [1.0, 0.0, 0.0] + [
        [0.0, 0.05 if i == 3 else 0.015, 0.0] for i in range(6)
    ]
    height = heights(flakes(places), list(range(6)), skin, graph)
    rise = STEEPEST * SPACING_M
    assert min(0.015 + rise, 0.05) > CLOSE_M  # the high flake raises the samples beside its own as well
    assert_allclose(height, 0.015 + rise * np.array([0.0, 0.0, 1.0, 2.0, 1.0, 0.0]), atol=1e-9)
    alone = heights(flakes(places[3:4]), 3, skin, graph)
    assert alone[3] == pytest.approx(0.05), "nothing lies beside it"


def crease(width_m: float) -> tuple[np.ndarray, SkinGraph]:
    """A level floor and, ``width_m`` over it, a ceiling, sample over sample, as a table, and the graph of both."""
    skin, graph = floor()
    above = np.asarray(sample_table(skin[:, :3] + [0.0, width_m, 0.0], np.tile([0.0, -1.0, 0.0], (len(skin), 1))))
    both = SkinGraph(
        np.concatenate([graph.neighbour, graph.neighbour + len(skin)]).astype(np.int32),
        np.tile(graph.reach_m2, 2),
        np.concatenate([graph.rest, graph.rest]),
    )
    return np.concatenate([skin, above]), both


def test_walls_of_a_crease_that_cloth_spans_go_half_of_the_way_to_each_other():
    places, upright = np.array([[0.0, 0.030, 0.0]]), 0.5 * np.pi
    for width_m, expected in ((0.04, 0.020), (0.02, 0.010), (0.5, 0.030)):
        height = heights(flakes(places, upright), 0, *crease(width_m))
        assert_allclose(height[:2], expected, atol=1e-5, err_msg=str(width_m))
    level = flakes(places)
    facing = heights(level, 0, *crease(0.02))
    assert_allclose(facing[0], 0.030, atol=1e-5, err_msg="it faces as the floor does")
    folded = heights(level, 0, *crease(0.02), flipped=True)
    assert_allclose(folded[0], 0.010, atol=1e-5, err_msg="folded over")
    slanting = heights(flakes(places, 1.2), 0, *crease(0.01))
    assert_allclose(slanting[0], 0.030 * np.cos(1.2), atol=1e-5, err_msg="no lower than by the cosine")
    level[:] = places
    assert_allclose(heights(level, 0, *crease(0.02))[0], 0.010, atol=1e-6, err_msg="no area, no normal")


def test_heights_far_from_home_and_of_numbers_that_are_none_are_finite():
    skin, graph = crease(0.04)
    vertices = flakes(np.array([[0.0, 0.030, 0.0]]), 0.5 * np.pi)
    away = np.array([1e4, 0.0, -1e4])
    moved = np.concatenate([skin[:, :3] + away, skin[:, 3:]], axis=1)
    assert_allclose(heights(vertices + away, 0, moved, graph)[0], 0.020, atol=1e-5)
    broken = skin.copy()
    broken[3] = np.nan
    assert np.isfinite(heights(vertices, 0, broken, graph)).all()


def test_raised_samples_are_a_table_of_samples_again(rng):
    normal = rng.normal(size=(2, 5, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    point, height = rng.normal(size=(2, 5, 3)), rng.uniform(0.0, 0.05, size=(2, 5))
    found = raise_skin(np.asarray(sample_table(point, normal)), height)
    assert_allclose(found, sample_table(point + height[..., None] * normal, normal), rtol=0.0, atol=1e-15)


def test_an_outer_sleeve_rests_on_an_inner_one():
    rest, made = sleeve(creased=False)[0], constants(creased=False)
    one = frame(rest, 0, noise_m=0.0)
    skin = one.skin.astype(np.float32)
    inner, memory, _ = fold(made, None, replace(one, skin=skin), HELD)
    ground = raise_skin(skin, heights_over(inner, made.laid, memory.touched.own, skin))
    outer, _, _ = fold(made, None, replace(one, skin=ground), HELD)
    radius = [np.linalg.norm(x[:, [0, 2]], axis=1) for x in (inner, outer)]
    # Neither at the rims nor at the wall.
    free = (rest[:, 1] > 0.02) & (rest[:, 1] < 0.09) & (inner[:, 0] < 0.5 * RADIUS_M)
    assert (radius[1] - radius[0])[free].mean() > 0.002 and radius[0][free].mean() < RADIUS_M + EASE_M + 0.002
    assert_array_equal(outer, fold(made, None, replace(one, skin=ground), HELD)[0])
