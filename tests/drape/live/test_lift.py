"""The lift off the skin: where it leaves cloth, what it leaves alone, and that a frame ends with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.contact.projection import CLEARANCE_M, MOVED_M
from drape.contact.samples import sample_table
from drape.live.fold_constants import FoldConstants
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.lift import DEEP_M, OTHER, TOO_DEEP_M, lift
from drape.live.sheet import LANES
from drape.live.sweeps import PLANES
from tests.drape.live.folds_setup import RADIUS_M, frame, sleeve

UP = np.array([0.0, 1.0, 0.0])
SIDE = np.array([1.0, 0.0, 0.0])


def planes_of(point: np.ndarray, normal: np.ndarray, other: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Planes [m] of ``LANES`` vertices (``LANES``, 3) as the kernels have them: rows of points and normals."""
    rows = np.zeros((PLANES // LANES, LANES))
    rows[:12] = np.concatenate([point.T, normal.T, other.T, across.T])
    return rows.reshape(-1)


def lifted(x: np.ndarray, planes: np.ndarray, clearance_m: float = CLEARANCE_M) -> tuple[np.ndarray, np.ndarray]:
    moved, way = x.copy(), np.empty(len(x))
    lift(moved, planes, clearance_m, way)
    return moved, way


def test_what_is_too_low_comes_to_the_clearance_and_what_is_above_stays():
    height = np.linspace(CLEARANCE_M - DEEP_M, 0.02, LANES)
    x = np.outer(height, UP) + np.outer(np.arange(LANES), SIDE)
    none = np.zeros((LANES, 3))
    moved, way = lifted(x, planes_of(none, np.tile(UP, (LANES, 1)), none, none))
    assert_allclose(moved[:, 1], np.maximum(height, CLEARANCE_M), rtol=0.0, atol=1e-15)
    assert_array_equal(moved[:, [0, 2]], x[:, [0, 2]])
    assert_allclose(way, moved[:, 1] - height, rtol=0.0, atol=1e-15)
    assert_array_equal(moved[height > CLEARANCE_M], x[height > CLEARANCE_M])


def test_what_is_too_deep_for_contact_is_left_and_between_the_two_the_way_fades():
    low = np.linspace(DEEP_M, 1.5 * TOO_DEEP_M, LANES)
    none = np.zeros((LANES, 3))
    _, way = lifted(np.outer(CLEARANCE_M - low, UP), planes_of(none, np.tile(UP, (LANES, 1)), none, none))
    assert_allclose(way, low * np.clip((TOO_DEEP_M - low) / (TOO_DEEP_M - DEEP_M), 0.0, 1.0), rtol=0.0, atol=1e-15)
    assert way[0] == pytest.approx(DEEP_M) and (way[low > TOO_DEEP_M] == 0.0).all() and (way < 0.008).all()


def test_out_of_another_part_it_goes_a_share_and_its_own_comes_last():
    none = np.zeros((LANES, 3))
    x = np.tile(-0.003 * SIDE + 0.05 * UP, (LANES, 1))
    beside = planes_of(none, np.tile(UP, (LANES, 1)), none, np.tile(SIDE, (LANES, 1)))
    moved, _ = lifted(x, beside)
    assert_allclose(moved[:, 0], -0.003 + OTHER * (CLEARANCE_M + 0.003), rtol=0.0, atol=1e-15)
    pinched = planes_of(none, np.tile(UP, (LANES, 1)), 0.001 * np.tile(UP, (LANES, 1)), np.tile(-UP, (LANES, 1)))
    moved, _ = lifted(np.zeros((LANES, 3)), pinched)
    assert_allclose(moved[:, 1], CLEARANCE_M, rtol=0.0, atol=1e-15)


def test_a_frame_ends_clear_of_the_skin_and_tells_what_was_lifted():
    """A sleeve whose arm has grown by half a centimetre since the network saw it."""
    rest, dressed = sleeve(creased=False)
    constants = FoldConstants.of(dressed, dtype=np.float64)
    one = frame(rest, 0, noise_m=0.0)
    skin = one.skin.copy()
    thick = np.asarray(sample_table(skin[:, :3] + 0.005 * skin[:, 4:7], skin[:, 4:7]))
    grown = Frame(one.vertices, thick, one.time_s)
    effort = FoldEffort(steps=1, settle=1)

    def radius_m(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x[:, [0, 2]], axis=1)

    below, _, left = fold(constants, None, grown, replace(effort, clearance_m=0.0))
    above, memory, report = fold(constants, None, grown, effort)
    assert radius_m(below).min() < RADIUS_M + 0.005 + CLEARANCE_M - 1e-3, "steps alone leave some of it in the skin"
    assert radius_m(above).min() > RADIUS_M + 0.005 + CLEARANCE_M - 2e-4, "planes, where the skin is round"
    assert left.lifted_share == left.lifted_max_m == 0.0
    way = np.linalg.norm(above - below, axis=1)
    assert_allclose(report.lifted_share, (way > MOVED_M).mean())
    assert_allclose(report.lifted_max_m, way.max(), rtol=1e-9)
    place = constants.sheet.place
    assert_allclose(
        np.linalg.norm(memory.residual[place], axis=1), np.linalg.norm(above - one.vertices, axis=1), atol=1e-12
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_number_is_lifted_to_one(dtype):
    x = np.full((LANES, 3), np.nan, dtype)
    none = np.zeros((LANES, 3))
    planes = planes_of(none, np.tile(UP, (LANES, 1)), none, none).astype(dtype)
    lift(x, planes, dtype(CLEARANCE_M), np.empty(LANES, dtype))
    assert np.isnan(x).all(), "the guard of the frame sees it"
