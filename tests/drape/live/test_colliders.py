"""Cloth against colliders: the engine and the readable distance, a strip that lies down, a sleeve that is pushed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.contact.projection import CLEARANCE_M
from drape.engine.calls import call
from drape.engine.library import LANES
from drape.geometry.colliders import box, capsule, distances, plane
from drape.live.clock import Frame
from drape.live.colliders import leave
from drape.live.fold_step import FoldEffort, FoldMemory, fold
from drape.live.swing_step import SwingMemory, swing
from tests.drape.live.folds_setup import constants as sleeve_constants
from tests.drape.live.folds_setup import frame as sleeve_frame
from tests.drape.live.folds_setup import planes_of, sleeve
from tests.drape.live.swing_setup import FAR_SKIN, LENGTH_M, constants, hanging

SEVERAL = np.stack(
    [
        plane([0.1, 1.0, 0.0], -0.3),
        box([0.1, 0.2, 0.0], [0.4, 0.3, 0.5], [0.3, 0.2, 0.1]),
        capsule([0.0, 0.0, 0.0], [0.4, 0.0, 0.0], 0.2),
    ]
)
UP = np.array([0.0, 1.0, 0.0])
POINTS = np.random.default_rng(5).uniform(-0.6, 0.6, (300, 3))
FLOOR_M, THIN_M = -0.35, 0.003
NOWHERE = np.zeros(3)


def outside(collider: np.ndarray, point: np.ndarray) -> tuple[float, np.ndarray]:
    """The distance [m] of ``point`` to ``collider`` (16,), and the unit normal that leads out of it."""
    call("law_outside", np.float64, collider, point, found := np.empty(4))
    return float(found[0]), found[1:]


def entered(collider: np.ndarray, start: tuple[float, ...], end: tuple[float, ...]) -> tuple[float, np.ndarray]:
    """The distance [m] of ``end`` to the face by which the way from ``start`` enters ``collider``, and its normal."""
    call("law_entered", np.float64, collider, np.array(start), np.array(end), found := np.empty(4))
    return float(found[0]), found[1:]


@pytest.mark.parametrize("which", range(len(SEVERAL)))
def test_the_normal_is_the_gradient_of_the_distance(which: int):
    one, step = SEVERAL[which : which + 1], 1e-6
    for point in POINTS:
        distance, normal = outside(one[0], point)
        assert_allclose(distance, distances(one, point[None])[0], atol=1e-9)
        ahead = point + step * np.eye(3)
        slope = (distances(one, ahead) - distances(one, point - step * np.eye(3))) / (2.0 * step)
        if np.linalg.norm(slope) > 0.999:  # off the edges inside, where two faces are as near
            assert_allclose(normal, slope, atol=1e-3)


def test_a_way_into_a_box_enters_by_one_face():
    plate = box([0.0, 0.0, 0.0], [1.0, 0.1, 1.0])
    above = (0.1, 0.4, 0.0)
    assert_allclose(entered(plate, above, (0.2, -0.03, 0.0))[0], -0.08)
    assert_array_equal(entered(plate, above, (0.2, -0.03, 0.0))[1], [0.0, 1.0, 0.0])
    assert_allclose(entered(plate, above, (0.2, -0.3, 0.0))[0], -0.35)  # right through
    assert_array_equal(entered(plate, (0.9, 0.0, 0.1), (0.3, 0.0, 0.1))[1], [1.0, 0.0, 0.0])
    for end in [(0.2, 0.1, 0.0), (0.1, 0.6, 0.0), (1.5, 0.0, 0.0), (0.7, -0.2, 0.0)]:  # the last leaves by a side
        assert np.isinf(entered(plate, above, end)[0])
    assert np.isinf(entered(plate, (0.9, 0.4, 0.0), (0.9, -0.4, 0.0))[0]), "beside it"
    assert np.isinf(entered(capsule([0, 0, 0], [1, 0, 0], 0.1), above, (0.1, -0.4, 0.0))[0])


def test_a_node_has_the_planes_of_the_two_that_it_is_deepest_in():
    c = np.array([[0.0, -0.02, -0.01], [0.5, 0.5, 0.5]])
    walls = np.stack([plane([0, 0, 1.0], 0.0), plane([0, 1.0, 0], -0.3), plane([0, 1.0, 0], 0.0)])
    planes, touched = np.empty((2, 2, 4)), np.zeros(2, np.int32)
    came = c + np.array([0.0, 0.1, 0.1])
    given = (c, came, len(c), walls, len(walls), np.array(FAR_SKIN, np.float64), touched, planes)
    assert call("law_node_planes", np.float64, *given) == 1
    assert_allclose(planes[0], [[0, 1, 0, 0], [0, 0, 1, 0]], atol=1e-9)
    assert_array_equal(planes[1], np.zeros((2, 4)))


def test_cloth_leaves_but_not_from_below_the_skin_that_it_is_on():
    floor = plane([0.0, 1.0, 0.0], 0.0)[None]
    x = np.zeros((LANES, 3))
    x[:, 1] = np.linspace(-0.02, 0.02, LANES)
    free, near, worn = x.copy(), x.copy(), x.copy()
    leave(free, floor, CLEARANCE_M)
    assert_allclose(free[:, 1], np.maximum(x[:, 1], CLEARANCE_M), atol=1e-9)
    planes = planes_of(np.tile(UP, (LANES, 1)), -UP)
    call("law_leave", np.float64, near, LANES, floor, 1, planes, CLEARANCE_M)
    assert_array_equal(near, free)
    foot = np.tile(-0.01 * UP, (LANES, 1))  # skin a centimetre below the floor
    call("law_leave", np.float64, worn, LANES, floor, 1, planes_of(foot, -UP), CLEARANCE_M)
    assert_allclose(worn[:, 1], np.maximum(x[:, 1], CLEARANCE_M - 0.01 - THIN_M), atol=1e-9)


def test_a_collider_has_the_place_of_another_part_where_it_is_nearer():
    floor = plane([0.0, 1.0, 0.0], 0.0)[None]
    x = np.tile(0.004 * UP, (LANES, 1))
    x[: LANES // 2, 1] = 0.5
    far = np.full((LANES, 3), 9.0)
    planes = planes_of(far, UP, -1.0, UP)
    before = planes.copy()
    call("law_collider_planes", np.float64, x, LANES, floor, 1, planes)
    assert (planes != before).any()
    again = planes_of(far, UP, 0.002, UP)  # a part of the body that is nearer than the floor
    kept = again.copy()
    call("law_collider_planes", np.float64, x, LANES, floor, 1, again)
    assert_array_equal(again, kept)


def strip_frame(rest: np.ndarray, time_s: float, colliders: np.ndarray) -> Frame:
    return Frame(rest, FAR_SKIN, time_s, colliders)


def test_a_strip_that_comes_down_lies_on_the_floor_and_rests_there():
    rest, mesh = hanging()
    made, memory = constants(mesh), None
    floor, down = np.stack([plane([0.0, 1.0, 0.0], FLOOR_M - LENGTH_M + 0.2)]), 0.0
    x = rest
    for i in range(-1, 120):
        down = min(0.4, 0.02 * max(i, 0))  # its upper edge, to 0.2 m less than its length over the floor
        here = np.stack([floor[0]])
        here[:, 1:3] += down
        x, memory = swing(made, memory, strip_frame(rest, i / 30.0, here), np.array([0.0, -down, -down]))  # and aside
        assert distances(here, memory.swung).min() > -2e-3
    assert isinstance(memory, SwingMemory)
    before = memory.swung
    for i in range(120, 180):  # for two seconds, after which every bit is still
        x, memory = swing(made, memory, strip_frame(rest, i / 30.0, here), memory.origin)
    assert np.linalg.norm(memory.swung - before, axis=1).max() < 0.02
    assert_array_equal(memory.speed, 0.0)
    lengths = np.linalg.norm(np.diff(x.reshape(31, -1, 3)[:, 4], axis=0), axis=1)
    assert lengths.sum() > 0.85 * LENGTH_M, "it lies there at its length, but for its rounded bends"


def test_nothing_passes_through_a_thin_plate_however_fast():
    rest, mesh = hanging()
    made = constants(mesh)
    plate = box([0.08, -0.5, 0.1], [1.0, 0.8, 0.01])[None]
    memory = None
    for i in range(12):
        here = plate.copy()
        along = min(0.24, 0.12 * max(0, i - 1))
        here[:, 2] -= along
        _, memory = swing(made, memory, strip_frame(rest, i / 30.0, here), np.array([0.0, 0.0, along]))
        lowest = memory.swung[memory.network[:, 1] < -0.4]
        assert (lowest[:, 2] < here[0, 2]).all()


def test_a_frame_without_a_past_begins_where_it_lies():
    rest, mesh = hanging()
    floor = plane([0.0, 1.0, 0.0], FLOOR_M)[None]
    x, memory = swing(constants(mesh), None, strip_frame(rest, 0.0, floor), NOWHERE)
    assert distances(floor, memory.swung).min() > -2e-3
    assert np.abs(x - rest).max() > 0.1
    same, _ = swing(constants(mesh), None, strip_frame(rest, 0.0, plane([0.0, 1.0, 0.0], -2.0)[None]), NOWHERE)
    assert_array_equal(same, rest)


@pytest.mark.parametrize("steps", [0, 1])
def test_folds_end_outside_of_colliders(steps: int):
    made, one = sleeve_constants(), sleeve_frame(sleeve()[0], 0)
    wall = plane([-1.0, 0.0, 0.0], -0.045)[None]  # it cuts off a side of the sleeve and of the arm
    memory: FoldMemory | None = None
    for i in range(4):
        x, memory, report = fold(made, memory, replace(one, time_s=i / 30.0, colliders=wall), FoldEffort(steps))
        assert not report.reset
    skin = distances(wall, one.skin[:, :3]).min()
    assert skin < 0.0
    free, _, _ = fold(made, None, one, FoldEffort(steps))
    deepest = distances(wall, x).min()
    assert deepest > skin - THIN_M - 0.004 and deepest > distances(wall, free).min()
