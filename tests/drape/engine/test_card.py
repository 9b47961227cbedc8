"""A card's schedule, emulated: threads of one lane each leave what the engine leaves, in either order of loops."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.cases import FPS, at_rate
from benchmarks.served import Stream, plan_of
from drape.catalog import find_motions
from drape.engine.calls import call, call_with_scratch
from drape.engine.card import CardRecord, Frames
from drape.engine.library import LANES
from drape.engine.packer import Record, address_of
from drape.live import fold_step
from drape.live.card import for_card
from drape.live.clock import Frame
from drape.live.fold_step import FoldEffort
from drape.live.sheet import Sheet
from drape.live.two_level import TwoLevel, two_level_call
from drape.motion.readers import read_motion
from drape.stages.folds import Folds
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.drape.live.conftest import still, tank  # noqa: F401
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each

WITHIN_M = 1e-7  # of a frame from the same memory
THREADS, FRAMES = 256, 12


@pytest.fixture(scope="module")
def runtime() -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(Settings(threads=1))
    yield made
    made.close()


class Emulated:
    """A card that is this processor: its memory, and threads as loops from the first or ``backwards``."""

    def __init__(self) -> None:
        self._taken, self.backwards = list[np.ndarray](), False

    def take(self, size: int) -> int:
        self._taken.append(np.zeros(max(size, 1), np.uint8))
        return address_of(self._taken[-1])

    def write(self, address: int, numbers: np.ndarray) -> None:
        ctypes.memmove(address, address_of(numbers), numbers.nbytes)

    def read(self, address: int, numbers: np.ndarray) -> None:
        ctypes.memmove(address_of(numbers), address, numbers.nbytes)

    def folds(self, tasks: int, count: int, threads: int, rounds: int = 1) -> float:
        for _ in range(rounds):
            call("emulated_folds", np.float32, tasks, count, threads, self.backwards)
        return 0.0


def drawn(
    name: str, vertices: np.ndarray, past: Record, around: Record, cloth: CardRecord, effort: Record, after: Record
) -> list[list[np.ndarray]]:
    """What both orders leave of a frame: vertices, what is told in whole numbers, and the memory after it."""
    found = []
    for backwards in (False, True):
        memory = Emulated()
        memory.backwards, left = backwards, CardRecord(memory, after)
        frames = Frames(memory)
        before = [CardRecord(memory, one) for one in (past, around)]
        frames.add(name, vertices, *before, cloth, CardRecord(memory, effort), left)
        frames.draw(THREADS)
        ((folded, told),) = frames.drawn()
        found.append([folded, told[:4], *left.arrays()])
    return found


class Beside:
    """Frames by the engine, and from the same memory by the emulated card: how far they are apart at most [m]."""

    def __init__(self) -> None:
        self.off_m, self.frames, self.names = 0.0, 0, set[str]()
        self._placed = cache(lambda cloth: CardRecord(self._memory, for_card(cloth)))
        self._memory = Emulated()

    def __call__(self, name: str, dtype: Any, *given: Any) -> int:
        vertices, past, around, cloth, effort, after, out, told = given
        found = drawn(name, vertices, past, around, self._placed(cloth), effort, after)
        returned = call_with_scratch(name, dtype, *given)
        for one, other, wanted in zip(*found, [out, told[:4], *after.arrays], strict=True):
            assert one.tobytes() == other.tobytes(), "two threads race"
            if wanted.dtype.kind == "f":
                self.off_m = max(self.off_m, float(np.abs(one - wanted).max(initial=0.0)))
            else:
                assert np.array_equal(one, wanted)
        self.frames += 1
        self.names.add(name)
        return returned


@each(
    case=(
        ("fast", ["shirt"], "fold_two_levels"),
        ("balanced", ["tshirt", "trousers"], "fold_two_levels"),
        ("accurate", ["tank"], "fold"),
        ("instant", ["dress"], "lift_alone"),
    )
)
def test_a_frame_of_the_card_is_the_engines(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch, case: Any):
    """A walk, whose first frames settle; cloth with creases, and that touches itself, the skin and the layer below."""
    tier, names, name = case
    plan = plan_of(runtime, [shipped(one) for one in names], tier=tier, fabric="jersey", motion=0.0)
    beside = Beside()
    monkeypatch.setattr(fold_step, "call_with_scratch", beside)
    stream = Stream(plan, runtime.body.shape_count, staged=True)
    for number, pose in enumerate(at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses[:FRAMES]):
        stream.pose(pose, number / FPS)
    assert beside.names == {name} and beside.frames == FRAMES * len(names)
    assert beside.off_m <= WITHIN_M


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
    assert beside.frames == 4 and beside.off_m <= WITHIN_M
    assert np.abs(vertices - free).max() > 0.005


def test_threads_that_race_give_other_numbers(tank: TwoLevel, still: Frame):  # noqa: F811
    """With one colour for all blocks the two orders differ: the emulation sees what a card would do wrong."""
    levels = for_card(tank.levels)
    once = np.array([0, len(levels.fine.sheet.fan_start) - 1], np.int32)
    torn = replace(levels, fine=levels.fine._replace(sheet=levels.fine.sheet._replace(colour_start=once)))
    around, effort = Record("Surroundings", still.around(np.dtype(np.float32))), FoldEffort(1, settle=1)
    for cloth, is_same in ((levels, True), (torn, False)):
        asked = two_level_call(cloth, None, 0.0)
        placed = CardRecord(Emulated(), cloth)
        one, other = drawn(
            asked.name, still.vertices, asked.past, around, placed, fold_step.recorded(effort), asked.after
        )
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
