"""A card's schedule, emulated: threads of one lane each leave what the engine leaves, in either order of loops."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.cases import FPS, at_rate
from benchmarks.served import Stream, plan_of
from drape.catalog import find_motions
from drape.engine.calls import call_with_scratch
from drape.engine.card_frames import CardRecord, Frames, Pool
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.live import fold_step
from drape.live.card import for_card, panel_levels
from drape.live.clock import Frame
from drape.live.fold_step import FoldEffort
from drape.live.sheet import Sheet
from drape.live.two_level import TwoLevel, two_level_call
from drape.motion.readers import read_motion
from drape.stages.folds import Folds
from service.compute.drape_runtime import DrapeRuntime
from tests.drape.live.conftest import still, tank  # noqa: F401
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.fixtures.paper_card import paper_card, turn_threads
from tests.fixtures.serving import bare_settings

THREADS, FRAMES = 256, 8


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrapeRuntime]:
    with closing(DrapeRuntime(bare_settings(tmp_path_factory.mktemp("none")))) as made:
        yield made


def drawn(
    pool: Pool, name: str, vertices: np.ndarray, given_records: tuple[Record, Record, Record], cloth: CardRecord,
    after: Record,
) -> list[list[np.ndarray]]:  # fmt: skip
    """What both orders leave of a frame: vertices, what is told in whole numbers, and the memory after it."""
    found = []
    for backwards in (False, True):
        turn_threads(backwards)
        frames, left = Frames(pool), CardRecord(pool, after, blank=True)
        given = [CardRecord(pool, one) for one in given_records]
        frames.add(name, vertices, *given[:2], cloth, given[2], left)
        frames.draw(THREADS)
        ((folded, told),) = frames.drawn()
        found.append([folded, told[:4], *left.arrays()])
        frames.give()
        for one in (*given, left):
            one.give()
    return found


class Beside:
    """Frames by the engine, and from the same memory by the emulated card: whether they and what they leave are the
    same, bit by bit."""

    def __init__(self) -> None:
        self.frames, self.names = 0, set[str]()
        self._pool = Pool(paper_card(), 512 << 20)
        self._placed = cache(lambda cloth: CardRecord(self._pool, for_card(cloth)))

    def __call__(self, name: str, dtype: Any, *given: Any) -> int:
        vertices, past, around, cloth, effort, after, out, told = given
        found = drawn(self._pool, name, vertices, (past, around, effort), self._placed(cloth), after)
        returned = call_with_scratch(name, dtype, *given)
        for one, other, wanted in zip(*found, [out, told[:4], *after.arrays], strict=True):
            assert one.tobytes() == other.tobytes(), "two threads race"
            assert one.tobytes() == wanted.tobytes()
        self.frames += 1
        self.names.add(name)
        return returned


CASES = (
    ("fast", ["shirt"], "fold_two_levels"),
    ("balanced", ["shorts", "tank"], "fold_two_levels"),
    ("accurate", ["tank"], "fold"),
    ("instant", ["dress"], "lift_alone"),
)


@each(case=CASES)
def test_a_frame_of_the_card_is_the_engines(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch, case: Any):
    """A walk, whose first frames settle; cloth with creases, and that touches itself, the skin and the layer below."""
    follow(runtime, monkeypatch, case, FRAMES)


@pytest.mark.long
@each(case=CASES)
def test_so_are_three_hundred(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch, case: Any):
    follow(runtime, monkeypatch, case, 300)


def follow(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch, case: Any, frames: int) -> None:
    """So many frames of a walk that goes to and fro, each from the engine's memory."""
    tier, names, name = case
    plan = plan_of(runtime, [shipped(one) for one in names], tier=tier, fabric="jersey", motion=0.0)
    beside = Beside()
    monkeypatch.setattr(fold_step, "call_with_scratch", beside)
    stream = Stream(plan, runtime.body.shape_count, staged=True)
    poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
    poses = np.concatenate([poses, poses[-2:0:-1]])
    for number in range(frames):
        stream.pose(poses[number % len(poses)], number / FPS)
    assert beside.names == {name} and beside.frames == frames * len(names)


@each(effort=(FoldEffort(2, settle=2, cloth_contact=True), FoldEffort(0)))
def test_a_rough_frame_among_colliders_is_the_engines(tank, still, rng, monkeypatch, effort):  # noqa: F811
    """A box before the chest, and cloth that crosses itself in hundreds of places."""
    middle = still.vertices.mean(axis=0) + np.array([0.0, 0.1, 0.1])
    box = np.concatenate([middle, np.eye(3).reshape(-1), [0.3, 0.05, 0.05], [0.0]])[None]
    rough = (still.vertices + 0.01 * rng.normal(size=still.vertices.shape)).astype(np.float32)
    beside, memory = Beside(), None
    monkeypatch.setattr(fold_step, "call_with_scratch", beside)
    for number in range(3):
        frame = replace(still, vertices=rough, time_s=number / FPS, colliders=box)
        vertices, memory, _ = tank.fold(memory, frame, effort)
    free, _, _ = tank.fold(None, replace(still, vertices=rough), effort)
    assert beside.frames == 4
    assert np.abs(vertices - free).max() > 0.005


def test_a_solve_of_a_card_waits_twice_a_level(tank: TwoLevel):  # noqa: F811
    """What a panel leaves has one place each, and is read in levels above its own."""
    factor = tank.levels.coarse.factor
    levels, columns = panel_levels(factor), len(factor.place)
    assert len(levels.row_start) == len(levels.column_start) <= 13
    found = levels.to[levels.to >= 0]
    assert np.array_equal(np.sort(found), np.arange(levels.left[-1] + columns)) and len(found) == factor.size.sum()
    level = np.empty(columns, np.int64)
    level[levels.column] = np.repeat(np.arange(len(levels.column_start) - 1), np.diff(levels.column_start))
    for panel, (start, size) in enumerate(zip(factor.start, factor.size, strict=False)):
        own, member = level[factor.column[panel]], factor.member[start : start + size]
        assert (level[member[member >= factor.column[panel + 1]]] > own).all()


def test_threads_that_race_give_other_numbers(tank: TwoLevel, still: Frame):  # noqa: F811
    """With one colour for all blocks the two orders differ: the emulation sees what a card would do wrong."""
    levels = for_card(tank.levels)
    once = np.array([0, len(levels.fine.sheet.fan_start) - 1], np.int32)
    torn = replace(levels, fine=levels.fine._replace(sheet=levels.fine.sheet._replace(colour_start=once)))
    around, effort = Record("Surroundings", still.around(np.dtype(np.float32))), FoldEffort(1, settle=1)
    for cloth, is_same in ((levels, True), (torn, False)):
        asked = two_level_call(cloth, None, 0.0)
        pool = Pool(paper_card(), 512 << 20)
        placed = CardRecord(pool, cloth)
        given = asked.past, around, fold_step.recorded(effort)
        one, other = drawn(pool, asked.name, still.vertices, given, placed, asked.after)
        assert np.array_equal(one[0], other[0]) is is_same


@each(name=("tshirt", "dress"))
def test_no_two_blocks_of_a_colour_touch(runtime: DrapeRuntime, name: str):
    """What a block reads besides itself is of other colours, so that a card may move a colour at once."""
    plan = plan_of(runtime, [shipped(name)], tier="balanced")
    (folds,) = (stage for stage in plan.stages if isinstance(stage, Folds))
    made = folds.constants(plan.draped_keys[0], plan.fabrics[0], coarse=True)
    assert isinstance(made, TwoLevel)
    levels = made.levels
    for sheet in (levels.coarse.sheet, levels.fine.sheet):
        assert 1 < len(sheet.colour_start) <= 16 and sheet.colour_start[-1] == len(sheet.fan_start) - 1
        for block, read in _reads(sheet):
            other = block != read
            first, second = (np.searchsorted(sheet.colour_start, of[other], side="right") for of in (block, read))
            assert (first != second).all()


def _reads(sheet: Sheet) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blocks, and the blocks of places that they read: of triangles, of flat hinges and of creases."""
    for start, other, rows in ((sheet.fan_start, sheet.fan_other, 2), (sheet.bend_start, sheet.bend_other, 1)):
        block = np.repeat(np.arange(len(start) - 1), rows * LANES * np.diff(start))
        own = np.tile(np.arange(LANES), len(other) // LANES)
        real = other != LANES * block + own
        yield block[real], other[real] // LANES
    corner = sheet.creases.corner[sheet.crease_member // 4]
    yield (
        np.repeat(np.arange(len(sheet.crease_start) - 1), 4 * np.diff(sheet.crease_start)),
        corner.reshape(-1) // LANES,
    )
