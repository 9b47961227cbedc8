"""The batcher: who goes together, who goes first, and that nobody pays for another's fault."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from drape.errors import InputError
from drape.wire import messages as wire
from drape.wire.options import DrapeOptions
from service.drapery import Drapery
from service.piecework import Piecework
from service.sessions import Session, Streams
from service.settings import Settings
from service.stages.batch import PoseInput

REST = np.zeros((24, 3))


def test_one_bad_pose_does_not_fail_its_batch(make_settings: Callable[..., Settings]):
    drapery = Drapery(make_settings())
    plan = drapery.plan(drapery.garments.get("tube"), DrapeOptions(push_out=False), messages=True)
    streams = Streams(drapery, Piecework())
    sessions = [Session(plan, np.zeros(10), credit=2) for _ in range(3)]
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
    drapery.close()


def test_the_longest_waiting_pose_goes_first_with_all_of_its_plan(make_settings: Callable[..., Settings]):
    drapery = Drapery(make_settings(chunk_frames=2))
    tube = drapery.garments.get("tube")
    other = type(tube)("other", tube.garment, tube.source)
    streams = Streams(drapery, Piecework())
    plans = [drapery.plan(entry, DrapeOptions(), messages=True) for entry in (other, tube, other, other)]
    sessions = [Session(plan, np.zeros(10), credit=1) for plan in plans]
    for session in (sessions[2], sessions[1], sessions[0], sessions[3]):
        session.put(wire.Pose(0, 0.0, np.zeros(3), REST))
        streams.add(session)
        time.sleep(0.002)
    assert streams._next_batch() == [sessions[2], sessions[0]]
    for session in (sessions[2], sessions[0]):
        session.take()
    assert streams._next_batch() == [sessions[1]]
    drapery.close()


def test_an_acknowledgement_that_was_not_earned_is_refused(make_settings: Callable[..., Settings]):
    drapery = Drapery(make_settings())
    session = Session(drapery.plan(drapery.garments.get("tube"), DrapeOptions()), np.zeros(10), credit=1)
    with pytest.raises(InputError, match="ack message"):
        session.acknowledge(0)
    drapery.close()


def test_a_frame_does_not_wait_for_what_is_computed_aside(make_settings: Callable[..., Settings]):
    drapery = Drapery(make_settings())
    plan = drapery.plan(drapery.garments.get("tube"), DrapeOptions(), messages=True)

    async def both() -> None:
        through = threading.Event()
        aside = asyncio.create_task(drapery.aside(through.wait))
        await asyncio.sleep(0)
        ((message, _),) = await asyncio.wait_for(drapery.stream_frames(plan, [rest_input()]), 30.0)
        assert isinstance(message, bytes) and not aside.done()
        through.set()
        assert await aside

    asyncio.run(both())
    drapery.close()


def test_nothing_aside_begins_while_a_frame_is_computed(
    make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
):
    drapery = Drapery(make_settings())
    plan = drapery.plan(drapery.garments.get("tube"), DrapeOptions(), messages=True)
    through, begun = threading.Event(), threading.Event()
    monkeypatch.setattr(drapery, "frames", lambda plan, inputs: through.wait() and [])

    async def both() -> None:
        frame = asyncio.create_task(drapery.stream_frames(plan, [rest_input()]))
        await asyncio.sleep(0)
        aside = asyncio.create_task(drapery.aside(begun.set))
        await asyncio.sleep(0.05)
        assert not begun.is_set()
        through.set()
        await asyncio.gather(frame, aside)
        assert begun.is_set()

    asyncio.run(both())
    drapery.close()


def rest_input() -> PoseInput:
    return PoseInput(REST[None], np.zeros((1, 3)), np.zeros(10), np.zeros(1))
