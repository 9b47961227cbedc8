"""Functions of the engine that are timed: counted by stage, put back afterwards, and weighed by their arrays."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import frame
from benchmarks.speed import kernel_times
from benchmarks.speed.kernel_times import PYTHON, Trace, moved_bytes, multiply_adds, replaced
from drape.engine import calls
from drape.engine.packer import Record
from drape.geometry.colliders import NONE
from drape.graph.blend import Tiles
from drape.live import colliders
from drape.live.clock import Surroundings

POINTS = np.zeros((16, 3), np.float32)


def test_calls_are_counted_by_stage_and_put_back():
    trace = Trace()
    with replaced(trace.timed) as count:
        assert count > 2 and colliders.call is not calls.call
        trace.begin()
        for _ in range(2):
            colliders.leave(POINTS, NONE, 0.0)
        trace.took("colliders", 0.0)
        colliders.leave(POINTS, NONE, 0.0)
        trace.took("folds", 0.0)
    assert colliders.call is calls.call
    (spent,) = trace.frames()
    assert {key: found[0] for key, found in spent.items()} == {
        ("colliders", "leave"): 2, ("colliders", PYTHON): 1, ("folds", "leave"): 1, ("folds", PYTHON): 1,
    }  # fmt: skip
    assert all(found[1] >= 0.0 and found[2] > 0.0 for found in spent.values())


def test_a_call_moves_each_of_its_arrays_once():
    skin = np.zeros((4, 8), np.float32)
    around = Record("Surroundings", Surroundings(skin, np.zeros((1, 16))))
    assert moved_bytes((POINTS, (around, 3, POINTS)), skin) == POINTS.nbytes + skin.nbytes + 16 * 8
    tiles = Tiles(POINTS, np.zeros((2, 18, 32)), POINTS, POINTS, POINTS)
    assert multiply_adds("vertices", ((), tiles)) == 3 * 2 * 18 * 32
    assert multiply_adds("leave", (POINTS,)) == 0


def test_the_floor_is_the_longer_of_bytes_and_multiply_adds(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(frame, "copied_per_s", lambda moved: 1e9)
    monkeypatch.setattr(frame, "multiply_adds_per_s", lambda: 1e10)
    assert frame.floor_ms(2_000_000, 1_000_000) == pytest.approx(2.0)
    assert frame.floor_ms(2_000_000, 100_000_000) == pytest.approx(10.0)
    assert frame.floor_ms(0, 0) == 0.0


def test_a_copy_is_as_fast_as_others_of_its_size():
    assert kernel_times.copied_per_s(5000) == kernel_times.copied_per_s(8192) > 1e6
