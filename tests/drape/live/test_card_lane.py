"""A card's lane over a driver of paper: frames of many streams in a launch, and streams that outlive their card."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from drape.engine import card_frames
from drape.errors import Unavailable
from drape.live import card_lane
from drape.live.card_lane import Lane
from drape.live.clock import Frame
from drape.live.fold_step import FoldEffort
from drape.live.two_level import TwoLevel
from tests.drape.live.conftest import still, tank  # noqa: F401
from tests.fixtures.laws import each
from tests.fixtures.paper_card import fails, paper_card

EFFORT = FoldEffort(1, settle=1)


@pytest.fixture
def lane(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lane]:
    monkeypatch.setattr(card_lane, "LOST_S", 60.0)  # the emulation is slow
    monkeypatch.setattr(card_lane, "GATHERED_S", 0.03)  # and threads of a busy machine come late
    made = Lane(paper_card)
    yield made
    made.close()


def frames(tank: TwoLevel, still: Frame, lane: Lane | None, count: int, call: str = "") -> list[np.ndarray]:  # noqa: F811
    """So many frames of a stream whose drape sways. The driver's ``call`` fails from the last one on."""
    memory, found = None, []
    for number in range(count):
        if call and number == count - 1:
            fails(call)
        moved = np.float32(0.004 * np.sin(number)) * np.array([1, 0, 0], np.float32)
        frame = replace(still, vertices=still.vertices + moved, time_s=number / 30)
        vertices, memory, _ = tank.fold(memory, frame, EFFORT, lane.compute if lane else None)
        found.append(vertices)
    return found


def test_streams_share_launches_and_are_the_engines(lane: Lane, tank: TwoLevel, still: Frame):  # noqa: F811
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(lambda _: frames(tank, still, lane, 2), range(3)))
    wanted = frames(tank, still, None, 2)
    for stream in found:
        assert [one.tobytes() for one in stream] == [one.tobytes() for one in wanted]
    told = lane.report()
    assert told.frames == 6 and told.launches < told.frames and told.frames_a_launch > 1
    assert told.card == "Card of paper" and told.fault == "" and 0 < told.occupied < 1 and 0 < told.busy <= 1
    assert len(lane._left) == 3 and told.queue_s == 0.0  # what rests is what the streams' next frames read


@each(call=("cuMemcpyHtoD_v2", "cuLaunchKernel", "cuMemcpyDtoH_v2"))  # before, at and after a launch
def test_a_card_that_fails_in_a_frame_loses_nothing(lane: Lane, tank: TwoLevel, still: Frame, call: str):  # noqa: F811
    found = frames(tank, still, lane, 2, call)
    for one, other in zip(found, frames(tank, still, None, 2), strict=True):
        assert one.tobytes() == other.tobytes()  # by the processor, from what the host has
    assert lane.frames == 1 and not lane.works and lane.fault == f"Card of paper: {call}: unspecified launch failure"
    assert lane.room(card_frames.Record("FoldEffort", EFFORT)) == 0


def test_a_card_that_stops_is_given_up_within_a_second(tank, still):  # noqa: F811
    lane = Lane(paper_card)
    fails("cuLaunchKernel", stops_s=6.0)
    begun_s = time.monotonic()
    found = frames(tank, still, lane, 2)
    assert 0.7 < time.monotonic() - begun_s < 3.0
    assert found[1].tobytes() == frames(tank, still, None, 2)[1].tobytes()
    assert "expected a frame within 0.75 s, got none" in lane.fault
    lane.close()


def test_frames_that_find_no_room_are_the_processors(monkeypatch, lane, tank, still):  # noqa: F811
    monkeypatch.setattr(lane, "_most", 1 << 20)  # which there is no scratch for
    found = frames(tank, still, lane, 2)
    assert found[1].tobytes() == frames(tank, still, None, 2)[1].tobytes()
    assert lane.works and lane.report().frames == 0


@each(after=(0, 1, 2, 3, 4))
def test_a_launch_that_finds_no_room_on_its_way_gives_all_of_it_back(monkeypatch, lane, tank, still, after):  # noqa: F811
    frames(tank, still, lane, 2)
    lane._drop(0)
    free_bytes, taken, take = lane._pool.free_bytes, [], card_frames.Pool.take

    def runs_out(pool: card_frames.Pool, size: int) -> int:
        taken.append(size)
        if len(taken) > after:
            raise MemoryError
        return take(pool, size)

    memory = tank.fold(None, still, EFFORT, lane.compute)[1]
    monkeypatch.setattr(card_frames.Pool, "take", runs_out)
    tank.fold(memory, replace(still, time_s=0.03), EFFORT, lane.compute)
    assert len(taken) == after + 1 and lane.works and lane._pool.free_bytes == free_bytes


def test_what_left_longest_ago_goes_first_and_is_brought_again(monkeypatch, lane, tank, still):  # noqa: F811
    monkeypatch.setattr(card_lane, "KEPT_SHARE", 0.0)
    found = frames(tank, still, lane, 3)
    assert not lane._left and lane.report().frames == 3
    assert found[2].tobytes() == frames(tank, still, None, 3)[2].tobytes()


def test_without_a_card_the_processor_draws():
    def none() -> card_lane.Card:
        raise Unavailable("card", expected="a card", got="none", cure="Go on.")

    lane = Lane(none)
    assert lane.fault == "card: expected a card, got none. Go on." and not lane.works
    assert list(lane.each(abs, [-1, 2])) == [1, 2]
    lane.close()
