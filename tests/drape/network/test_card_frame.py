"""Frames from their poses on, by a card: from the same memory they are the engine's, bit by bit."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.cases import FPS, at_rate
from benchmarks.served import Stream, plan_of
from drape.catalog import find_motions
from drape.engine import card_jobs
from drape.engine.card import Card
from drape.engine.card_frames import Pool
from drape.errors import Unavailable
from drape.live import card_lane
from drape.live.card_lane import Lane
from drape.live.card_lanes import Lanes
from drape.live.two_level import TwoLevel
from drape.motion.readers import read_motion
from drape.network.card_frame import FrameJob, draw_by_card
from drape.network.card_memory import CardMemory, to_processor
from drape.network.frame import FrameOutfit, FrameResult, Moment, Past, draw
from drape.stages import frame
from drape.stages.network import Network
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.fixtures.paper_card import SOURCE, driver, fails, paper_card, turn_threads
from tests.fixtures.serving import bare_settings

FRAMES = 30


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrapeRuntime]:
    with closing(DrapeRuntime(bare_settings(tmp_path_factory.mktemp("none")))) as made:
        yield made


@pytest.fixture(scope="module")
def streams(runtime: DrapeRuntime) -> Streams:
    return Streams(runtime)


@pytest.fixture
def lane(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lane]:
    monkeypatch.setattr(card_lane, "LOST_S", 60.0)  # the emulation is slow
    made = Lane(paper_card)
    yield made
    made.close()


def numbers_of(memory: Any) -> list[bytes]:
    """All arrays and numbers of a memory."""
    if isinstance(memory, np.ndarray):
        return [memory.tobytes()]
    if isinstance(memory, tuple):
        return [one for part in memory for one in numbers_of(part)]
    if hasattr(memory, "__dict__"):
        return [one for name, part in sorted(vars(memory).items()) if name not in ("left", "record")
                for one in numbers_of(part)]  # fmt: skip
    return [repr(memory).encode()]


class Beside:
    """Frames by the engine, and by the emulated card of ``lane`` in both orders of its threads."""

    def __init__(self, lane: Lane) -> None:
        self._lane, self.frames, self.names = lane, 0, set[str]()

    def __call__(
        self, outfit: FrameOutfit, pasts: Sequence[Past], at: Moment, vertices: np.ndarray, steps: np.ndarray
    ) -> FrameResult:
        made = draw(outfit, pasts, at, vertices, steps)
        assert made is not None
        for backwards in (False, True):
            turn_threads(backwards)
            job = FrameJob(outfit, [pasts], [[at]])
            self._lane.ask(job)
            self._lane.wait_for(job)
            assert not self._lane.fault
            (found,) = job.drawn
            assert isinstance(found, FrameResult)
            assert job.steps.tobytes() == steps.tobytes()
            assert job.steps.size or job.vertices.tobytes() == vertices.tobytes()
            assert (found.reports, found.novelty) == (made.reports, made.novelty)
            if len(steps):
                assert (found.low.tobytes(), found.step.tobytes()) == (made.low.tobytes(), made.step.tobytes())
            for card, engine in zip(found.pasts, made.pasts, strict=True):
                for one, other in zip(card, engine, strict=True):
                    assert numbers_of(to_processor(one)) == numbers_of(other)
        self.frames += 1
        self.names |= {getattr(past.folded, "name", "") for past in found.pasts}
        return made


CASES = (
    ("balanced", ["tshirt"], 1.0, True, "fold_two_levels"),
    ("fast", ["shorts"], 1.0, True, "fold_two_levels"),
    ("accurate", ["tank"], 0.0, False, "fold"),
    ("instant", ["dress"], 1.0, False, "lift_alone"),
    ("balanced", ["trousers", "tshirt"], 1.0, True, "fold_two_levels"),
    ("instant", ["tank", "shirt", "circle_skirt"], 1.0, True, "lift_alone"),
)


@each(case=CASES)
def test_a_frame_of_the_card_is_the_engines(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any, case: Any):
    """A walk, whose first frame settles; cloth that touches itself, the skin and the layer below."""
    follow(runtime, lane, monkeypatch, case, FRAMES)


@pytest.mark.long
@each(case=CASES)
def test_so_are_three_hundred(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any, case: Any):
    follow(runtime, lane, monkeypatch, case, 300)


def follow(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any, case: Any, frames: int) -> None:
    """So many frames of a walk that goes to and fro, each from the engine's memory."""
    tier, garments, motion, messages, name = case
    beside = Beside(lane)
    monkeypatch.setattr(frame, "draw", beside)
    worn = [shipped(garment) for garment in garments]
    plan = plan_of(runtime, worn, messages=messages, tier=tier, fabric="jersey", motion=motion)
    stream = Stream(plan, runtime.body.shape_count)
    poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
    poses = np.concatenate([poses, poses[-2:0:-1]])
    for number in range(frames):
        stream.pose(poses[number % len(poses)], number / FPS)
    alone = len(garments) > 1  # the first frame of an outfit is drawn layer by layer
    assert (beside.frames, beside.names) == (frames - alone, {name})


class Streams:
    """Two streams of a top: one of three frames, and one among colliders of two, with a pause between them."""

    def __init__(self, runtime: DrapeRuntime, *garments: str) -> None:
        worn = [shipped(garment) for garment in garments or ("tank",)]
        plan = plan_of(runtime, worn, tier="fast", fabric="jersey", motion=1.0)
        stream = Stream(plan, runtime.body.shape_count)
        self.new = [(Past(None, None),) * len(worn)] * 2
        poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
        stream.pose(poses[0], 0.0)
        self.worn: FrameOutfit = plan.kept["worn"]
        (network,) = (stage for stage in plan.stages if isinstance(stage, Network))
        feed, place = network.feed_of(np.zeros(runtime.body.shape_count))
        box = np.concatenate([[0.0, 0.2, 0.3], np.eye(3).reshape(-1), [0.3, 0.05, 0.05], [0.0]])[None]
        self._moments = [
            [Moment(feed, np.ascontiguousarray(poses[7 * k + i]), 0.0, place + 0.01 * i, box if k else box[:0])
             for i in range(3 - k)]
            for k in range(2)
        ]  # fmt: skip

    def at(self, begin_s: float, pause_s: float) -> list[list[Moment]]:
        """The moments of both, the first ones at the same time."""
        steps_s = 1 / FPS, pause_s
        return [
            [at._replace(time_s=begin_s + i * step_s) for i, at in enumerate(own)]
            for own, step_s in zip(self._moments, steps_s, strict=True)
        ]

    def by_engine(
        self, pasts: Sequence[Sequence[Past]], moments: list[list[Moment]]
    ) -> tuple[list[FrameResult], np.ndarray]:
        """The frames and their vertices, by the engine."""
        frames, vertices = list[FrameResult](), np.empty((5, self.worn.vertex_count, 3), np.float32)
        for past, own in zip(pasts, moments, strict=True):
            for at in own:
                made = draw(self.worn, past, at, vertices[len(frames)])
                assert made is not None
                past = made.pasts
                frames.append(made)
        return frames, vertices


def reports(frames: Sequence[Any]) -> list[Any]:
    return [made.reports[-1] for made in frames]


@each(garments=(["tank"], ["shorts", "tank"]))
def test_streams_and_clips_of_a_launch_are_the_engines(runtime: DrapeRuntime, lane: Lane, garments: list[str]):
    """What a launch leaves on the card is what the next goes on from; so is what comes from a processor."""
    streams = Streams(runtime, *garments)
    moments, later = streams.at(0.0, 1.0), streams.at(0.1, 0.05)
    wanted, vertices = streams.by_engine(streams.new, moments)
    frames, found, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    assert found.tobytes() == vertices.tobytes() and (lane.launches, lane.frames) == (1, 5)
    assert reports(frames) == reports(wanted) and [one.settled for one in reports(wanted)] == [
        True,
        False,
        False,
        True,
        True,
    ]
    later[1] = [at._replace(time_s=at.time_s + 1.0) for at in later[1]]
    left, known = ([made.pasts for made in (own[2], own[4])] for own in (frames, wanted))  # pyright: ignore
    again, vertices = streams.by_engine(known, later)
    assert not any(one.settled for one in reports(again))
    for pasts in (left, [known[0], left[1]]):
        _, found, _ = draw_by_card(Lanes([lane]), streams.worn, pasts, later)
        assert found.tobytes() == vertices.tobytes()


def test_frames_that_need_more_scratch_are_the_processors(streams: Streams, lane: Lane, monkeypatch: Any):
    moments = streams.at(0.0, 0.05)
    for room in (card_jobs, card_lane):
        monkeypatch.setattr(room, "FRAME_SCRATCH_BYTES", 1 << 20)
    frames, found, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    assert found.tobytes() == streams.by_engine(streams.new, moments)[1].tobytes() and lane.works and lane.frames == 5
    assert not any(isinstance(made.pasts[0].folded, CardMemory) for made in frames if made)


@each(call=("cuMemcpyHtoD_v2", "cuLaunchKernel", "cuMemcpyDtoH_v2"))  # before, at and after a launch
def test_streams_outlive_their_card(streams: Streams, lane: Lane, call: str):
    """They go on from what a host has of them, which is up to ``KEPT_S`` older than what the card had."""
    moments, later = streams.at(0.0, 0.05), streams.at(0.1, 0.05)
    frames, _, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    known, _ = streams.by_engine(streams.new, moments)
    wanted, vertices = streams.by_engine([known[2].pasts, known[4].pasts], later)
    fails(call)
    again, found, _ = draw_by_card(
        Lanes([lane]), streams.worn, [made.pasts for made in (frames[2], frames[4]) if made], later
    )
    assert not lane.works and lane.fault == f"Card of paper: {call}: unspecified launch failure"
    assert found.tobytes() == vertices.tobytes() and reports(again) == reports(wanted)


def test_a_host_keeps_what_streams_leave_five_times_a_second(streams: Streams, lane: Lane):
    past, (at, *_), times_s = streams.new[0], streams.at(0.0, 0.05)[0], []
    for number in range(9):
        made, _, _ = draw_by_card(Lanes([lane]), streams.worn, [past], [[at._replace(time_s=number * 0.05)]])
        assert made[0] is not None
        past = made[0].pasts
        times_s.append((past[0].swung.kept.time_s, past[0].folded.kept.coarse.time_s))  # pyright: ignore
    assert_allclose(times_s, np.repeat([[0.0], [0.2], [0.4]], [4, 4, 1], axis=0) * [1, 1])
    fails("cuMemcpyDtoH_v2")
    assert to_processor(past[0].folded).coarse.time_s == to_processor(past[0].swung).time_s == times_s[-1][0]


def test_what_streams_leave_is_given_back(streams: Streams, lane: Lane):
    free_bytes = []
    for _ in range(4):
        draw_by_card(Lanes([lane]), streams.worn, streams.new, streams.at(0.0, 0.05))
        assert lane._pool is not None
        free_bytes.append(lane._pool.free_bytes)
    assert free_bytes[1] == free_bytes[3]


def test_streams_are_placed_by_room_and_stay_where_their_memory_is(streams: Streams, monkeypatch: Any):
    """Two cards, of which one fails: its stream goes on by the other."""
    monkeypatch.setattr(card_lane, "LOST_S", 60.0)
    first = paper_card(cards=2)
    both = [Lane(lambda: first), Lane(lambda: Card(SOURCE, number=1, driver=driver()[0]), share=0.4)]
    lanes = Lanes(both)
    moments, later = streams.at(0.0, 0.05), streams.at(0.1, 0.05)
    known, _ = streams.by_engine(streams.new, moments)
    left = []
    for k in range(2):
        frames, _, _ = draw_by_card(lanes, streams.worn, streams.new[:1], moments[k : k + 1])
        assert frames[-1] is not None
        left.append(frames[-1].pasts)
        both[0]._pool.take(900 << 20) if k == 0 else None  # pyright: ignore[reportOptionalMemberAccess]
    assert [past.folded.slot.lane for (past,) in left] == both
    _, found, _ = draw_by_card(lanes, streams.worn, left, later)
    assert found.tobytes() == streams.by_engine([known[2].pasts, known[4].pasts], later)[1].tobytes()
    assert [lane.launches for lane in both] == [2, 2] and lanes.report().frames == 10
    fails("cuLaunchKernel", card=1)
    _, found, _ = draw_by_card(lanes, streams.worn, left, later)
    assert found.tobytes() == streams.by_engine([known[2].pasts, known[4].pasts], later)[1].tobytes()
    assert lanes.works and lanes.report().fault.endswith("cuLaunchKernel: unspecified launch failure")
    draw_by_card(lanes, streams.worn, streams.new, later)
    assert [lane.frames for lane in both] == [14, 4]
    lanes.close()


@each(after=(0, 3, 8, 12))
def test_frames_that_find_no_room_are_the_processors(streams: Streams, lane: Lane, monkeypatch: Any, after: int):
    """Whatever of a launch finds none: constants, what frames leave, or rows."""
    taken, take = [0], Pool.take
    moments = streams.at(0.0, 0.05)

    def runs_out(pool: Pool, size: int) -> int:
        taken[0] += 1
        if taken[0] > after:
            raise MemoryError
        return take(pool, size)

    with monkeypatch.context() as patch:
        patch.setattr(Pool, "take", runs_out)
        _, found, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    wanted = streams.by_engine(streams.new, moments)[1]
    assert found.tobytes() == wanted.tobytes() and taken[0] > after and (lane.works, lane.launches) == (True, 0)
    _, found, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    assert found.tobytes() == wanted.tobytes() and lane.launches == 1


def test_a_rough_frame_is_the_engines(runtime: DrapeRuntime, lane: Lane, rng: np.random.Generator):
    """A box before the chest, and cloth that crosses itself in hundreds of places."""
    streams, beside = Streams(runtime), Beside(lane)
    (worn,) = streams.worn.garments
    columns = worn.tiles.columns * rng.uniform(0.6, 1.4, worn.tiles.columns.shape).astype(np.float32)
    rough = replace(streams.worn, garments=(replace(worn, tiles=replace(worn.tiles, columns=columns)),))
    moments, past, steps = streams.at(0.0, 1 / FPS)[0][:2], streams.new[0], np.empty((0, 3), np.uint16)
    free, held = np.empty((2, worn.vertex_count, 3), np.float32)
    draw(rough, past, moments[0], free)
    middle = free.mean(axis=0) + np.array([0.0, 0.1, 0.1])
    box = np.concatenate([middle, np.eye(3).reshape(-1), [0.3, 0.05, 0.05], [0.0]])[None]
    for number, at in enumerate(moments):
        past = beside(rough, past, at._replace(colliders=box), held, steps).pasts
        assert number or np.abs(held - free).max() > 0.005


def test_threads_that_race_give_other_numbers(runtime: DrapeRuntime, lane: Lane):
    """With one colour for all blocks the two orders differ: the emulation sees what a card would do wrong."""
    streams = Streams(runtime)
    (worn,) = streams.worn.garments
    assert isinstance(worn.folds, TwoLevel)
    levels = worn.folds.levels
    sheet = levels.fine.sheet._replace(colour_start=np.array([0, len(levels.fine.sheet.fan_start) - 1], np.int32))
    torn = TwoLevel(replace(levels, fine=levels.fine._replace(sheet=sheet)), worn.folds.laid)
    for folds, is_same in ((worn.folds, True), (torn, False)):
        outfit, found = replace(streams.worn, garments=(replace(worn, folds=folds),)), []
        for backwards in (False, True):
            turn_threads(backwards)
            found.append(draw_by_card(Lanes([lane]), outfit, streams.new[:1], [streams.at(0.0, 0.05)[0][:1]])[1])
        assert np.array_equal(*found) is is_same


def test_streams_share_launches_and_the_lane_tells_of_them(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any):
    monkeypatch.setattr(card_lane, "GATHERED_S", 0.3)  # threads of a busy machine come late
    streams = Streams(runtime)
    moments = [own[:1] for own in streams.at(0.0, 0.05)]
    with ThreadPoolExecutor(2) as threads:
        draws = threads.map(lambda at: draw_by_card(Lanes([lane]), streams.worn, streams.new[:1], [at])[1], moments)
        found = np.concatenate(list(draws))
    told, (wanted, vertices) = lane.report(), streams.by_engine(streams.new, moments)
    assert found.tobytes() == vertices[: len(wanted)].tobytes()
    assert told.frames == 2 and told.launches == 1 and told.frames_a_launch == 2
    assert told.card == "Card of paper" and told.fault == "" and told.queue_s == 0.0
    assert 0 < told.occupied < 1 and 0 < told.busy <= 1


def test_a_card_that_stops_is_given_up_within_a_second(runtime: DrapeRuntime):
    lane, streams = Lane(paper_card), Streams(runtime)
    fails("cuLaunchKernel", stops_s=(stops_s := 6.0))
    moments, begun_s = streams.at(0.0, 0.05), time.monotonic()
    _, found, _ = draw_by_card(Lanes([lane]), streams.worn, streams.new, moments)
    assert 0.7 < time.monotonic() - begun_s < stops_s
    assert found.tobytes() == streams.by_engine(streams.new, moments)[1].tobytes()
    assert "expected a frame within 0.75 s, got none" in lane.fault
    lane.close()


def test_without_a_card_the_lane_says_why():
    def none() -> Card:
        raise Unavailable("card", expected="a card", got="none", cure="Go on.")

    lane = Lane(none)
    assert lane.fault == "card: expected a card, got none. Go on." and not lane.works
    lane.close()
