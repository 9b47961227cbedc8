"""WS /stream on a real connection: numbers, credit, drops, and every way to be shown the door."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import time
from collections.abc import Awaitable, Callable
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.wire import messages as wire
from service.settings import Settings
from service.stream import opening, routes
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import served
from tests.fixtures.streams import PROTOCOLS, stream_address
from tests.fixtures.tiny_model import expected_vertices

OPEN = {"type": "open", "garment": "tube", "push_out": False}
REST = np.zeros((24, 3))


def run(url: str, talk: Callable[[ClientConnection], Awaitable[Any]], **options: Any) -> Any:
    async def whole() -> Any:
        options.setdefault("subprotocols", PROTOCOLS)
        async with connect(stream_address(url), compression=None, **options) as socket:
            return await talk(socket)

    return asyncio.run(whole())


async def opened(socket: ClientConnection, **changes: Any) -> dict:
    await socket.send(json.dumps(OPEN | changes))
    return json.loads(await socket.recv())


async def send(
    socket: ClientConnection, sequence: int, pose: np.ndarray = REST, trans: np.ndarray | None = None
) -> None:
    place = np.zeros(3) if trans is None else trans
    await socket.send(wire.pack_pose(wire.Pose(sequence, time.perf_counter(), place, pose)))


async def frame(socket: ClientConnection, *, ack: bool = True) -> wire.Frame:
    message = await asyncio.wait_for(socket.recv(), PATIENT_S)
    assert isinstance(message, bytes), message
    received = wire.unpack_frame(message)
    if ack:
        await socket.send(wire.pack_ack(received.sequence))
    return received


async def shown_out(socket: ClientConnection) -> tuple[int, str, dict]:
    """Close code, close reason and the message before it; frames on the way are read past."""
    said: dict = {}
    while True:
        try:
            message = await asyncio.wait_for(socket.recv(), PATIENT_S)
        except ConnectionClosed as closed:
            close = closed.rcvd
            break
        if isinstance(message, str):
            said = json.loads(message)
    assert close is not None, "the connection was lost without a close frame"
    return close.code, close.reason, said


def test_frames_are_the_closed_form_to_half_a_step(live: str, body: BodyModel, tube: Garment):
    poses, trans = random_motion(6)
    betas = [0.5] * 10

    async def talk(socket: ClientConnection) -> list[wire.Frame]:
        about = await opened(socket, betas=betas)
        assert about["type"] == "opened"
        assert (about["vertices"], about["garment"], about["credit"], about["push_out"]) == (216, "tube", 2, False)
        frames = []
        for i in range(6):
            await send(socket, i, poses[i], trans[i])
            frames.append(await frame(socket))
        return frames

    frames = run(live, talk)
    # Poses travel as float32.
    expected = expected_vertices(body, tube, poses.astype(np.float32).astype(float), trans, np.array(betas))
    for i, got in enumerate(frames):
        assert got.sequence == i
        bound = 0.5 * got.box_step.max() + 3e-6
        assert_allclose(got.vertices(), expected[i], rtol=0, atol=bound)
        assert abs(got.server_time_s - time.time()) < 60.0
        assert 0 < got.residence_us < 5e6
        assert got.dropped == 0 and not got.pushed


def test_push_out_is_said_in_the_header(live: str):
    async def talk(socket: ClientConnection) -> wire.Frame:
        assert (await opened(socket, push_out=None))["push_out"] is True
        assert (await opened(socket, push_out=None, advanced={"push_out": False}))["push_out"] is False
        assert (await opened(socket, push_out=None, advanced=None))["push_out"] is True
        await send(socket, 1, random_motion(1, spread_rad=0.5)[0][0])
        return await frame(socket)

    got = run(live, talk)
    assert got.pushed and 0.0 < got.pushed_share < 1.0 and 0.0 < got.push_max_m < 0.2


def test_the_newest_pose_wins_and_drops_are_counted(live: str):
    async def talk(socket: ClientConnection) -> tuple[list[wire.Frame], int]:
        await opened(socket)
        frames, sent = [], 60
        for i in range(sent):
            await send(socket, i)
        while not frames or frames[-1].sequence < sent - 1:
            frames.append(await frame(socket))
        return frames, sent

    frames, sent = run(live, talk)
    assert [f.sequence for f in frames] == sorted({f.sequence for f in frames})
    assert frames[-1].sequence == sent - 1
    # What was neither sent nor dropped would be lost without a word.
    assert len(frames) + frames[-1].dropped == sent


def test_without_credit_nothing_is_sent_and_with_it_the_newest(live: str):
    async def talk(socket: ClientConnection) -> None:
        await opened(socket)
        for i in range(2):
            await send(socket, i)
            await frame(socket, ack=False)
        for i in range(2, 10):
            await send(socket, i)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(socket.recv(), 0.2)
        await socket.send(wire.pack_ack(0))
        late = await frame(socket)
        assert (late.sequence, late.dropped) == (9, 7)

    run(live, talk)


def test_a_stream_can_turn_to_another_garment_or_shape(live: str):
    async def talk(socket: ClientConnection) -> None:
        await opened(socket)
        await send(socket, 1)
        before = await frame(socket)
        for i in range(2, 6):
            await send(socket, i)
        await socket.send(json.dumps(OPEN | {"betas": [2.0]}))
        while not isinstance(await socket.recv(), str):
            pass
        await send(socket, 6)
        after = await frame(socket)
        assert after.sequence == 6
        assert np.abs(after.vertices() - before.vertices()).max() > 0.01
        # An answer to a frame of the first opening is not held against the client.
        await socket.send(wire.pack_ack(3))
        await send(socket, 7)
        assert (await frame(socket)).sequence == 7

    run(live, talk)


@pytest.mark.parametrize(
    ("first", "code", "word"),
    [
        ('{"type": "open", "garment": "cape"}', 4404, "garment: expected one of: tube"),
        ('{"type": "open"}', 4400, "garment: expected a value"),
        ('{"type": "hello", "garment": "tube"}', 4400, "type"),
        ("not json", 4400, "text that is not JSON"),
        ("[1]", 4400, "a list of 1"),
        ('{"type": "open", "garment": "tube", "betas": [NaN]}', 4422, "betas[0]: expected a finite"),
        ('{"type": "open", "garment": "tube", "betas": [99]}', 4422, "betas[0]"),
        (b"\0\0", 4400, "open message: expected JSON text, got bytes"),
    ],
)
def test_an_opening_that_is_wrong_is_told_so(live: str, first: str | bytes, code: int, word: str):
    async def talk(socket: ClientConnection) -> tuple[int, str, dict]:
        await socket.send(first)
        return await shown_out(socket)

    got, reason, said = run(live, talk)
    assert got == code
    assert word in said["detail"]
    assert said["cure"] and "Content-Type" not in said["cure"] and reason


def bad_pose(**changes: Any) -> bytes:
    values = {"sequence": 1, "client_time_s": 0.0, "trans": np.zeros(3), "pose": REST}
    return wire.pack_pose(wire.Pose(**(values | changes)))


@pytest.mark.parametrize(
    ("message", "code", "word"),
    [
        (bad_pose(pose=np.full((24, 3), np.nan)), 4400, "pose message: expected finite numbers, got nan in pose[0]"),
        (bad_pose(trans=np.array([0.0, np.inf, 0.0])), 4400, "trans[1]"),
        (bad_pose(client_time_s=np.nan), 4400, "client_time_s"),
        (bad_pose(pose=np.full((24, 3), 2000.0)), 4422, "at most 1000 rad"),
        (bad_pose(trans=np.full(3, 1e8)), 4422, "at most 1e+06 m"),
        (bad_pose()[:-4], 4400, "expected 336 bytes, got 332 bytes"),
        (b"", 4400, "at least 16 bytes"),
        (b"\xff" * 336, 4400, "magic"),
        (wire.pack_ack(77), 4400, "ack message: expected the sequence of a frame that was sent, got 77"),
        ("more words", 4400, "not JSON"),
    ],
)
def test_a_message_that_is_wrong_closes_with_a_sentence(live: str, message: str | bytes, code: int, word: str):
    async def talk(socket: ClientConnection) -> tuple[int, str, dict]:
        await opened(socket)
        await socket.send(message)
        return await shown_out(socket)

    got, _, said = run(live, talk)
    assert got == code
    assert word in said["detail"] and "Content-Type" not in said["cure"]
    assert httpx.get(live + "/health").json()["status"] == "ok"


def test_too_large_a_message_is_cut_off(live: str):
    async def talk(socket: ClientConnection) -> int:
        await opened(socket)
        await socket.send(b"\0" * 100_000)
        return (await shown_out(socket))[0]

    assert run(live, talk) == 1009


def test_silence_is_ended(make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch):
    async def never_opens(socket: ClientConnection) -> tuple[int, str, dict]:
        return await shown_out(socket)

    async def opens_only(socket: ClientConnection) -> tuple[int, str, dict]:
        await opened(socket)
        return await shown_out(socket)

    async def never_acknowledges(socket: ClientConnection) -> tuple[int, str, dict]:
        await opened(socket)
        await send(socket, 1)
        return await shown_out(socket)

    monkeypatch.setattr(opening, "OPEN_S", 2.0)
    monkeypatch.setattr(routes, "ACK_S", 2.0)
    with served(make_settings(stream_idle_s=3.0)) as url:
        for talk, words in (
            (never_opens, "open message"),
            (opens_only, "a pose within 3 s"),
            (never_acknowledges, "an acknowledgement within 2 s"),
        ):
            code, _, said = run(url, talk)
            assert code == 4408
            assert words in said["detail"]


def test_a_garment_that_takes_long_to_make_ready_does_not_end_its_stream(make_settings, monkeypatch):
    """Acknowledgements lie unread until it is ready, and the client was shown out as if it had sent none."""
    ready_s = iter((0.0, 1.5))

    async def slow(*given: Any) -> opening.Opening:
        await asyncio.sleep(next(ready_s))
        return await opening.read_opening(*given)

    async def talk(socket: ClientConnection) -> int:
        await opened(socket)
        await send(socket, 1)
        first = await frame(socket, ack=False)
        await socket.send(json.dumps(OPEN))
        await socket.send(wire.pack_ack(first.sequence))
        assert json.loads(await asyncio.wait_for(socket.recv(), 10.0))["type"] == "opened"
        await send(socket, 2)
        return (await frame(socket)).sequence

    monkeypatch.setattr(routes, "ACK_S", 0.4)
    monkeypatch.setattr(routes, "read_opening", slow)
    with served(make_settings()) as url:
        assert run(url, talk) == 2


def test_more_streams_than_places_are_turned_away(live: str, live_settings: Settings):
    async def many() -> tuple[int, str, dict]:
        async def one() -> ClientConnection:
            return await connect(stream_address(live), subprotocols=PROTOCOLS)

        sockets = [await one() for _ in range(live_settings.stream_sessions)]
        for each in sockets:
            await opened(each)
        try:
            return await shown_out(await one())
        finally:
            for each in sockets:
                await each.close()

    code, _, said = asyncio.run(many())
    assert code == 1013
    assert "streams: expected fewer than 4" in said["detail"]
    # Places come back.
    run(live, lambda socket: opened(socket))


def test_another_protocol_or_origin_is_refused_before_it_opens(live: str):
    async def nothing(socket: ClientConnection) -> None:
        raise AssertionError("it opened")

    for options, status, word in (
        ({"subprotocols": None}, 400, "drape.v1"),
        ({"subprotocols": ["drape.v0"]}, 400, "got drape.v0"),
        ({"origin": "https://elsewhere.example"}, 403, "DRAPE_ALLOWED_ORIGINS"),
    ):
        with pytest.raises(InvalidStatus) as refused:
            run(live, nothing, **options)
        assert refused.value.response.status_code == status
        assert word in json.loads(refused.value.response.body or b"{}")["detail"]


def test_its_own_page_and_named_origins_are_let_in(live: str, make_settings: Callable[..., Settings]):
    run(live, lambda socket: opened(socket), origin=live)
    with served(make_settings(allowed_origins=("https://shop.example",))) as url:
        run(url, lambda socket: opened(socket), origin="https://shop.example")
        answer = httpx.get(url + "/health", headers={"Origin": "https://shop.example"})
        assert answer.headers["access-control-allow-origin"] == "https://shop.example"


def test_a_client_that_stops_reading_is_cut_and_others_are_not_delayed(make_settings, monkeypatch: pytest.MonkeyPatch):
    """Its window is closed, so that even the refusal cannot be sent: only an abort frees the connection."""
    for name, value in (("ACK_S", 0.4), ("SEND_S", 0.3), ("CREDIT", 16)):
        monkeypatch.setattr(routes, name, value)
    with served(make_settings()) as url:
        host, port = url.removeprefix("http://").split(":")
        stalled = socket.socket()
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        stalled.connect((host, int(port)))
        stalled.sendall(
            f"GET /stream HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {wire.SUBPROTOCOL}\r\n\r\n".encode()
        )
        stalled.sendall(masked(json.dumps(OPEN).encode(), 0x81))
        stalled.sendall(masked(bad_pose(), 0x82))

        async def healthy(ws: ClientConnection) -> float:
            await opened(ws)
            ages = []
            for i in range(20):
                begun = time.perf_counter()
                await send(ws, i)
                await frame(ws)
                ages.append(time.perf_counter() - begun)
            return float(np.median(ages))

        assert run(url, healthy) < 0.5
        wait_until(lambda: not httpx.get(url + "/health").json()["sessions"], missing="it keeps its place")
        stalled.close()


def masked(payload: bytes, opcode: int) -> bytes:
    """A client's WebSocket frame with a zero mask."""
    head = (
        struct.pack("!BB", opcode, 0x80 | len(payload))
        if len(payload) < 126
        else struct.pack("!BBH", opcode, 0xFE, len(payload))
    )
    return head + b"\0\0\0\0" + payload


def test_a_client_that_vanishes_frees_its_place(live: str):
    async def vanish(ws: ClientConnection) -> None:
        await opened(ws)
        await send(ws, 1)
        ws.transport.abort()

    run(live, vanish)
    wait_until(lambda: not httpx.get(live + "/health").json()["sessions"])
