"""Limbs that move a garment by less than a client asks for: the last frame comes again, and nothing is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.geometry.rotations import rotvec_to_matrix
from drape.wire import messages as wire
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from service.stages.batch import Plan
from service.stages.joint_reach import ARMS_DOWN, reach_m, turns_rad
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import TINY_DYNAMIC
from tests.service.compute.test_unchanged import NEEDED, POSES, Stream

HAND = 22


@pytest.fixture(scope="module")
def runtime(make_settings: Callable[..., Settings]) -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(make_settings(model=TINY_DYNAMIC, inertia="mesh"))
    yield made
    made.close()


def planned(runtime: DrapeRuntime, **options: object) -> Plan:
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions.model_validate(options), messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    return plan


def turned(joint: int, turn_rad: float) -> np.ndarray:
    pose = POSES[0].copy()
    pose[joint, 2] += turn_rad
    return pose


def moved_mm(plan: Plan, pose: np.ndarray) -> float:
    return 1e3 * sum(stage.moved_m(plan, POSES[0], pose) for stage in plan.stages)


def test_the_reach_of_a_joint_is_how_far_it_moves_the_furthest_vertex():
    def draped(poses: np.ndarray) -> np.ndarray:
        """Two vertices: the joint 5 moves one by 3 mm a radian, and 7, where the arms hang, by 8 about y."""
        hang = poses[:, ARMS_DOWN[0][0], 2] != 0.0
        found = np.zeros((len(poses), 2, 3))
        found[:, 0, 1] = 3e-3 * poses[:, 5, 0] + 2e-3 * poses[:, 5, 2]
        found[:, 1, 2] = 8e-3 * poses[:, 7, 1] * hang
        return found

    found = reach_m(draped)
    assert_allclose(found[[5, 7]], [3e-3, 8e-3], atol=1e-12)
    others = np.delete(found, [5, 7])
    assert not others.any()


def test_turns_are_the_angles_between_rotations():
    before, after = random_motion(2, spread_rad=2.0)[0]
    apart = np.swapaxes(rotvec_to_matrix(before), -1, -2) @ rotvec_to_matrix(after)
    expected = np.arccos(np.clip((np.trace(apart, axis1=-2, axis2=-1) - 1.0) / 2.0, -1.0, 1.0))
    assert_allclose(turns_rad(before, after), expected, atol=1e-7)
    full = np.zeros((24, 3))
    full[:, 1] = 2.0 * np.pi
    assert_allclose(turns_rad(np.zeros((24, 3)), full), 0.0, atol=1e-12)


def test_a_limb_within_the_tolerance_is_a_still_frame_and_one_beyond_is_not(runtime: DrapeRuntime):
    measured = planned(runtime, still_mm=1.0)
    turn = 0.3
    away = moved_mm(measured, turned(HAND, turn))
    assert 0.0 < away < moved_mm(measured, turned(0, turn)), "the whole body moves it further than a hand"
    stream = Stream(runtime, planned(runtime, still_mm=1.01 * away))
    for _ in range(NEEDED):
        last = stream.next()
    same = stream.next(turned(HAND, turn))
    assert stream.runs == NEEDED
    assert_array_equal(wire.unpack_frame(same).positions, wire.unpack_frame(last).positions)
    stream.next(turned(HAND, 1.1 * turn))
    assert stream.runs == NEEDED + 1


def test_what_is_let_pass_does_not_add_up(runtime: DrapeRuntime):
    away = moved_mm(planned(runtime, still_mm=1.0), turned(HAND, 0.3))
    stream = Stream(runtime, planned(runtime, still_mm=1.01 * away))
    for _ in range(NEEDED):
        stream.next()
    for step in range(1, 7):
        stream.next(turned(HAND, 0.1 * step))
    assert stream.runs == NEEDED + 3, "counted from the pose that was computed last, not from the frame before"


@pytest.mark.parametrize("options", [{}, {"still_mm": 0.0}, {"still_mm": 1e6, "inertia": "network"}])
def test_without_a_tolerance_and_with_the_networks_motion_any_change_is_computed(runtime: DrapeRuntime, options: dict):
    stream = Stream(runtime, planned(runtime, **options))
    for _ in range(NEEDED):
        stream.next()
    stream.next(turned(HAND, 1e-9))
    assert stream.runs == NEEDED + 1


def test_what_was_not_measured_counts_as_moved(runtime: DrapeRuntime):
    tube = runtime.garments.get("tube")
    plan = runtime.plan(tube, DrapeOptions(still_mm=1.0, fabric="denim", passes=0), messages=True)
    assert np.isinf(moved_mm(plan, turned(HAND, 1e-6)))
