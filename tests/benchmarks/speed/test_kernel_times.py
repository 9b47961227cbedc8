"""Kernels that are timed: counted by stage, put back afterwards, and weighed by their arrays."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import frame
from benchmarks.speed import rates
from benchmarks.speed.kernel_times import PYTHON, Trace, moved_bytes, multiply_adds, replaced
from drape.graph.blend import Tiles
from drape.live import places, two_level
from drape.network.dense import Layer

POINTS = np.zeros((16, 3), np.float32)


def test_kernels_are_counted_by_stage_and_put_back():
    before, trace = (places.moved_m, two_level.placed), Trace()
    index = np.arange(16, dtype=np.int32)
    places.placed(POINTS, index)  # compiled
    with replaced(trace.timed) as count:
        assert count > 2 and places.moved_m is not before[0]
        trace.begin()
        for _ in range(2):
            places.moved_m(POINTS, POINTS, index)
        trace.took("folds", 0.0)
        two_level.placed(POINTS, index)
        trace.took("swing", 0.0)
    assert (places.moved_m, two_level.placed) == before
    (spent,) = trace.frames()
    calls = {key: found[0] for key, found in spent.items()}
    assert calls == {
        ("folds", "places.moved_m"): 2, ("folds", PYTHON): 1,
        ("swing", "places.placed"): 1, ("swing", PYTHON): 1,
    }  # fmt: skip
    assert all(found[1] >= 0.0 and found[2] > 0.0 for found in spent.values())


def test_a_kernel_moves_each_of_its_arrays_once():
    layer = Layer(np.zeros((4, 3), np.float32), np.zeros(4, np.float32), np.float32(0.1), np.zeros(0, np.uint32))
    assert moved_bytes((POINTS, (layer, 3, POINTS)), POINTS) == POINTS.nbytes + 4 * 12 + 4 * 4
    tiles = Tiles(POINTS, np.zeros((2, 18, 32)), POINTS, POINTS)
    assert multiply_adds("blend.blend", ((), tiles)) == 3 * 2 * 18 * 32
    assert multiply_adds("places.moved_m", (POINTS,)) == 0


def test_the_floor_is_the_longer_of_bytes_and_multiply_adds(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(frame, "copied_per_s", lambda moved, threads: 1e9)
    monkeypatch.setattr(frame, "multiply_adds_per_s", lambda threads: 1e10)
    assert frame.floor_ms(2_000_000, 1_000_000) == pytest.approx(2.0)
    assert frame.floor_ms(2_000_000, 100_000_000) == pytest.approx(10.0)
    assert frame.floor_ms(0, 0) == 0.0


def test_a_copy_is_as_fast_as_others_of_its_size():
    assert rates.copied_per_s(5000, 1) == rates.copied_per_s(8192, 1) > 1e6
