"""A stream that goes to another process: its frames are those that it would have had, and what it brings is checked."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from pydantic import SecretStr
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from clients.stream import DrapeStream
from drape.errors import InputError, TooLarge
from drape.wire import messages as wire
from drape.wire.options import Advanced, DrapeOptions
from drape.wire.state_pieces import join_state, split_state
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.errors import Busy, Unauthorized
from service.guard.key_file import Client, key_digest
from service.guard.limits import HELD_BYTES
from service.guard.tickets import Tickets
from service.replicas.handover import LIFE_S, STATE_BYTES, Handover
from service.replicas.memory_codec import decode_value, encode_value
from service.settings import Settings
from service.stream import opening
from service.stream.session import StreamSession
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import serve, served
from tests.fixtures.streams import PROTOCOLS, page_command, stream_address
from tests.fixtures.tiny_model import TINY_DYNAMIC

FRAMES, GONE_AFTER = 10, 4
STEP_S = 1.0 / 20.0
SECRET = "one secret of both"


@pytest.fixture(scope="module")
def moving_settings(make_settings: Callable[..., Settings]) -> Settings:
    return make_settings(model=TINY_DYNAMIC, folds=2, ticket_secret=SECRET)


@pytest.fixture(scope="module")
def runtime(moving_settings: Settings) -> Iterator[DrapeRuntime]:
    loaded = DrapeRuntime(moving_settings)
    yield loaded
    loaded.close()


@pytest.fixture(scope="module")
def successor(moving_settings: Settings) -> Iterator[str]:
    with served(moving_settings) as url:
        yield url


def smooth(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A motion that is no jump: a mixture of two poses."""
    (first, second), trans = random_motion(2, spread_rad=0.2)[0], np.zeros((frames, 3))
    share = np.linspace(0.0, 1.0, frames)[:, None, None]
    trans[:, 0] = 0.02 * np.arange(frames)
    return (1.0 - share) * first + share * second, trans


def ending(service: ExitStack, app: FastAPI) -> Callable[[], Awaitable[Any]]:
    """Ends a service, and returns when it drains."""

    async def leave() -> asyncio.Task[None]:
        leaving = asyncio.create_task(asyncio.to_thread(service.close))
        while not app.state.drape.life.draining:
            await asyncio.sleep(0.01)
        return leaving

    return leave


def frames_of(
    url: str, poses: np.ndarray, trans: np.ndarray, leave: Callable[[], Awaitable[Any]] | None = None, **options: Any
) -> tuple[list[wire.Frame], DrapeStream]:
    """The frames of a stream, one after the other, whose service ends after some of them."""
    now_s = [100.0]

    async def talk() -> tuple[list[wire.Frame], DrapeStream]:
        frames, leaving = [], None
        async with await DrapeStream.open(url, "tube", clock=lambda: now_s[0], **options) as stream:
            for i, (pose, place) in enumerate(zip(poses, trans, strict=True)):
                if leave is not None and i == len(poses) - FRAMES + GONE_AFTER:
                    leaving = await leave()
                await stream.send(pose, place)
                frames.append((await stream.receive()).frame)
                now_s[0] += STEP_S
            if leaving is not None:
                await leaving
        return frames, stream

    return asyncio.run(talk())


def assert_equal(got: list[wire.Frame], expected: list[wire.Frame]) -> None:
    assert len(got) == len(expected)
    for one, other in zip(got, expected, strict=True):
        assert np.array_equal(one.positions, other.positions) and np.array_equal(one.root, other.root), one.sequence
        about = replace(one, server_time_s=other.server_time_s, residence_us=other.residence_us)
        names = ("sequence", "client_time_s", "dropped", "pushed", "pushed_share", "push_max_m", "stepped")
        assert [getattr(about, name) for name in names] == [getattr(other, name) for name in names]


@pytest.mark.parametrize("held", [0, 50], ids=["in motion", "at rest"])
def test_frames_after_a_move_are_those_without_it(moving_settings: Settings, successor: str, held: int):
    poses, trans = smooth(FRAMES)
    if held:
        poses, trans = np.repeat(poses[:1], held, axis=0), np.zeros((held, 3))
    expected, stayed = frames_of(successor, poses, trans)
    assert stayed.moves == 0
    with ExitStack() as first:
        leaving = moving_settings.model_copy(update={"successor": successor})
        url = first.enter_context(serve(app := create_app(leaving), leaving))
        got, stream = frames_of(url, poses, trans, ending(first, app))
    assert (stream.moves, stream.url, stream.about["resumed"]) == (1, successor, True)
    assert_equal(got, expected)
    counted = httpx.get(successor + "/metrics").text
    assert 'drape_streams_brought_total{resumed="true"}' in counted


def test_a_service_that_gives_a_stream_away_serves_on(moving_settings: Settings):
    poses, trans = smooth(FRAMES)

    async def talk(url: str) -> list[DrapeStream]:
        streams = [await DrapeStream.open(url, "tube") for _ in range(2)]
        worker = app.state.drape.streams._workers[0]
        worker.get_loop().call_soon_threadsafe(app.state.drape.streams.release, 1)
        for pose, place in zip(poses, trans, strict=True):
            for stream in streams:
                await stream.send(pose, place)
                await stream.receive()
        for stream in streams:
            await stream.close()
        return streams

    with serve(app := create_app(moving_settings), moving_settings) as url:
        went = sorted(asyncio.run(talk(url)), key=lambda stream: stream.moves)
        assert httpx.get(url + "/readyz").status_code == 200
    assert [stream.moves for stream in went] == [0, 1]
    assert went[1].about["resumed"]


def test_a_stream_goes_on_anew_where_its_state_cannot_be_read(moving_settings: Settings, successor: str):
    poses, trans = smooth(FRAMES)
    expected, _ = frames_of(successor, poses, trans)
    other = moving_settings.model_copy(update={"successor": successor, "ticket_secret": SecretStr("another")})
    with ExitStack() as first:
        url = first.enter_context(serve(app := create_app(other), other))
        got, stream = frames_of(url, poses, trans, ending(first, app))
    gone = FRAMES - GONE_AFTER
    assert stream.about["resumed"] is False
    assert_equal(got[: FRAMES - gone], expected[: FRAMES - gone])
    first_there = got[FRAMES - gone].positions
    assert not np.array_equal(first_there, expected[FRAMES - gone].positions)  # so the state is what made them equal
    assert np.isfinite(first_there).all()


def test_a_key_and_a_ticket_move_along(moving_settings: Settings, tmp_path, make_settings: Callable[..., Settings]):
    file = tmp_path / "keys.json"
    file.write_text(json.dumps({"shop": {"sha256": key_digest("drape_key")}}))
    kept = make_settings(keys_file=file, ticket_secret=SECRET)
    poses, trans = smooth(FRAMES)
    with served(kept) as there:
        for ticket in (False, True):
            with ExitStack() as first:
                leaving = kept.model_copy(update={"successor": there})
                url = first.enter_context(serve(app := create_app(leaving), leaving))
                key = "drape_key"
                if ticket:
                    answer = httpx.post(url + "/tickets", headers={"Authorization": f"Bearer {key}"})
                    key = answer.json()["ticket"]
                _, stream = frames_of(url, poses, trans, ending(first, app), key=key)
            assert (stream.moves, stream.about["resumed"]) == (1, True)


class Pair(NamedTuple):
    one: np.ndarray
    two: int


@dataclass(frozen=True, eq=False)
class Kept:
    time_s: float
    pair: Pair | None
    rows: tuple[np.ndarray, ...]
    raw: bytes


def test_what_is_remembered_comes_back_bit_for_bit():
    rng = np.random.default_rng(5)
    rows = (rng.normal(size=(7, 3)), np.asfortranarray(rng.normal(size=(4, 3)).astype(np.float32)), np.zeros((0, 3)))
    pair = Pair(rng.integers(0, 9, 5).astype(np.int32), 3)
    value = (Kept(0.1, pair, rows, b"\0raw"), Kept(-0.0, None, (), b""), np.float32(0.3), "text", None)
    back = decode_value(encode_value(value, (Kept, Pair), ("text",)), (Kept, Pair), ("text",))
    assert back[0].pair.one.dtype == np.int32 and np.array_equal(back[0].pair.one, pair.one) and back[0].pair.two == 3
    for got, expected in zip(back[0].rows, rows, strict=True):
        assert got.dtype == expected.dtype and np.array_equal(got, expected) and got.flags.writeable
        assert got.flags.f_contiguous == expected.flags.f_contiguous
    assert (back[0].time_s, back[0].raw, back[1].pair, back[3:]) == (0.1, b"\0raw", None, ("text", None))
    assert str(back[1].time_s) == "-0.0" and back[2].dtype == np.float32 and back[2] == np.float32(0.3)
    with pytest.raises(TypeError, match="set cannot be encoded"):
        encode_value({1}, ())
    with pytest.raises(InputError, match=r"state: expected the memories of a stream of this release, got .*Kept"):
        decode_value(encode_value(value, (Kept, Pair)), (Pair,))


def test_pieces_of_a_state_are_joined_in_their_order():
    blob = bytes(range(256)) * 9
    pieces = split_state(blob, 1024)
    assert [len(piece) for piece in pieces] == [1024, 1024, 304] and join_state(pieces) == blob
    assert split_state(b"") == []
    with pytest.raises(InputError, match="expected piece 1 of 2, got kind 7, piece 1 of 3"):
        join_state(pieces[:2])
    with pytest.raises(InputError, match="piece 2 of 3"):
        join_state([pieces[0], pieces[2], pieces[1]])


def test_a_state_is_for_its_key_scene_and_minute_only(runtime: DrapeRuntime):
    handover, ours = Handover(runtime, Tickets(SECRET)), Client("shop")
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    betas = np.zeros(10)
    session = StreamSession(plan, betas, 2, runtime.steps(plan), dropped=3)
    blob = handover.state(session, ours, 1, now_s=1000.0)

    def read(blob: bytes = blob, client: Client = ours, at_s: float = 1001.0, **changes: Any):
        scene = changes.get("plan", plan)
        steps, shape = runtime.steps(scene), changes.get("betas", betas)
        return Handover(runtime, changes.get("tickets", Tickets(SECRET))).read_state(
            blob, client, scene, steps, shape, now_s=at_s
        )

    assert (read().dropped, read().tier, read().memories) == (3, 1, {})
    for forged in (blob[:-1], b"", blob[:40] + b"x" + blob[41:]):
        with pytest.raises(Unauthorized, match="did not sign"):
            read(forged)
    with pytest.raises(Unauthorized, match="did not sign"):
        read(tickets=Tickets("another"))
    with pytest.raises(Unauthorized, match="has expired"):
        read(at_s=1001.0 + LIFE_S)
    with pytest.raises(Unauthorized, match="of another key"):
        read(client=Client("thief"))
    with pytest.raises(InputError, match="the same shape, got another"):
        read(betas=np.ones(10))
    with pytest.raises(InputError, match="the same options, got another"):
        read(plan=runtime.plan(plan.scene, DrapeOptions(advanced=Advanced(folds=1)), messages=True))


def test_a_state_that_nobody_could_read_or_that_is_too_long_is_not_made(runtime: DrapeRuntime):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(), messages=True)
    session = StreamSession(plan, np.zeros(10), 2, memories={("folds", "key"): np.zeros(9 * 2**20, np.uint8)})
    assert Handover(runtime, Tickets()).state(session, Client(), 0) == b""
    assert Handover(runtime, Tickets(SECRET)).state(session, Client(), 0) == b""


def test_states_that_come_are_bounded_one_by_one_and_together(runtime: DrapeRuntime):
    handover, most = Handover(runtime, Tickets(SECRET)), STATE_BYTES
    with handover.incoming() as pieces:
        pieces.take(bytes(most))
        with pytest.raises(TooLarge, match="state: expected at most"):
            pieces.take(bytes(2**16))
        for _ in range(HELD_BYTES // most - 1):
            handover.hold(0, most)
        with handover.incoming() as others, pytest.raises(Busy, match="of all streams together"):
            others.take(bytes(most))
        assert others.size == 0
    with handover.incoming() as others:
        others.take(bytes(most))  # what the first one held is free again


def test_pieces_without_an_end_are_too_slow(settings: Settings, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(opening, "OPEN_S", 0.3)
    monkeypatch.setattr(opening, "PACE_BYTES_S", 2**20)

    async def talk(url: str) -> tuple[str, int]:
        async with connect(stream_address(url), subprotocols=PROTOCOLS) as socket:
            await socket.send(split_state(bytes(1000))[0])
            said = json.loads(await socket.recv())
            with pytest.raises(ConnectionClosed) as closed:
                await socket.recv()
            assert closed.value.rcvd is not None
            return said["got"], closed.value.rcvd.code

    with served(settings) as url:
        assert asyncio.run(talk(url)) == ("1016 bytes of a state", 4408)


SCRIPT = """
const seen = { states: [], refused: "" };
let frames = 0;
const stream = new Stream({
  onFrame() {
    frames += 1;
    if (frames === 5) console.log("leave");
    if (stream.base !== location.origin && frames >= 10) {
      console.log(JSON.stringify({ base: stream.base, ...seen, left: stream.state.length }));
      process.exit(0);
    }
  },
  onState(state, refusal) { seen.states.push(state); if (state === "refused") seen.refused = refusal.message; },
});
stream.open({ garment: "tube" });
setInterval(() => stream.send(pose, [0, 0, 0]), 20);
"""


def test_the_page_goes_on_where_it_is_told(moving_settings: Settings, successor: str, tmp_path: Path):
    before = httpx.get(successor + "/metrics").text
    with ExitStack() as first:
        leaving = moving_settings.model_copy(update={"successor": successor})
        url = first.enter_context(served(leaving))
        with subprocess.Popen(page_command(tmp_path, SCRIPT, url), stdout=subprocess.PIPE, text=True) as page:
            assert page.stdout is not None
            assert page.stdout.readline() == "leave\n"
            first.close()
            said = json.loads(page.stdout.readline())
    assert said == {"base": successor, "states": ["open", "open"], "refused": "", "left": 0}
    counted = re.compile(r'drape_streams_brought_total{resumed="true"} (\S+)')
    after = httpx.get(successor + "/metrics").text
    assert float(counted.findall(after)[0]) == sum(map(float, counted.findall(before))) + 1
