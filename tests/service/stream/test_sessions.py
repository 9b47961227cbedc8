"""The batcher: who goes together, who goes first, and that nobody pays for another's fault."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from starlette.websockets import WebSocket

from drape.errors import InputError
from drape.stages.batch import Memories, PoseInput
from drape.wire import messages as wire
from drape.wire.options import Advanced, DrapeOptions
from service.compute.background import processor_count
from service.compute.drape_runtime import DrapeRuntime
from service.compute.threads import SlicedThread
from service.errors import TooSlow
from service.guard.key_file import Client
from service.guard.tickets import Tickets
from service.replicas import handover
from service.replicas.handover import Handover
from service.state import State
from service.stream import routes
from service.stream.session import StreamSession
from service.stream.workers import Streams
from tests.fixtures.patience import PATIENT_S

REST = np.zeros((24, 3))


def test_one_bad_pose_does_not_fail_its_batch(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(stream_threads=1)
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False)), messages=True)
    streams = Streams(runtime, SlicedThread())
    sessions = [StreamSession(plan, np.zeros(10), credit=2) for _ in range(3)]
    poses = [REST, np.full((24, 3), np.nan), REST]
    for i, (session, pose) in enumerate(zip(sessions, poses, strict=True)):
        session.put(wire.Pose(i, 0.0, np.zeros(3), pose))
        streams.add(session)

    async def once() -> None:
        batch = streams._next_batch()
        assert batch == sessions
        await streams._compute(batch)

    asyncio.run(once())
    assert [session.failure is not None for session in sessions] == [False, True, False]
    assert [session.outbox is not None for session in sessions] == [True, False, True]


def test_the_longest_waiting_pose_goes_first_with_all_of_its_plan(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(chunk_frames=2, stream_threads=1)
    tube = runtime.garments.get("tube")
    other = type(tube)("other", tube.garment, tube.source)
    streams = Streams(runtime, SlicedThread())
    plans = [runtime.plan(entry, DrapeOptions(), messages=True) for entry in (other, tube, other, other)]
    sessions = [StreamSession(plan, np.zeros(10), credit=1) for plan in plans]
    for session in (sessions[2], sessions[1], sessions[0], sessions[3]):
        session.put(wire.Pose(0, 0.0, np.zeros(3), REST))
        streams.add(session)
        time.sleep(0.002)
    assert streams._next_batch() == [sessions[2], sessions[0]]
    for session in (sessions[2], sessions[0]):
        session.take()
    assert streams._next_batch() == [sessions[1]]


class Deaf:
    """The connection of a client that takes nothing."""

    async def send_bytes(self, data: bytes) -> None:
        await asyncio.sleep(PATIENT_S)


def test_who_takes_no_frame_or_state_within_its_time_is_cut(make_runtime: Callable[..., DrapeRuntime], monkeypatch):
    runtime = make_runtime(stream_threads=1)
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    session, deaf = StreamSession(plan, np.zeros(10), credit=2), cast(WebSocket, Deaf())
    session.outbox, session.memories = b"a frame", {("folds", plan.keys[0]): np.zeros(9)}
    session.news.set()
    for room in (routes, handover):
        monkeypatch.setattr(room, "SEND_S", 0.01)
    with pytest.raises(TooSlow, match=r"stream: expected a frame taken within 0\.01 s, got a full connection"):
        asyncio.run(routes._send(deaf, session, cast(State, None), Client()))
    away = Handover(runtime, Tickets("a secret")).send_away(deaf, session, Client(), 0)
    with pytest.raises(TooSlow, match=r"expected a state taken within 0\.01 s, got a full connection.*begins anew"):
        asyncio.run(away)


def test_an_acknowledgement_that_was_not_earned_is_refused(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime()
    session = StreamSession(runtime.plan(runtime.garments.get("tube"), DrapeOptions()), np.zeros(10), credit=1)
    with pytest.raises(InputError, match="ack message"):
        session.acknowledge(0)


def test_a_frame_does_not_wait_for_what_is_computed_aside(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime()
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)

    async def both() -> None:
        through = threading.Event()
        aside = asyncio.create_task(runtime.threads.aside(through.wait))
        await asyncio.sleep(0)
        ((message, _),) = await asyncio.wait_for(runtime.stream_frames(plan, [rest_input()]), PATIENT_S)
        assert isinstance(message, bytes) and not aside.done()
        through.set()
        assert await aside

    asyncio.run(both())


def test_nothing_aside_begins_while_a_frame_is_computed(
    make_runtime: Callable[..., DrapeRuntime], monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    through, begun = threading.Event(), threading.Event()
    monkeypatch.setattr(runtime, "_compute", lambda plan, inputs: through.wait() and [(b"", {})])

    async def both() -> None:
        frame = asyncio.create_task(runtime.stream_frames(plan, [rest_input()]))
        await asyncio.sleep(0)
        aside = asyncio.create_task(runtime.threads.aside(begun.set))
        await asyncio.sleep(0.05)
        assert not begun.is_set()
        through.set()
        await asyncio.gather(frame, aside)
        assert begun.is_set()

    asyncio.run(both())


def rest_input(frame: int = 0, memories: Memories | None = None) -> PoseInput:
    times_s = np.array([frame / 30.0])
    return PoseInput(REST[None], np.zeros((1, 3)), np.zeros(10), times_s, memories or {}, sequence=frame)


def test_a_frame_is_left_to_a_worker_that_still_computes(make_runtime: Callable[..., DrapeRuntime], monkeypatch):
    runtime = make_runtime(stream_threads=2)
    streams = Streams(runtime, SlicedThread())
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    sessions = [StreamSession(plan, np.zeros(10), credit=2) for _ in range(3)]

    async def beside() -> list[StreamSession]:
        begun, go_on, compute = asyncio.Event(), asyncio.Event(), runtime.stream_frames

        async def slow(*asked):
            begun.set()
            await go_on.wait()
            return await compute(*asked)

        monkeypatch.setattr(runtime, "stream_frames", slow)
        for session in sessions:
            streams.add(session)
        sessions[0].put(wire.Pose(0, 0.0, np.zeros(3), REST))
        computing = asyncio.create_task(streams._compute(streams._next_batch()))
        await begun.wait()
        for session in sessions[1:]:
            session.put(wire.Pose(0, 0.0, np.zeros(3), REST))
            await asyncio.sleep(0.002)
        found = streams._next_batch()
        go_on.set()
        await computing
        return found

    assert asyncio.run(beside()) == [sessions[1]], "both would leave when the second is through"


def test_waiting_streams_are_shared_out_among_free_workers(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(stream_threads=2)
    streams = Streams(runtime, SlicedThread())
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    sessions = [StreamSession(plan, np.zeros(10), credit=2) for _ in range(3)]
    for session in sessions:
        session.put(wire.Pose(0, 0.0, np.zeros(3), REST))
        streams.add(session)
        time.sleep(0.002)
    first = streams._next_batch()
    assert first == sessions[:2]
    for session in first:
        session.take()
    sessions[0].put(wire.Pose(1, 0.0, np.zeros(3), REST))  # whose frame before is not through
    assert streams._next_batch() == sessions[2:]


def test_streams_are_computed_beside_each_other_and_each_frame_after_the_one_before(
    make_runtime: Callable[..., DrapeRuntime], monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime(stream_threads=2)
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(folds=1)), messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    alone, expected = {}, []
    for i in range(4):
        ((message, alone),) = runtime._compute(plan, [(rest_input(i, alone), None)])
        assert isinstance(message, bytes)
        expected.append(wire.unpack_frame(message).positions)
    both, compute = threading.Barrier(2), runtime._compute

    def together(*arguments: Any) -> Any:
        both.wait(30.0)  # until the other stream's frame is computed too
        return compute(*arguments)

    monkeypatch.setattr(runtime, "_compute", together)
    streams = Streams(runtime, SlicedThread())
    sessions = [StreamSession(plan, np.zeros(10), credit=2) for _ in range(2)]

    async def frames() -> list[list[np.ndarray]]:
        streams.start()
        found: list[list[np.ndarray]] = [[], []]
        for session in sessions:
            streams.add(session)
        for i in range(4):
            for session in sessions:
                session.put(wire.Pose(i, i / 30.0, np.zeros(3), REST))
            streams.wake()
            for session, shown in zip(sessions, found, strict=True):
                while session.outbox is None:
                    assert session.failure is None
                    await session.news.wait()
                    session.news.clear()
                shown.append(wire.unpack_frame(session.outbox).positions)
                session.outbox = None
                session.acknowledge(i)
        await streams.stop()
        return found

    for shown in asyncio.run(frames()):
        for got, want in zip(shown, expected, strict=True):
            np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize(("asked", "count"), [(None, processor_count()), (3, 3)])
def test_there_is_a_thread_for_each_processor_or_as_many_as_were_asked_for(
    make_runtime: Callable[..., DrapeRuntime], asked: int | None, count: int
):
    runtime = make_runtime(stream_threads=asked)
    assert runtime.threads.stream_threads == count
