"""Where a page makes its folds: a device that does not keep up is found out, and the service takes over."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clients.node import answer_of

# Frames of input.tookMs each, one every 40 ms; the clock is ours.
WATCHED = """
import { Pace } from "./pace.js";
let nowS = 100;
const pace = new Pace({ now: () => nowS });
const said = [];
for (let frame = 0; frame < input.frames; frame++) {
  pace.begin();
  nowS += input.tookMs[frame % input.tookMs.length] / 1000;
  if (pace.end()) said.push(frame);
  nowS += 0.04;
}
console.log(JSON.stringify({ said, slow: pace.slow, typicalMs: Math.round(1000 * pace.typicalS) }));
"""

# A wearing whose stream and decoder are ours: each frame takes input.tookS of a clock that is ours.
LEFT = """
import { Wearing } from "./wearing.js";
import { Pace } from "./pace.js";
import { Stream } from "./stream.js";
let nowS = 0;
const opened = [];
const makeStream = (heard) => new Stream({ base: "http://nowhere", ticket: async () => "", ...heard });
const drape = { makeStream, worn: new Set() };
const wearing = new Wearing(drape, ["tube"], { folds_by: "auto" });
wearing.pace = new Pace({ now: () => nowS });
wearing.options = { folds_by: "client", geometry: "jets" };
wearing.folds = {};
wearing.decoding = { decode: async () => ((nowS += input.tookS), [{}]), rest() {} };
const told = [];
wearing.onFolds = () => told.push(wearing.pace.typicalS);
wearing.stream.open = (request) => {
  opened.push(request);
  wearing.stream.opened = {};
  wearing.stream.onState(input.refused ? "refused" : "open", input.refused ? new Error("no") : null);
};
for (let frame = 0; frame < 100; frame++) {
  const header = { root: [0, 0, 0], residence_us: 0, dropped: 0 };
  wearing.stream.onFrame({ header, data: {}, pose: [], trans: [], bytes: 1, ageS: () => 0 });
  await new Promise((done) => setTimeout(done));
}
console.log(JSON.stringify({ by: wearing.foldsBy, told, opened, frames: wearing.stats.frames }));
"""


@pytest.mark.parametrize(
    ("took_ms", "slow"), [([8], False), ([33], False), ([50], True), ([8, 8, 200], False), ([60, 60, 8], True)]
)
def test_a_device_is_slow_whose_usual_frame_takes_longer_than_it_may(took_ms: list[int], slow: bool, tmp_path: Path):
    found = answer_of(WATCHED, {"tookMs": took_ms, "frames": 200}, tmp_path)
    assert found["slow"] is slow and len(found["said"]) == slow
    assert found["typicalMs"] == sorted(took_ms)[len(took_ms) // 2]


def test_nothing_is_decided_before_the_first_seconds_are_over(tmp_path: Path):
    found = answer_of(WATCHED, {"tookMs": [50], "frames": 33}, tmp_path)
    assert found["slow"] is None  # 33 frames of 90 ms
    assert answer_of(WATCHED, {"tookMs": [50], "frames": 200}, tmp_path)["said"] == [33]
    assert answer_of(WATCHED, {"tookMs": [500], "frames": 11}, tmp_path)["slow"] is None, "too few to tell"


def test_the_service_takes_over_from_a_slow_device_and_it_is_told(tmp_path: Path):
    found = answer_of(LEFT, {"tookS": 0.05}, tmp_path)
    assert found["by"] == "server" and found["told"] == [pytest.approx(0.05)]
    assert [one["folds_by"] for one in found["opened"]] == ["server"] and found["opened"][0]["geometry"] == "vertices"
    assert found["frames"] == 100, "frames go on"


def test_a_fast_device_keeps_its_folds(tmp_path: Path):
    found = answer_of(LEFT, {"tookS": 0.031}, tmp_path)
    assert (found["by"], found["told"], found["opened"]) == ("client", [], [])


def test_a_service_that_will_not_fold_leaves_them_where_they_are(tmp_path: Path):
    found = answer_of(LEFT, {"tookS": 0.05, "refused": True}, tmp_path)
    assert (found["by"], found["told"]) == ("client", [])
    assert found["opened"][-1]["folds_by"] == "client"
