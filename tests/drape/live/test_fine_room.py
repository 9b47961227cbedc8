"""Room between sheets of the fine cloth: found where the coarse cloth is near itself, as the readable way finds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES
from drape.geometry.closest import closest_point
from drape.geometry.triangle_pairs import crossing_pairs
from drape.live.clock import Frame
from drape.live.fold_step import FoldEffort
from drape.live.room import ROOM_M
from drape.live.two_level import TwoLevel
from tests.fixtures.garments import shipped
from tests.reference.folds import KEPT, KEPT_M, SPACING

ROWS, OTHER, NEAR = 19, 6, 18  # of a block of planes: all, those of the other plane, that of cloth that is near


def pressed(still: Frame, share: float) -> Frame:
    """The tank of ``still`` pressed flat to ``share`` of its depth, far from any body."""
    flat = still.vertices * np.array([1.0, 1.0, share], np.float32) + np.array([0.0, 0.0, 5.0], np.float32)
    return replace(still, vertices=flat.astype(np.float32))


def readable_planes(made: TwoLevel, x: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Point and normal (P, 6) of the plane of every fine place; ``near`` (C,) are the coarse ones that look for one."""
    fine, coarse = made.levels.fine, made.levels.coarse
    constants, lists, vertex = fine.sheet.constants, coarse.neighbours, coarse.sheet.vertex[fine.parent]
    reach, kept = (min(share / float(constants.per_edge), most) for share, most in ((SPACING, ROOM_M), (KEPT, KEPT_M)))
    chosen, found = np.flatnonzero(near[fine.parent]), np.zeros((len(x), 6))
    triangles = fine.sheet.place[shipped("tank").faces]
    for p in chosen:
        far = np.linalg.norm(x[chosen] - x[p], axis=1)
        entries = slice(*lists.start[vertex[p] : vertex[p] + 2])
        of_sheet = dict(zip(lists.vertex[entries], lists.square[entries], strict=True))
        beside = np.array([far[n] ** 2 >= of_sheet.get(vertex[q], np.inf) for n, q in enumerate(chosen)])
        far[beside | ~(far < reach)] = np.inf
        if not np.isfinite(far.min()):
            continue
        own = triangles[(triangles == chosen[far.argmin()]).any(axis=1)]
        (there,) = closest_point(x[p, None], x, own).point
        room = np.linalg.norm(x[p] - there)
        if 0.0 < room < kept:
            normal = (x[p] - there) / room
            found[p] = *(x[p] - (0.5 * (room - kept) + constants.gap) * normal), *normal
    return found


def test_planes_equal_the_readable_ones(tank: TwoLevel, still: Frame):
    fine = tank.levels.fine
    x = pressed(still, 0.02).vertices[fine.sheet.vertex]
    near = still.vertices[tank.levels.kept, 0] > 0.0
    rows = np.zeros((len(near) // LANES, ROWS, LANES), np.float32)
    rows[:, NEAR] = near.reshape(-1, LANES)
    planes = np.zeros((len(x) // LANES, ROWS, LANES), np.float32)
    call_with_scratch("law_fine_room", np.float32, np.concatenate([x, x[:1]]), rows, tank.levels, planes)
    found = planes[:, OTHER : OTHER + 6].transpose(0, 2, 1).reshape(-1, 6)
    wanted = readable_planes(tank, x.astype(np.float64), near)
    held = wanted.any(axis=1)
    assert_array_equal(found.any(axis=1), held)
    assert_allclose(found, wanted, atol=2e-4)
    assert 50 < held.sum() < len(x) // 2


def test_cloth_that_is_pressed_together_crosses_itself_less(tank: TwoLevel, still: Frame):
    """Of pairs of triangles 58 cross where the fine cloth has the planes of the coarse one alone, else 41."""
    one, memory, x = pressed(still, 0.3), None, still.vertices
    one = replace(one, vertices=one.vertices * np.array([1.0, 0.8, 1.0], np.float32))
    for number in range(12):
        frame = replace(one, time_s=number / 30.0)
        x, memory, _ = tank.fold(memory, frame, FoldEffort(steps=4, settle=2, cloth_contact=True))
    assert len(crossing_pairs(x.astype(np.float64), shipped("tank").faces)) < 46
