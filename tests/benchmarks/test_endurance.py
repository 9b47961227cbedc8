"""The endurance table counts what it says, on a few frames of the real road."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks import endurance, scenes
from benchmarks.endurance import COLUMNS, endure, main, totals
from benchmarks.scenes import Clip, Scene
from drape.cloth.fabric_table import fabric
from tests.benchmarks.quality_setup import bending, body, network
from tests.fixtures.garments import tube_garment

FRAMES = 6


def moving() -> Scene:
    return Scene(tube_garment(body()), fabric("jersey"), Clip.of("bend", 30.0, bending(FRAMES), body()))


def test_the_quick_form_goes_through_a_clip():
    record = main(["--quick", "--threads", "1"])
    (whole,) = record["rows"]
    assert whole.keys() == COLUMNS.keys() and record["clips"] == ["walk"]
    assert (whole["clip"], whole["worst"], whole["frames"]) == ("all", "walk", endurance.QUICK_FRAMES)
    assert whole["resets"] == whole["broken"] == 0
    assert 0.0 <= whole["long_pct"] < 1.0 and 1.0 < whole["longest"] < 3.0


def test_long_edges_are_counted_against_the_rest(monkeypatch: pytest.MonkeyPatch):
    row = endure(moving(), network(), 1)
    monkeypatch.setattr(endurance, "LONG", 0.0)
    every = endure(moving(), network(), 1)
    assert every["long_pct"] == every["network_long_pct"] == 100.0
    monkeypatch.setattr(endurance, "LONG", row["longest"])
    assert endure(moving(), network(), 1)["long_pct"] == 0.0
    monkeypatch.setattr(endurance, "CHUNK", 4)
    cut = endure(moving(), network(), 1)
    assert cut["longest"] == pytest.approx(row["longest"], rel=1e-5)  # the network's batches are of another size


def test_a_frame_that_is_not_finite_is_begun_anew_and_counted(monkeypatch: pytest.MonkeyPatch):
    fold, seen = scenes.fold, []

    def spoilt(made, memory, frame, effort):
        seen.append(memory)
        if len(seen) == 3:
            memory = dataclasses.replace(memory, residual=np.full_like(memory.residual, np.nan))
        return fold(made, memory, frame, effort)

    monkeypatch.setattr(scenes, "fold", spoilt)
    row = endure(moving(), network(), 1)
    assert (row["resets"], row["broken"], row["frames"]) == (1, 0, FRAMES)


def test_totals_weigh_clips_by_their_frames():
    one = {"garment": "g", "fabric": "f", "fps": 30.0, "clip": "a", "frames": 10, "resets": 1, "broken": 0,
           "long_pct": 1.0, "network_long_pct": 0.0, "longest": 1.5}  # fmt: skip
    other = one | {"clip": "b", "frames": 30, "resets": 2, "long_pct": 3.0, "longest": 1.2}
    elsewhere = one | {"fps": 60.0}
    both, alone = totals([one, other, elsewhere])
    assert both == one | {"clip": "all", "frames": 40, "resets": 3, "long_pct": 2.5, "longest": 1.5, "worst": "a"}
    assert alone == elsewhere | {"clip": "all", "worst": "a"}
