"""Samples and planes below a vertex: where a walk is stuck, and where a plane ends."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.contact.samples import sample_table
from drape.engine.calls import call, call_with_scratch
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples
from tests.drape.live.folds_setup import PLANE_ROWS, arm, constants, rows_of, sleeve, spared
from tests.reference import skin as reference
from tests.reference.skin import ALONG, ALONG_STEPS, APART_M, BESIDE, BEYOND_M, FREE, NEARER, REACH_M, STEPS

SPACING_M = 0.02
UP = np.array([0.0, 1.0, 0.0])


def touched_by(
    x: np.ndarray,
    point: np.ndarray,
    rest: np.ndarray,
    *,
    turn: int = -1,
    other: int = -1,
    network: np.ndarray | None = None,
) -> tuple[TouchedSamples, np.ndarray]:
    """What all places at ``x`` [m] (3,) touch, and the distances [m] (P,) to their own planes.

    They begin at the first of the samples ``point`` [m] (S, 3) and at ``other``; the network has them at ``network``
    [m] (3,), if that is not ``x``. No sample has a neighbour; all look up.
    """
    made, count = constants(dtype=np.float64), len(point)
    own = np.arange(count, dtype=np.int32)
    graph = SkinGraph(np.tile(own[:, None], NEIGHBOURS), np.full(count, SPACING_M**2), rest)
    places, skin = (
        spared(np.tile(x, (len(made.sheet.vertex), 1))),
        np.array(sample_table(point, np.tile(UP, (count, 1)))),
    )
    wanted = places if network is None else spared(np.tile(network, (len(made.sheet.vertex), 1)))
    planes = np.zeros(PLANE_ROWS * len(places))
    touched = TouchedSamples(np.zeros(len(places), np.int32), np.full(len(places), other, np.int32))
    call_with_scratch(
        "law_touch", np.float64, places, wanted, len(places), skin, count, Record("SkinGraph", graph),
        made.sheet.vertex, *touched, np.empty(len(places), np.int32), turn, planes,
    )  # fmt: skip
    rows = rows_of(planes)
    return touched, ((places - rows[:, :3]) * rows[:, 3:6]).sum(axis=1)


def test_a_walk_that_is_stuck_starts_at_a_nearer_sample_of_its_part():
    x, point = np.array([0.0, 0.005, 0.0]), np.array([[0.024, 0.0, 0.0], [0.004, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rest = point.copy()
    found, _ = touched_by(x, point, rest)
    assert_array_equal(found.own, 2)
    assert_array_equal(found.other, -1)
    asked = constants(dtype=np.float64).sheet.vertex % 4 == 1
    found, _ = touched_by(x, point, rest, turn=1)
    assert_array_equal(found.own, np.where(asked, 2, 0))
    rest[2] += [APART_M + 0.03, 0.0, 0.0]  # of another part
    found, _ = touched_by(x, point, rest)
    assert_array_equal(found.own, 1)
    assert_array_equal(found.other, 2)


def test_what_slid_far_along_the_skin_is_at_the_sample_below_it_but_not_round_an_edge():
    made, count = constants(dtype=np.float64), 2 + ALONG_STEPS
    point = SPACING_M * np.arange(count)[:, None] * [1.0, 0.0, 0.0]
    near = np.clip(np.arange(count)[:, None] + [-1, 1, *[0] * (NEIGHBOURS - 2)], 0, count - 1).astype(np.int32)
    graph = SkinGraph(near, np.full(count, SPACING_M**2), point)
    for edge, end in ((count, count - 1), (6, 5)):
        normal = np.where(np.arange(count)[:, None] < edge, UP, [0.9, ALONG - 0.1, 0.0])
        skin = np.array(sample_table(point, normal / np.linalg.norm(normal, axis=1, keepdims=True)))
        places = spared(np.tile(point[-1] + 0.01 * UP, (len(made.sheet.vertex), 1)))
        touched = TouchedSamples(np.zeros(len(places), np.int32), np.full(len(places), -1, np.int32))
        at, planes = np.empty(len(places), np.int32), np.zeros(PLANE_ROWS * len(places))
        call_with_scratch(
            "law_touch", np.float64, places, places, len(places), skin, count, Record("SkinGraph", graph),
            made.sheet.vertex, *touched, at, 1, planes,
        )  # fmt: skip
        assert_array_equal(at, end)
        asked = made.sheet.vertex % 4 == 1  # their next walk starts at the nearest sample of the part
        assert_array_equal(touched.own[~asked], 0)


def test_a_sample_that_is_hardly_nearer_is_no_reason_to_leave():
    x, far_m = np.zeros(3), 0.02
    for share, own in ((1.05, 0), (0.95, 1)):
        point = np.array([[far_m, 0.0, 0.0], [0.0, 0.0, share * np.sqrt(NEARER) * far_m]])
        assert_array_equal(touched_by(x, point, point)[0].own, own)


@pytest.mark.parametrize(
    ("below_m", "behind_m", "other"),
    [(0.9 * BEYOND_M, 1.1 * BEYOND_M, 1), (1.1 * BEYOND_M, 0.9 * BEYOND_M, 1), (1.1 * BEYOND_M, 1.1 * BEYOND_M, -1)],
)
def test_of_a_part_that_the_network_is_in_the_side_before_the_own_skin_holds(below_m, behind_m, other):
    """The network is ``below_m`` in another part, whose side is ``behind_m`` above the own sample."""
    x, point = np.zeros(3), np.array([[0.004, 0.0, 0.0], [0.0, behind_m, 0.0]])
    rest = point + np.array([[0.0, 0.0, 0.0], [2.0 * APART_M, 0.0, 0.0]])
    network = np.array([0.2, behind_m - below_m, 0.0])
    for turn, touched in ((-1, -1), (0, 1)):  # by the search, and by the walk of what was there
        found, _ = touched_by(x, point, rest, network=network, turn=turn, other=touched)
        assert_array_equal(found.other, other)


@pytest.mark.parametrize("height_m", [-0.005, 0.002])
def test_a_plane_ends_beside_its_sample(height_m):
    def distance_m(aside: float) -> float:
        x = np.array([np.sqrt(aside) * SPACING_M, height_m, 0.0])
        found, far_m = touched_by(x, np.zeros((1, 3)), np.zeros((1, 3)))
        assert_array_equal(found.own, 0)
        assert_allclose(far_m, far_m[0])
        return float(far_m[0])

    for aside in (0.0, 0.6, 0.99 * BESIDE):
        assert_allclose(distance_m(aside), height_m, rtol=0, atol=1e-12)
    assert_allclose(distance_m(0.5 * (BESIDE + FREE)), 0.5 * (height_m + REACH_M), rtol=0, atol=1e-9)
    for aside in (1.01 * FREE, 9.0):
        assert_allclose(distance_m(aside), REACH_M, rtol=0, atol=1e-12)


def test_fine_places_take_the_planes_of_their_parents_samples(rng):
    rest, worn = sleeve(creased=False)
    skin = np.array(sample_table(*(rows + 0.002 * rng.normal(size=rows.shape) for rows in (arm().point, arm().normal))))
    x = spared(np.resize(rest, (10 * LANES, 3)) + 0.003 * rng.normal(size=(10 * LANES, 3)))
    samples, parent = rng.integers(0, len(skin), 40, np.int32), rng.integers(0, 40, len(x), np.int32)
    samples[::5] = -1
    planes, given = np.zeros(PLANE_ROWS * len(x)), (x, len(x), skin, len(skin), Record("SkinGraph", worn.graph))
    call("law_other_planes", np.float64, *given, samples, parent, planes)
    there, rows = samples[parent] >= 0, rows_of(planes)
    assert_array_equal(rows[~there], 0.0)
    assert 0 < there.sum() < len(x)
    point, normal = reference.planes(x[there], skin, worn, samples[parent][there])
    assert_allclose(rows[there, 6:9], point, rtol=0, atol=1e-12)
    assert_allclose(rows[there, 9:12], normal, rtol=0, atol=1e-12)

    samples = np.maximum(samples, 0)
    call("law_own_planes", np.float64, *given, samples, parent, planes)
    at = samples[parent]
    for _ in range(STEPS):
        around = np.concatenate([at[:, None], worn.graph.neighbour[at]], axis=1)
        nearest = np.linalg.norm(skin[around, :3] - x[:, None], axis=2).argmin(axis=1)
        assert nearest.any()
        at = np.take_along_axis(around, nearest[:, None], axis=1)[:, 0]
    point, normal = reference.planes(x, skin, worn, at)
    assert_allclose(rows_of(planes)[:, :3], point, rtol=0, atol=1e-12)
    assert_allclose(rows_of(planes)[:, 3:6], normal, rtol=0, atol=1e-12)
