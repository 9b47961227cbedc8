"""Cloth without folds: it is eased by steps of the whole, goes along with the surface, and is lifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.engine.calls import call_with_scratch
from drape.live.clock import PAUSE_S, Frame
from drape.live.eased import LiftMemory
from drape.live.fold_step import FoldEffort
from drape.live.two_level import TwoLevel
from tests.drape.live.folds_setup import CUT_M, FAR_M, spared
from tests.drape.live.tank_setup import strain

IDLE = FoldEffort(0, clearance_m=0.004)
EASED_S = 0.65  # in which what eased cloth comes down to 1/e


def turned(frame: Frame, angle_rad: float) -> Frame:
    """``frame`` turned about y, with its skin."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    skin = frame.skin.copy()
    skin[:, :3], skin[:, 4:7] = frame.skin[:, :3] @ turn, frame.skin[:, 4:7] @ turn
    return replace(frame, vertices=(frame.vertices @ turn).astype(np.float32), skin=skin)


def eased(made: TwoLevel, still: Frame, before: np.ndarray, share: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """How far (V, 3) ``steps`` move the coarse cloth from the drape of ``still``, with a ``share`` of what it was eased
    ``before`` (P, 3): in the frames of the surface, and in the world's axes."""
    levels, skin = made.levels, np.ascontiguousarray(still.skin, np.float32)
    under, coarse = spared(still.vertices[levels.kept]), levels.coarse
    found = np.empty_like(under), np.empty_like(under)
    given = (share, coarse.index, skin, len(skin), coarse, steps, *found)
    call_with_scratch("law_ease_off", np.float32, under, before, *given)
    return found[0][coarse.sheet.place], found[1][coarse.sheet.place]


def test_a_step_lowers_the_strain_and_frames_lower_it_further(tank: TwoLevel, still: Frame):
    memory, found = None, []
    for number in range(12):
        vertices, memory, report = tank.fold(memory, replace(still, time_s=number / 30.0), IDLE._replace(settle=1))
        assert report.settled == (number == 0) and not report.reset
        found.append(vertices)
    strains = [strain(each) for each in (still.vertices, found[0], found[-1])]
    assert strains[0] > 1.2 * strains[1] and strains[1] > 1.1 * strains[2]
    settled, _, _ = tank.fold(None, still, IDLE)
    assert strains[2] < strain(settled) < strains[1], "a frame without a past takes more steps"
    assert np.abs(found[-1] - found[-2]).max() < 0.2 * np.abs(found[1] - found[0]).max(), "it comes to rest"


def test_what_was_eased_turns_with_the_body_and_fades(tank: TwoLevel, still: Frame):
    angle, later_s = 0.1, 1.0 / 30.0
    _, memory, _ = tank.fold(None, still, IDLE)
    assert isinstance(memory, LiftMemory)
    here, _, _ = tank.fold(memory, replace(still, time_s=later_s), IDLE)
    there, _, _ = tank.fold(memory, replace(turned(still, angle), time_s=later_s), IDLE)
    assert_allclose(turned(replace(still, vertices=here), angle).vertices, there, atol=2e-5)
    share, place = np.exp(-later_s / EASED_S), tank.levels.coarse.sheet.place
    kept, _ = eased(tank, still, memory.eased, share, 0)
    assert_allclose(kept, share * memory.eased[place], atol=1e-6)


def test_cloth_beside_another_part_of_the_body_goes_out_of_it(tank: TwoLevel, still: Frame):
    """A patch of skin from far away is held 5 mm outside a vertex, with its inside towards the cloth."""
    graph, skin, v = tank.levels.coarse.graph, still.skin.copy(), int(still.vertices[:, 2].argmax())
    s = int(np.linalg.norm(skin[:, :3] - still.vertices[v], axis=1).argmax())
    patch = np.unique(np.append(graph.neighbour.reshape(len(skin), -1)[s], s))
    normal = np.array([0.0, 0.0, -1.0])
    skin[patch, :3] += still.vertices[v] + 0.002 * normal - skin[s, :3]
    skin[patch, 4:7] = normal
    for beside in (False, True):
        found, memory = still.vertices, None
        for number in range(10):
            frame = replace(still, skin=skin if beside else still.skin, time_s=number / 30.0)
            found, memory, _ = tank.fold(memory, frame, IDLE)
        above_m = float((found[v] - skin[s, :3]) @ normal)
        assert (above_m > 0.0) == beside, above_m


def test_a_jump_is_told(tank: TwoLevel, still: Frame):
    _, memory, _ = tank.fold(None, still, IDLE)
    far = replace(still, vertices=still.vertices + np.float32(1.01 * CUT_M), time_s=1.0 / 30.0)
    report = tank.fold(memory, far, IDLE)[2]
    assert report.settled and report.reset


def test_what_is_no_fold_is_left_out(tank: TwoLevel, still: Frame):
    _, memory, _ = tank.fold(None, still, IDLE)
    assert isinstance(memory, LiftMemory)
    for wrong in (np.nan, 4.0 * FAR_M):
        torn = replace(memory, eased=np.full_like(memory.eased, wrong))
        vertices, after, _ = tank.fold(torn, replace(still, time_s=1.0 / 30.0), IDLE._replace(clearance_m=0.0))
        assert_array_equal(vertices, still.vertices)
        assert isinstance(after, LiftMemory) and not after.eased.any()


def test_the_same_input_gives_the_same_bits_and_a_pause_begins_anew(tank: TwoLevel, still: Frame):
    first, memory, _ = tank.fold(None, still, IDLE)
    assert isinstance(memory, LiftMemory)
    kept = memory.eased.copy()
    again = [tank.fold(memory, replace(still, time_s=1.0 / 30.0), IDLE)[0] for _ in range(2)]
    assert_array_equal(again[0], again[1])
    assert_array_equal(memory.eased, kept)
    late, _, report = tank.fold(memory, replace(still, time_s=2.0 * PAUSE_S), IDLE)
    assert report.settled
    assert_array_equal(late, first)


@pytest.mark.parametrize("clearance_m", [0.0, 0.004])
def test_cloth_is_lifted_after_it_was_eased(tank: TwoLevel, still: Frame, clearance_m: float):
    vertices, _, told = tank.fold(None, still, FoldEffort(0, clearance_m=clearance_m))
    assert (told.lifted_share > 0.0) == (clearance_m > 0.0)
    assert np.isfinite(vertices).all()


def test_more_steps_move_the_cloth_further_and_none_leave_it(tank: TwoLevel, still: Frame):
    none = np.zeros((len(tank.levels.kept), 3), np.float32)
    ways = [np.linalg.norm(eased(tank, still, none, 0.0, steps)[1], axis=1).mean() for steps in (0, 1, 8)]
    assert ways[0] == 0.0 and 1e-4 < ways[1] < ways[2] < 0.02
