"""What a card's threads may do at once: levels of a solve, and colours of blocks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from benchmarks.served import plan_of
from drape.engine.library import LANES
from drape.live.card import panel_levels
from drape.live.sheet import Sheet
from drape.live.two_level import TwoLevel
from drape.stages.folds import Folds
from service.compute.drape_runtime import DrapeRuntime
from tests.drape.live.conftest import still, tank  # noqa: F401
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.fixtures.serving import bare_settings


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrapeRuntime]:
    with closing(DrapeRuntime(bare_settings(tmp_path_factory.mktemp("none")))) as made:
        yield made


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
