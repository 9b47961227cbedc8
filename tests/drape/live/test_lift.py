"""The lift off the skin: where it leaves cloth, what it leaves alone, and that a frame ends with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.contact.projection import CLEARANCE_M, MOVED_M
from drape.engine.calls import call
from drape.engine.library import LANES
from drape.live.fold_step import FoldEffort, fold
from drape.live.raised_skin import raise_skin
from tests.drape.live.folds_setup import RADIUS_M, constants, frame, planes_of, sleeve
from tests.reference.folds import DEEP_M, OTHER, TOO_DEEP_M

UP, SIDE = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
NOWHERE = np.zeros((LANES, 3))


def lifted(x: np.ndarray, planes: np.ndarray, clearance_m: float = CLEARANCE_M) -> tuple[np.ndarray, np.ndarray]:
    moved, way = x.copy(), np.empty(len(x), x.dtype)
    call("law_lift", x.dtype, moved, len(x), planes, clearance_m, way)
    return moved, way


def test_what_is_too_low_comes_to_the_clearance_and_what_is_above_stays():
    height = np.linspace(CLEARANCE_M - DEEP_M, 0.02, LANES)
    x = np.outer(height, UP) + np.outer(np.arange(LANES), SIDE)
    moved, way = lifted(x, planes_of(NOWHERE, UP))
    assert_allclose(moved[:, 1], np.maximum(height, CLEARANCE_M), rtol=0.0, atol=1e-15)
    assert_array_equal(moved[:, [0, 2]], x[:, [0, 2]])
    assert_allclose(way, moved[:, 1] - height, rtol=0.0, atol=1e-15)
    assert_array_equal(moved[height > CLEARANCE_M], x[height > CLEARANCE_M])


def test_what_is_too_deep_for_contact_is_left_and_between_the_two_the_way_fades():
    low = np.linspace(DEEP_M, 1.5 * TOO_DEEP_M, LANES)
    _, way = lifted(np.outer(CLEARANCE_M - low, UP), planes_of(NOWHERE, UP))
    assert_allclose(way, low * np.clip((TOO_DEEP_M - low) / (TOO_DEEP_M - DEEP_M), 0.0, 1.0), rtol=0.0, atol=1e-15)
    assert way[0] == pytest.approx(DEEP_M) and (way[low > TOO_DEEP_M] == 0.0).all() and way.max() <= DEEP_M + 1e-15


def test_out_of_another_part_it_goes_a_share_and_its_own_comes_last():
    moved, _ = lifted(np.tile(-0.003 * SIDE + 0.05 * UP, (LANES, 1)), planes_of(NOWHERE, UP, 0.0, SIDE))
    assert_allclose(moved[:, 0], -0.003 + OTHER * (CLEARANCE_M + 0.003), rtol=0.0, atol=1e-15)
    moved, _ = lifted(NOWHERE, planes_of(NOWHERE, UP, 0.001 * UP, -UP))
    assert_allclose(moved[:, 1], CLEARANCE_M, rtol=0.0, atol=1e-15)


def test_a_frame_ends_clear_of_the_skin_and_tells_what_was_lifted():
    """A sleeve whose arm has grown by half a centimetre since the network saw it."""
    made, one = constants(creased=False, dtype=np.float64), frame(sleeve(creased=False)[0], 0, noise_m=0.0)
    grown = replace(one, skin=raise_skin(one.skin, np.full(len(one.skin), 0.005)))
    effort = FoldEffort(steps=1, settle=1)

    def radius_m(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x[:, [0, 2]], axis=1)

    below, _, left = fold(made, None, grown, effort._replace(clearance_m=0.0))
    above, memory, report = fold(made, None, grown, effort)
    assert radius_m(below).min() < RADIUS_M + 0.005 + CLEARANCE_M - 1e-3, "steps alone leave some of it in the skin"
    assert radius_m(above).min() > RADIUS_M + 0.005 + CLEARANCE_M - 2e-4, "planes, where the skin is round"
    assert left.lifted_share == left.lifted_max_m == 0.0
    way = np.linalg.norm(above - below, axis=1)
    assert_allclose(report.lifted_share, (way > MOVED_M).mean())
    assert_allclose(report.lifted_max_m, way.max(), rtol=1e-9)
    place = made.sheet.place
    assert_allclose(
        np.linalg.norm(memory.residual[place], axis=1), np.linalg.norm(above - one.vertices, axis=1), atol=1e-12
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_number_is_lifted_to_one(dtype):
    moved, _ = lifted(np.full((LANES, 3), np.nan, dtype), planes_of(NOWHERE.astype(dtype), UP))
    assert np.isnan(moved).all(), "the guard of the frame sees it"
