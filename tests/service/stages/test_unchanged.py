"""A body that stands still costs nothing once its cloth hangs still, and neither do joints that move no cloth."""

from __future__ import annotations

import asyncio
import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from websockets.asyncio.client import connect

from clients.stream import DrapeStream
from drape.stages.batch import PoseInput
from drape.stages.encode import KEY, REST_FRAMES, REST_S, shown_message
from drape.stages.plan import Plan
from drape.wire import messages as wire
from drape.wire.jets import unpack_jets
from drape.wire.options import Advanced, DrapeOptions
from service.compute import drape_runtime as drapery_module
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import served
from tests.fixtures.streams import PROTOCOLS, page_command, stream_address
from tests.fixtures.tiny_model import TINY_DYNAMIC

STEP_S = 1.001 * REST_S / REST_FRAMES
POSES, TRANS = smooth_motion(np.arange(4) * STEP_S)
NEEDED = REST_FRAMES + 1  # frames of one pose after which it is at rest


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(model=TINY_DYNAMIC)


@pytest.fixture
def plan(runtime: DrapeRuntime) -> Plan:
    made = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(folds=1)), messages=True)
    for stage in made.stages:
        stage.prepare(made)
    return made


class Stream:
    """Frames of one client, each after what the one before left; ``runs`` counts those that were computed."""

    def __init__(self, runtime: DrapeRuntime, plan: Plan) -> None:
        self.runtime, self.plan, self.memories, self.frame, self.runs = runtime, plan, {}, 0, 0
        self.betas = np.zeros(10)

    def next(
        self,
        pose: np.ndarray = POSES[0],
        trans: np.ndarray = TRANS[0],
        *,
        after_s: float = STEP_S,
        seen: bytes | None = None,
    ) -> bytes:
        self.frame += 1
        self.time_s = getattr(self, "time_s", 0.0) + after_s
        one = PoseInput(
            pose[None], trans[None], self.betas, np.array([self.time_s]), self.memories, sequence=self.frame, dropped=3,
            shown=seen,
        )  # fmt: skip
        with patch.object(drapery_module, "walk", wraps=drapery_module.walk) as computed:
            ((message, self.memories),) = asyncio.run(self.runtime.stream_frames(self.plan, [one]))
        self.runs += computed.call_count
        assert isinstance(message, bytes), message
        return message


def test_after_two_seconds_the_last_frame_comes_again_under_new_numbers(runtime: DrapeRuntime, plan: Plan):
    stream = Stream(runtime, plan)
    for frame in range(3):
        stream.next(POSES[frame + 1], TRANS[frame + 1])
    for _ in range(NEEDED):
        last = stream.next()
    assert stream.runs == 3 + NEEDED
    same = stream.next()
    assert stream.runs == 3 + NEEDED, "nothing was computed"
    before, after = wire.unpack_frame(last), wire.unpack_frame(same)
    assert_array_equal(after.positions, before.positions)
    assert (after.sequence, after.dropped, after.pushed) == (before.sequence + 1, 3, before.pushed)
    assert after.client_time_s == stream.time_s and after.server_time_s >= before.server_time_s


@pytest.mark.long
def test_what_moves_on_goes_on_from_where_the_cloth_hangs(runtime: DrapeRuntime, plan: Plan):
    slow, still = Stream(runtime, plan), Stream(runtime, plan)
    for _ in range(NEEDED):
        slow.next()
        still.next()
    for _ in range(200):  # a quarter of a minute at rest
        still.next()
    assert still.runs == slow.runs == NEEDED
    for frame in (1, 2, 3):
        moved, expected = (wire.unpack_frame(one.next(POSES[frame], TRANS[frame])) for one in (still, slow))
        assert_array_equal(moved.positions, expected.positions)


def test_who_shows_the_frame_is_told_that_it_holds(runtime: DrapeRuntime, plan: Plan):
    stream = Stream(runtime, plan)
    for _ in range(NEEDED - 1):
        assert wire.message_kind(stream.next(seen=shown_message(stream.memories))) == wire.FRAME
    last = stream.next()
    told = wire.unpack_same(stream.next(seen=shown_message(stream.memories)))
    assert (told.sequence, told.client_time_s, told.dropped) == (NEEDED + 1, stream.time_s, 3)
    other = wire.unpack_frame(stream.next(seen=bytes(bytearray(last))))  # what another connection was sent
    assert_array_equal(other.positions, wire.unpack_frame(last).positions)
    assert wire.message_kind(stream.next(POSES[1], TRANS[1], seen=shown_message(stream.memories))) == wire.FRAME


def resting(url: str, **more: Any) -> list[bytes]:
    """The messages of a stream of one pose, before and after its cloth has come to rest, and turned to it once more."""
    opening = json.dumps({"type": "open", "garment": "tube", **more})

    async def talk() -> list[bytes]:
        found = []
        async with connect(stream_address(url), subprotocols=PROTOCOLS) as socket:
            for count in (NEEDED + 12, NEEDED + 2):
                await socket.send(opening)
                assert json.loads(await socket.recv())["type"] == "opened"
                for i in range(count):
                    await socket.send(wire.pack_pose(wire.Pose(i, i * STEP_S, TRANS[0], POSES[0])))
                    found.append(await socket.recv())
                    if wire.message_kind(found[-1]) != wire.SAME:  # which takes no credit
                        await socket.send(wire.pack_ack(i))
        return found

    return asyncio.run(talk())


def test_a_client_that_can_take_it_gets_no_frame_twice(make_settings: Callable[..., Settings]):
    with served(make_settings(model=TINY_DYNAMIC)) as url:
        kinds = [wire.message_kind(one) for one in resting(url, same=True)]
        first, again = kinds[: NEEDED + 12], kinds[NEEDED + 12 :]
        assert first == [wire.FRAME] * NEEDED + [wire.SAME] * 12  # more than there is credit
        assert again[0] == wire.FRAME  # turned to anew a client may show nothing
        assert again[-1] == wire.SAME
        assert {wire.message_kind(one) for one in resting(url)} == {wire.FRAME}

        async def talk() -> list[wire.Frame]:
            now_s = count(0.0, STEP_S)
            async with await DrapeStream.open(url, "tube", clock=lambda: next(now_s)) as stream:
                found = []
                for _ in range(NEEDED + 2):
                    await stream.send(POSES[0], TRANS[0])
                    found.append((await stream.receive()).frame)
            return found

        *_, before, last = asyncio.run(talk())
        assert last.positions is before.positions and last.sequence == before.sequence + 1
        assert last.client_time_s > before.client_time_s


class Wire:
    """What a stream sends, counted by kind."""

    def __init__(self, stream: DrapeStream) -> None:
        self.sent: list[int] = []
        self._transmit, stream._transmit = stream._transmit, self.transmit  # pyright: ignore[reportAttributeAccessIssue]

    async def transmit(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            self.sent.append(wire.message_kind(message))
        await self._transmit(message)


@pytest.mark.parametrize("geometry", ["vertices", "jets"])
def test_of_a_body_that_stands_still_few_poses_are_sent(make_settings: Callable[..., Settings], geometry: str):
    settings = make_settings(model=TINY_DYNAMIC)

    async def talk(url: str) -> None:
        now_s, step_s = 0.0, STEP_S
        async with await DrapeStream.open(url, "tube", clock=lambda: now_s, geometry=geometry) as stream:

            async def frame(pose: np.ndarray = POSES[0]) -> Any:
                nonlocal now_s
                now_s += step_s
                await stream.send(pose, TRANS[0])
                received = await (stream.receive() if geometry == "vertices" else stream.receive_jets())
                assert received.age_s == 0.0 and received.frame.sequence == stream._sequence
                return received.frame

            shown = [await frame() for _ in range(NEEDED + 1)][-1]
            counted, step_s = Wire(stream), 1.0 / 30.0
            held = [await frame() for _ in range(60)]
            assert all(one.server_time_s >= shown.server_time_s for one in held)
            assert 60 / 6 <= len(counted.sent) == counted.sent.count(wire.POSE) <= 60 / 4, "acknowledgements: none"
            counted.sent.clear()
            moved = await frame(POSES[1])
            assert counted.sent == [wire.POSE, wire.ACK] and moved.server_time_s > shown.server_time_s

            # A frame that somebody waits for when its pose is answered here.
            for _ in range(int(30 * REST_S) + 4):
                await frame(POSES[1])
            counted.sent.clear()
            for _ in range(3):
                now_s += step_s
                waiting = asyncio.ensure_future(stream.receive() if geometry == "vertices" else stream.receive_jets())
                await asyncio.sleep(0.01)
                sequence = await stream.send(POSES[1], TRANS[0])
                assert (await waiting).frame.sequence == sequence
            assert len(counted.sent) <= 1
            await stream.reopen("tube", geometry=geometry)
            counted.sent.clear()
            await frame(POSES[1])
            assert counted.sent == [wire.POSE, wire.ACK]

    with served(settings) as url:
        asyncio.run(talk(url))


def test_who_sends_a_pose_for_each_frame_waits_for_the_service(make_settings: Callable[..., Settings]):
    settings = make_settings(model=TINY_DYNAMIC)

    async def talk(url: str) -> None:
        now_s = count(0.0, STEP_S)
        async with await DrapeStream.open(url, "tube", clock=lambda: next(now_s)) as stream:
            for _ in range(NEEDED + 1):
                await stream.send(POSES[0], TRANS[0])
                await stream.receive()
            stream._clock, counted = time.perf_counter, Wire(stream)
            for _ in range(40):
                await stream.send(POSES[0], TRANS[0])
                await stream.receive()
            assert counted.sent.count(wire.POSE) >= 20

    with served(settings) as url:
        asyncio.run(talk(url))


PAGE = """
let now = 0;
performance.now = () => (now += 40);
let last = null;
const stream = new Stream({
  onFrame(frame) {
    if (frame.bytes === 40) {
      const { sequence, count } = frame.header;
      const same = frame.data === last.data;
      console.log(JSON.stringify({ sequence, next: last.header.sequence + 1, count, same }));
      process.exit(0);
    }
    last = frame;
    stream.send(pose, [0, 0, 0]);
  },
  onState(state) { if (state === "open") stream.send(pose, [0, 0, 0]); },
});
stream.open({ garment: "tube" });
"""


def test_the_page_shows_the_frame_that_holds(make_settings: Callable[..., Settings], tmp_path: Path):
    with served(make_settings(model=TINY_DYNAMIC)) as url:
        run = subprocess.run(page_command(tmp_path, PAGE, url), capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    assert said["sequence"] == said["next"] > REST_FRAMES and said["same"] and said["count"] > 0


def test_a_pause_is_no_rest_and_neither_are_few_frames(runtime: DrapeRuntime, plan: Plan):
    few = Stream(runtime, plan)
    few.next()
    for _ in range(5):
        few.next(after_s=REST_S)
    assert few.runs == 6
    quick = Stream(runtime, plan)
    for _ in range(2 * REST_FRAMES):
        quick.next(after_s=0.1 * STEP_S)
    assert quick.runs == 2 * REST_FRAMES


@pytest.mark.parametrize(
    "change", ["pose", "plan", *(pytest.param(one, marks=pytest.mark.long) for one in ("trans", "shape", "clock"))]
)
def test_any_change_is_computed(runtime: DrapeRuntime, plan: Plan, change: str):
    stream = Stream(runtime, plan)
    for _ in range(NEEDED + 1):
        stream.next()
    assert stream.runs == NEEDED
    moved = POSES[0].copy()
    moved[5, 1] = np.nextafter(moved[5, 1], 1.0)
    if change == "shape":
        stream.betas = np.full(10, 0.1)
    if change == "plan":
        stream.plan = replace(plan, stepped=True)
    stream.next(
        moved if change == "pose" else POSES[0],
        TRANS[0] + 1e-3 if change == "trans" else TRANS[0],
        after_s=-5.0 * STEP_S if change == "clock" else STEP_S,
    )
    assert stream.runs == NEEDED + 1


def test_one_of_several_at_rest_leaves_the_others_what_they_are(runtime: DrapeRuntime, plan: Plan):
    still, alone = Stream(runtime, plan), Stream(runtime, plan)
    for _ in range(NEEDED):
        still.next()
    moving = PoseInput(POSES[1:2], TRANS[1:2], np.zeros(10), np.array([1.0]), {}, sequence=9)
    rest = PoseInput(POSES[:1], TRANS[:1], np.zeros(10), np.array([still.time_s + 1.0]), still.memories, sequence=7)
    (first, kept), (second, _) = asyncio.run(runtime.stream_frames(plan, [rest, moving]))
    assert isinstance(first, bytes) and isinstance(second, bytes)
    assert wire.unpack_frame(first).sequence == 7 and wire.unpack_frame(second).sequence == 9
    assert kept[KEY] is still.memories[KEY]
    one = alone.next(POSES[1], TRANS[1], after_s=1.0)
    assert_array_equal(wire.unpack_frame(one).positions, wire.unpack_frame(second).positions)


def test_jets_come_again_too(runtime: DrapeRuntime):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(geometry="jets"), messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    stream = Stream(runtime, plan)
    for _ in range(NEEDED):
        last = stream.next()
    same = stream.next()
    assert stream.runs == NEEDED
    before, after = unpack_jets(last), unpack_jets(same)
    assert_array_equal(after.jet, before.jet)
    assert (after.sequence, after.dropped, after.client_time_s) == (NEEDED + 1, 3, stream.time_s)


def test_a_body_at_rest_needs_no_thread(runtime: DrapeRuntime, plan: Plan):
    stream = Stream(runtime, plan)
    for _ in range(NEEDED):
        message = stream.next()
    one = PoseInput(
        POSES[:1], TRANS[:1], stream.betas, np.array([stream.time_s + STEP_S]), stream.memories, sequence=9, dropped=0
    )
    with patch.object(runtime, "_compute", side_effect=AssertionError):
        ((again, _),) = asyncio.run(runtime.stream_frames(plan, [one]))
    assert isinstance(again, bytes)
    assert wire.unpack_frame(again).sequence == 9
    assert_array_equal(wire.unpack_frame(again).vertices(), wire.unpack_frame(message).vertices())
