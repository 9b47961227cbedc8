"""An inner garment below an outer one: the ceiling over the skin, cloth pressed below it, and the cloth around."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.samples import Samples, sample_table
from drape.engine.calls import call
from drape.engine.packer import Record
from drape.live.ceiling import ceiling_over, lower, press
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.skin_walks import nearest_at_rest, skin_graph
from tests.drape.cloth.cloth_shapes import grid

SIDE_M, SPACING_M = 0.3, 0.02
FADE_M, GAP_M, HIGHEST_M, LEAST_M = 0.1, 0.003, 0.12, 0.0025
UP = np.array([0.0, 1.0, 0.0])


def level(side: int, width_m: float, height_m: float) -> tuple[np.ndarray, np.ndarray]:
    """A square cloth of ``side`` times ``side`` vertices, ``height_m`` over the floor, from one edge on."""
    flat, faces = grid(side, side)
    x, y = (flat[:, :2] / flat[:, :2].max()).T
    return np.stack([SIDE_M * y, np.full_like(x, height_m), width_m * x], axis=1), faces


def floor() -> tuple[Samples, np.ndarray]:
    """Samples of a level floor, and their table (S, 8)."""
    along = SPACING_M * np.arange(round(SIDE_M / SPACING_M) + 1)
    x, z = (each.ravel() for each in np.meshgrid(along, along))
    point, normal = np.stack([x, np.zeros_like(x), z], axis=1), np.tile(UP, (len(x), 1))
    none = scipy.sparse.csr_matrix((3 * len(point), 1))
    table = np.asarray(sample_table(point, normal))
    return Samples(none, point, normal, np.full(len(point), SPACING_M)), table


def worn(vertices: np.ndarray, faces: np.ndarray, *, dtype: type[np.floating] = np.float64) -> FoldConstants:
    """Cloth on the floor."""
    samples, _ = floor()
    cloth = ClothMesh.from_rest(vertices, faces)
    index = nearest_at_rest(vertices, samples)
    dressed = WornCloth(cloth, Material(), np.zeros(len(vertices)), skin_graph(samples), index)
    return FoldConstants.of(dressed, dtype=dtype)


INNER, OUTER = level(31, SIDE_M, 0.03), level(16, 0.5 * SIDE_M, 0.02)  # the outer one covers half of the inner one
COVERED = INNER[0][:, 2] <= OUTER[0][:, 2].max() - SPACING_M
_, SKIN = floor()


def over(height_m: float = 0.02) -> np.ndarray:
    """The ceiling below the outer cloth at ``height_m``."""
    return ceiling_over(OUTER[0] + (height_m - 0.02) * UP, worn(*OUTER).laid, SKIN)


def press_inner(vertices: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """The inner cloth, with ``vertices``, below the ``ceiling``."""
    made = worn(*INNER)
    own = nearest_at_rest(vertices, floor()[0])[made.sheet.vertex]
    return press(vertices, made.laid, own, SKIN, ceiling)


def test_the_ceiling_is_the_lowest_of_the_outer_cloth_over_a_sample():
    ceiling, below = over(), SKIN[:, 2] < 0.5 * SIDE_M - 0.01
    assert_allclose(ceiling[below], np.tile([0.02, *UP, 0.02], (below.sum(), 1)), atol=1e-9)
    assert np.isinf(ceiling[SKIN[:, 2] > 0.5 * SIDE_M + 2.0 * SPACING_M, 0]).all()
    dented = OUTER[0].copy()
    dented[np.argmin(np.linalg.norm(dented[:, [0, 2]] - [0.1, 0.06], axis=1)), 1] = 0.011
    found = ceiling_over(dented, worn(*OUTER).laid, SKIN)
    assert found[:, 0].min() == pytest.approx(0.011)
    assert np.isinf(over(HIGHEST_M + 0.01)[:, 0]).all(), "what is farther out covers nothing"


def test_planes_of_the_ceiling_touch_the_outer_cloth():
    slope = OUTER[0] + 0.3 * OUTER[0][:, :1] * UP
    found = ceiling_over(slope, worn(*OUTER).laid, SKIN)
    found = found[np.isfinite(found[:, 0])]
    assert_allclose(found[:, 1:4] @ slope.T - found[:, 4:], 0.0, atol=1e-9)


def test_of_two_ceilings_the_lower_holds_sample_by_sample():
    low, high = over(0.01), over(0.02)
    assert_array_equal(lower(low, high), low)
    half = np.where(np.arange(len(low))[:, None] % 2, low, np.inf)
    assert_array_equal(lower(high, half), np.where(np.isfinite(half[:, :1]), half, high))


def test_a_hole_among_covered_samples_is_filled():
    vertices, faces = OUTER
    middle = np.linalg.norm(vertices[:, [0, 2]] - [0.1, 0.06], axis=1) < 0.75 * SPACING_M
    kept = faces[~middle[faces].any(axis=1)]
    holed, renumbered = vertices[~middle], np.cumsum(~middle) - 1
    found = ceiling_over(holed, worn(holed, renumbered[kept]).laid, SKIN)
    assert_allclose(found[SKIN[:, 2] < 0.5 * SIDE_M - 0.01, 0], 0.02, atol=1e-9)


def test_covered_cloth_goes_below_the_ceiling_and_takes_the_cloth_around_along():
    rest = INNER[0]
    after = press_inner(rest, over())
    assert_allclose(after[:, [0, 2]], rest[:, [0, 2]], atol=1e-12)
    assert after[COVERED, 1].max() < 0.02 - GAP_M + 1e-9
    assert_allclose(after[COVERED, 1], 0.02 - GAP_M, atol=5e-4)
    beyond = rest[:, 2] - OUTER[0][:, 2].max()
    free = (beyond > 0.02) & (beyond < FADE_M - 0.01)
    along = (rest[:, 1] - after[:, 1])[free]
    assert along.min() > 0.0 and along.max() < 0.01 + GAP_M
    row = np.rint(beyond[free] / 0.01)
    rows = [along[row == one].mean() for one in np.unique(row)]
    assert (np.diff(rows) < 0.0).all(), "it fades with the distance"
    by_row = [after[np.isclose(rest[:, 2], z), 1].mean() for z in np.unique(rest[:, 2])]
    assert np.abs(np.diff(by_row)).max() < 0.003, "no step at the hem"


def test_a_wrinkle_stays_where_cloth_is_taken_along():
    beyond = INNER[0][:, 2] > OUTER[0][:, 2].max() + 0.03
    crumpled = INNER[0].copy()
    crumpled[np.flatnonzero(beyond)[::2], 1] += 0.002
    after = press_inner(crumpled, over())
    assert np.abs(after - crumpled)[beyond, 1].max() > 0.005
    assert_allclose((after - press_inner(INNER[0], over()))[beyond], (crumpled - INNER[0])[beyond], atol=4e-4)


def test_nothing_comes_nearer_to_what_lies_below_than_least():
    assert press_inner(INNER[0], over(0.001))[:, 1].min() == pytest.approx(LEAST_M, abs=1e-9)


def test_a_way_down_into_a_hollow_ends_above_both_of_its_sides():
    def rises(x: np.ndarray) -> np.ndarray:
        return 0.4 * np.abs(x - 0.5 * SIDE_M)[:, None] * UP

    normal = np.stack([-0.4 * np.sign(SKIN[:, 0] - 0.5 * SIDE_M), np.ones(len(SKIN)), np.zeros(len(SKIN))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    hollow = np.asarray(sample_table(SKIN[:, :3] + rises(SKIN[:, 0]), normal))
    x = INNER[0] + rises(INNER[0][:, 0])
    aside = INNER[0] - 0.012 * np.array([1.0, 0.0, 0.0])  # beyond the crease the own sample is on its other side
    own, down = nearest_at_rest(aside, floor()[0]), np.tile(-0.04 * UP, (len(x), 1))
    graph = Record("SkinGraph", worn(*INNER).graph)
    call("law_stay_above_skin", np.float64, x, len(x), own, hollow, len(hollow), graph, down)
    above = (x + down)[:, 1] - 0.4 * np.abs(x[:, 0] - 0.5 * SIDE_M)
    assert above.min() > 0.9 * LEAST_M and above.mean() < 0.01


def test_cloth_that_is_near_the_skin_is_not_taken_into_it():
    low = INNER[0] - np.where(COVERED, 0.0, 0.03 - 0.5 * LEAST_M)[:, None] * UP
    after = press_inner(low, over())
    assert_array_equal(after[~COVERED], low[~COVERED])


def test_skin_that_is_aslant_below_the_planes_bounds_no_way():
    leaning = SKIN.copy()
    leaning[:, 4:7] = [1.0, 0.0, 0.0]
    made = worn(*INNER)
    own = nearest_at_rest(INNER[0], floor()[0])[made.sheet.vertex]
    after = press(INNER[0], made.laid, own, leaning, over())
    assert_allclose(after[COVERED, 1], 0.02 - GAP_M, atol=2e-3)


def test_cloth_that_is_nowhere_too_high_is_not_touched():
    assert press_inner(INNER[0], over(0.05)) is INNER[0]
    nothing = over()
    nothing[:, 0] = np.inf
    assert press_inner(INNER[0], nothing) is INNER[0]


def test_numbers_that_are_none_press_nothing():
    broken = INNER[0].copy()
    broken[7] = np.nan
    made = worn(*INNER)
    own = nearest_at_rest(INNER[0], floor()[0])[made.sheet.vertex]
    after = press(broken, made.laid, own, SKIN, over(0.05))
    assert np.isfinite(np.delete(after, 7, axis=0)).all()
