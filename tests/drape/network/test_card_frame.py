"""Frames from their poses on, by a card: from the same memory they are the engine's, bit by bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from benchmarks.cases import FPS, at_rate
from benchmarks.served import Stream, plan_of
from drape.catalog import find_motions
from drape.engine import card_jobs
from drape.engine.card import Card
from drape.engine.card_frames import Pool
from drape.live import card_lane
from drape.live.card_lane import Lane
from drape.live.card_lanes import Lanes
from drape.motion.readers import read_motion
from drape.network.card_frame import FrameJob, draw_by_card
from drape.network.card_memory import CardMemory, fetched
from drape.network.frame import Drawn, FrameGarment, Moment, Past, draw
from drape.stages import frame
from drape.stages.network import Network
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.fixtures.paper_card import SOURCE, driver, fails, paper_card, turn_threads
from tests.fixtures.serving import bare_settings

FRAMES = 6


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
        self._lane, self.names = lane, list[str]()

    def __call__(self, worn: FrameGarment, past: Past, at: Moment, vertices: np.ndarray, steps: np.ndarray) -> Drawn:
        made = draw(worn, past, at, vertices, steps)
        assert made is not None
        for backwards in (False, True):
            turn_threads(backwards)
            job = FrameJob(worn, [past], [[at]])
            self._lane.ask(job)
            self._lane.wait_for(job)
            assert not self._lane.fault
            (found,) = job.drawn
            assert isinstance(found, Drawn)
            assert job.steps.tobytes() == steps.tobytes()
            assert job.steps.size or job.vertices.tobytes() == vertices.tobytes()
            assert (found.report, found.novelty) == (made.report, made.novelty)
            if len(steps):
                assert (found.low.tobytes(), found.step.tobytes()) == (made.low.tobytes(), made.step.tobytes())
            for one, other in zip(found.past, made.past, strict=True):
                assert numbers_of(fetched(one)) == numbers_of(other)
        self.names.append(getattr(found.past.folded, "name", ""))
        return made


@each(
    case=(
        ("balanced", "tshirt", 1.0, True, "fold_two_levels"),
        ("accurate", "tank", 0.0, False, "fold"),
        ("instant", "dress", 1.0, False, "lift_alone"),
    )
)
def test_a_frame_of_the_card_is_the_engines(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any, case: Any):
    """A walk, whose first frame settles."""
    tier, garment, motion, messages, name = case
    beside = Beside(lane)
    monkeypatch.setattr(frame, "draw", beside)
    plan = plan_of(runtime, [shipped(garment)], messages=messages, tier=tier, fabric="jersey", motion=motion)
    stream = Stream(plan, runtime.body.shape_count)
    poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
    for number in range(FRAMES):
        stream.pose(poses[number], number / FPS)
    assert beside.names == [name] * FRAMES


class Streams:
    """Two streams of a shirt: one of three frames, and one among colliders of two, with a pause between them."""

    def __init__(self, runtime: DrapeRuntime) -> None:
        plan = plan_of(runtime, [shipped("tank")], tier="fast", fabric="jersey", motion=1.0)
        stream = Stream(plan, runtime.body.shape_count)
        poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
        stream.pose(poses[0], 0.0)
        self.worn: FrameGarment = plan.kept["worn"]
        (network,) = (stage for stage in plan.stages if isinstance(stage, Network))
        feed, place = network.posed_by(np.zeros(runtime.body.shape_count))
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

    def by_engine(self, pasts: Sequence[Past], moments: list[list[Moment]]) -> tuple[list[Drawn], np.ndarray]:
        """The frames and their vertices, by the engine."""
        frames, vertices = list[Drawn](), np.empty((5, self.worn.vertex_count, 3), np.float32)
        for past, own in zip(pasts, moments, strict=True):
            for at in own:
                made = draw(self.worn, past, at, vertices[len(frames)])
                assert made is not None
                past = made.past
                frames.append(made)
        return frames, vertices


NEW = Past(None, None), Past(None, None)


def reports(frames: Sequence[Any]) -> list[Any]:
    return [made.report for made in frames]


def test_streams_and_clips_of_a_launch_are_the_engines(streams: Streams, lane: Lane):
    """What a launch leaves on the card is what the next goes on from; so is what comes from a processor."""
    moments, later = streams.at(0.0, 1.0), streams.at(0.1, 0.05)
    wanted, vertices = streams.by_engine(NEW, moments)
    frames, found, _ = draw_by_card(Lanes([lane]), streams.worn, NEW, moments)
    assert found.tobytes() == vertices.tobytes() and (lane.launches, lane.frames) == (1, 5)
    assert reports(frames) == reports(wanted) and [one.settled for one in reports(wanted)] == [
        True,
        False,
        False,
        True,
        True,
    ]
    later[1] = [at._replace(time_s=at.time_s + 1.0) for at in later[1]]
    left, known = ([made.past for made in (own[2], own[4])] for own in (frames, wanted))  # pyright: ignore
    again, vertices = streams.by_engine(known, later)
    assert not any(one.settled for one in reports(again))
    for pasts in (left, [known[0], left[1]]):
        _, found, _ = draw_by_card(Lanes([lane]), streams.worn, pasts, later)
        assert found.tobytes() == vertices.tobytes()


def test_frames_that_need_more_scratch_are_the_processors(streams: Streams, lane: Lane, monkeypatch: Any):
    moments = streams.at(0.0, 0.05)
    for room in (card_jobs, card_lane):
        monkeypatch.setattr(room, "FRAME_SCRATCH_BYTES", 1 << 20)
    frames, found, _ = draw_by_card(Lanes([lane]), streams.worn, NEW, moments)
    assert found.tobytes() == streams.by_engine(NEW, moments)[1].tobytes() and lane.works and lane.frames == 5
    assert not any(isinstance(made.past.folded, CardMemory) for made in frames if made)


@each(call=("cuMemcpyHtoD_v2", "cuLaunchKernel", "cuMemcpyDtoH_v2"))  # before, at and after a launch
def test_streams_outlive_their_card(streams: Streams, lane: Lane, call: str):
    """What it had of them is gone, so their folds begin anew."""
    frames, _, _ = draw_by_card(Lanes([lane]), streams.worn, NEW, streams.at(0.0, 0.05))
    later = streams.at(0.1, 0.05)
    wanted, vertices = streams.by_engine(NEW, later)
    fails(call)
    again, found, _ = draw_by_card(
        Lanes([lane]), streams.worn, [made.past for made in (frames[2], frames[4]) if made], later
    )
    assert not lane.works and lane.fault == f"Card of paper: {call}: unspecified launch failure"
    assert found.tobytes() == vertices.tobytes() and reports(again) == reports(wanted)


def test_what_streams_leave_is_given_back(streams: Streams, lane: Lane):
    free_bytes = []
    for _ in range(4):
        draw_by_card(Lanes([lane]), streams.worn, NEW, streams.at(0.0, 0.05))
        assert lane._pool is not None
        free_bytes.append(lane._pool.free_bytes)
    assert free_bytes[1] == free_bytes[3]


def test_streams_are_placed_by_room_and_stay_where_their_memory_is(streams: Streams, monkeypatch: Any):
    """Two cards, of which one fails: its stream goes on by the other, anew."""
    monkeypatch.setattr(card_lane, "LOST_S", 60.0)
    first = paper_card(cards=2)
    both = [Lane(lambda: first), Lane(lambda: Card(SOURCE, number=1, driver=driver()[0]), share=0.4)]
    lanes = Lanes(both)
    moments, later = streams.at(0.0, 0.05), streams.at(0.1, 0.05)
    known, _ = streams.by_engine(NEW, moments)
    left = []
    for k in range(2):
        frames, _, _ = draw_by_card(lanes, streams.worn, NEW[:1], moments[k : k + 1])
        assert frames[-1] is not None
        left.append(frames[-1].past)
        both[0]._pool.take(900 << 20) if k == 0 else None  # pyright: ignore[reportOptionalMemberAccess]
    assert [past.folded.slot.lane for past in left] == both
    _, found, _ = draw_by_card(lanes, streams.worn, left, later)
    assert found.tobytes() == streams.by_engine([known[2].past, known[4].past], later)[1].tobytes()
    assert [lane.launches for lane in both] == [2, 2] and lanes.report().frames == 10
    fails("cuLaunchKernel", card=1)
    _, found, _ = draw_by_card(lanes, streams.worn, left, later)
    assert found.tobytes() == streams.by_engine([known[2].past, NEW[1]], later)[1].tobytes()
    assert lanes.works and lanes.report().fault.endswith("cuLaunchKernel: unspecified launch failure")
    draw_by_card(lanes, streams.worn, NEW, later)
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
        _, found, _ = draw_by_card(Lanes([lane]), streams.worn, NEW, moments)
    wanted = streams.by_engine(NEW, moments)[1]
    assert found.tobytes() == wanted.tobytes() and taken[0] > after and (lane.works, lane.launches) == (True, 0)
    _, found, _ = draw_by_card(Lanes([lane]), streams.worn, NEW, moments)
    assert found.tobytes() == wanted.tobytes() and lane.launches == 1
