"""Streams under any sequence of messages: a hypothesis state machine over ``WS /stream``."""

from __future__ import annotations

import asyncio
import gc
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from socket import SHUT_RDWR
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from drape.wire import messages as wire
from drape.wire.jets import JetFrame, unpack_jets
from service.app import create_app
from service.errors import Draining
from service.settings import Settings
from service.state import State
from service.stream.session import StreamSession
from service.watch.probes import Lifecycle
from tests.fixtures.fuzzing import examples
from tests.fixtures.patience import wait_until
from tests.fixtures.serving import serve
from tests.fixtures.streams import PROTOCOLS, patient_streams, stream_address
from tests.fixtures.tiny_model import TINY_DYNAMIC

MOST_STREAMS = 3
BURST = 5
ANSWER_S = 120.0
STEPS_S = (1.0 / 30.0, 1.0 / 30.0, 0.0, 1e-9, 0.3, 5.0, -1.0)
SPREADS_RAD = (0.0, 0.1, 0.1, 0.5, 3.0, 1000.0)
OPENINGS = (
    {},
    {"push_out": False},
    {"motion": 0.0},
    {"folds": 0},
    {"passes": 0, "folds": 1},
    {"geometry": "jets"},
    {"betas": [1.5, -1.0]},
    {"inertia": "mesh"},
    {"pixels_per_m": 50.0},
)
REFUSED_OPENINGS = {
    "no JSON": 4400,
    '{"type": "open"}': 4400,
    '{"type": "open", "garment": "cape"}': 4404,
    '{"type": "open", "garment": "tube", "folds": 99}': 4400,
    '{"type": "open", "garment": "tube", "betas": [99]}': 4422,
    '{"type": "open", "garment": "tube", "colour": "red"}': 4400,
    '{"type": "open", "garments": ["tube", "tube"], "garment": "tube"}': 4400,
}


class Ready(Lifecycle):
    """Knows the loop that it was made ready on."""

    loop: asyncio.AbstractEventLoop

    def ready(self) -> None:
        self.loop = asyncio.get_running_loop()
        super().ready()


@dataclass
class Running:
    """A service in another thread of this process."""

    url: str
    state: State
    loop: asyncio.AbstractEventLoop

    def say_to_move(self) -> None:
        """Sends every stream to another process, as the end of a service does; this one goes on."""
        done = threading.Event()

        def move() -> None:
            self.state.streams.move(Draining())
            done.set()

        self.loop.call_soon_threadsafe(move)
        assert done.wait(ANSWER_S)


@pytest.fixture(scope="module")
def running(make_settings: Callable[..., Settings]) -> Iterator[Running]:
    settings = make_settings(model=TINY_DYNAMIC, folds=1, ticket_secret="one of both", stream_step_down=False)
    life = Ready(stuck_s=60.0)
    app = create_app(settings, lifecycle=life)
    with patient_streams(), serve(app, settings) as url:
        yield Running(url, app.state.drape, life.loop)


@dataclass(eq=False)
class Stream:
    """A client: what it opened with, its clock, and every opening and answered pose since its cloth had no past."""

    socket: ClientConnection
    opening: dict[str, Any]
    now_s: float = 100.0
    dropped: int = 0
    past: list[Any] = field(default_factory=list)
    known: bool = True  # whether ``past`` holds all that the cloth has felt

    def pose(self, seed: int, spread_rad: float, step_s: float, sequence: int) -> wire.Pose:
        rng = np.random.default_rng(seed)
        self.now_s += step_s
        pose = np.float32(spread_rad * rng.uniform(-1.0, 1.0, (24, 3))).astype(float)
        return wire.Pose(sequence, self.now_s, rng.normal(size=3), pose)


def opened(socket: ClientConnection, opening: dict[str, Any]) -> dict[str, Any]:
    """The service's answer to ``opening``; frames of the opening before are read past."""
    socket.send(json.dumps(opening))
    while not isinstance(said := socket.recv(ANSWER_S), str):
        pass
    about = json.loads(said)
    assert about["type"] == "opened", said
    return about


def received(socket: ClientConnection) -> wire.Frame | JetFrame:
    """The next frame, acknowledged."""
    message = socket.recv(ANSWER_S)
    assert isinstance(message, bytes), message
    frame = unpack_jets(message) if wire.message_kind(message) == wire.JETS else wire.unpack_frame(message)
    socket.send(wire.pack_ack(frame.sequence))
    return frame


def numbers(frame: wire.Frame | JetFrame) -> list[np.ndarray]:
    """All that a frame says of the cloth."""
    if isinstance(frame, wire.Frame):
        return [frame.positions, frame.root, np.array([frame.pushed_share, frame.push_max_m])]
    return [frame.root, frame.centre, frame.rotation, frame.jet]


def closing(socket: ClientConnection) -> tuple[int, list[str | bytes]]:
    """The close code, and what came before it."""
    said: list[str | bytes] = []
    while True:
        try:
            said.append(socket.recv(ANSWER_S))
        except ConnectionClosed as closed:
            close = closed.rcvd
            break
    assert close is not None, "the connection was lost without a close frame"
    return close.code, said


class Streams(RuleBasedStateMachine):
    """Some clients of one service; what is legal is answered in order, what is not closes its own stream alone."""

    running: ClassVar[Running]

    def __init__(self) -> None:
        super().__init__()
        self.streams: list[Stream] = []
        self.sockets = ExitStack()

    def connection(self) -> ClientConnection:
        made = connect(stream_address(self.running.url), subprotocols=PROTOCOLS, compression=None, max_size=None)
        return self.sockets.enter_context(made)

    def one_of(self, number: int) -> Stream:
        return self.streams[number % len(self.streams)]

    def any_stream(self) -> bool:
        return bool(self.streams)

    @initialize(options=st.sampled_from(OPENINGS))
    def first(self, options: dict[str, Any]) -> None:
        self.open(options, True)

    @precondition(lambda self: len(self.streams) < MOST_STREAMS)
    @rule(options=st.sampled_from(OPENINGS), moves=st.booleans())
    def open(self, options: dict[str, Any], moves: bool) -> None:
        opening = {"type": "open", "garment": "tube", "moves": moves} | options
        socket = self.connection()
        opened(socket, opening)
        self.streams.append(Stream(socket, opening, past=[opening]))

    @rule(text=st.sampled_from(sorted(REFUSED_OPENINGS)))
    def open_with_a_mistake(self, text: str) -> None:
        socket = self.connection()
        socket.send(text)
        self.ended(socket, REFUSED_OPENINGS[text])

    @precondition(any_stream)
    @rule(
        which=st.integers(0, MOST_STREAMS - 1),
        count=st.sampled_from([1, 1, 1, BURST]),
        times=st.integers(1, 4),
        seed=st.integers(0, 2**16),
        spread_rad=st.sampled_from(SPREADS_RAD),
        step_s=st.sampled_from(STEPS_S),
        sequence=st.sampled_from([0, 1, 7, 2**32 - 1 - BURST]),
    )
    def send(
        self, which: int, count: int, times: int, seed: int, spread_rad: float, step_s: float, sequence: int
    ) -> None:
        for i in range(times):
            self.send_at_once(self.one_of(which), count, seed + BURST * i, spread_rad, step_s, sequence)

    def send_at_once(
        self, stream: Stream, count: int, seed: int, spread_rad: float, step_s: float, sequence: int
    ) -> None:
        """Poses at once: the last one is answered, of the others each is answered or counted as dropped."""
        poses = [stream.pose(seed + i, spread_rad, step_s, sequence + i) for i in range(count)]
        for pose in poses:
            stream.socket.send(wire.pack_pose(pose))
        waiting = list(poses)
        while waiting:
            frame = received(stream.socket)
            assert frame.dropped >= stream.dropped
            while waiting and (waiting[0].sequence, waiting[0].client_time_s) != (frame.sequence, frame.client_time_s):
                waiting.pop(0)
            assert waiting, f"a frame for a pose that was not sent, or not in order: {frame.sequence}"
            stream.dropped = frame.dropped
            stream.past.append((waiting.pop(0), frame))
            assert all(np.isfinite(array).all() for array in numbers(frame))

    @precondition(any_stream)
    @rule(which=st.integers(0, MOST_STREAMS - 1), seed=st.integers(0, 2**16))
    def stand_still(self, which: int, seed: int) -> None:
        """A pose that is held until cloth rests and nothing is computed any more."""
        for _ in range(34):
            self.send_at_once(self.one_of(which), 1, seed, 0.1, 0.1, 3)

    @precondition(any_stream)
    @rule(which=st.integers(0, MOST_STREAMS - 1), options=st.sampled_from(OPENINGS), under_way=st.booleans())
    def turn(self, which: int, options: dict[str, Any], under_way: bool) -> None:
        """Another opening on the same connection, with a pose on its way or without."""
        stream = self.one_of(which)
        if under_way:
            stream.socket.send(wire.pack_pose(stream.pose(1, 0.1, 0.1, 5)))
            stream.known = False  # whether the cloth has felt it nobody can tell
        stream.opening = {"type": "open", "garment": "tube", "moves": stream.opening["moves"]} | options
        opened(stream.socket, stream.opening)
        stream.past.append(stream.opening)

    @precondition(any_stream)
    @rule(
        which=st.integers(0, MOST_STREAMS - 1),
        message=st.one_of(
            st.sampled_from(
                [
                    (b"\0" * 70_000, 1009),
                    (b"\0" * 500, 4400),
                    (wire.pack_pose(wire.Pose(1, np.nan, np.zeros(3), np.zeros((24, 3)))), 4400),
                    (wire.pack_pose(wire.Pose(1, 0.0, np.zeros(3), np.full((24, 3), np.nan))), 4400),
                    (wire.pack_pose(wire.Pose(1, 0.0, np.full(3, 1e7), np.zeros((24, 3)))), 4422),
                    (wire.pack_pose(wire.Pose(1, 0.0, np.zeros(3), np.full((24, 3), 1001.0))), 4422),
                    *REFUSED_OPENINGS.items(),
                ]
            ),
            st.tuples(st.binary(max_size=400), st.just(4400)),
        ),
    )
    def send_a_mistake(self, which: int, message: tuple[bytes | str, int]) -> None:
        stream = self.streams.pop(which % len(self.streams))
        stream.socket.send(message[0])
        self.ended(stream.socket, message[1])

    @precondition(any_stream)
    @rule(which=st.integers(0, MOST_STREAMS - 1), how=st.sampled_from(["close", "vanish"]), under_way=st.booleans())
    def leave(self, which: int, how: str, under_way: bool) -> None:
        stream = self.streams.pop(which % len(self.streams))
        if under_way:
            stream.socket.send(wire.pack_pose(stream.pose(2, 0.1, 0.1, 6)))
        if how == "vanish":
            stream.socket.socket.shutdown(SHUT_RDWR)
        else:
            stream.socket.close()

    @precondition(any_stream)
    @rule(broken=st.booleans())
    def move(self, broken: bool) -> None:
        """Streams are sent away; those that move go on with what they felt, or anew where that was changed."""
        self.running.say_to_move()
        for stream in list(self.streams):
            code, said = closing(stream.socket)
            assert code == 1012
            about = json.loads(said[-1])
            if not stream.opening["moves"]:
                assert (about["type"], about["kind"]) == ("error", "Draining")
                self.streams.remove(stream)
                continue
            pieces = [message for message in said[:-1] if isinstance(message, bytes)]
            assert about["type"] == "moved" and about["pieces"] == len(pieces) > 0
            if broken:
                pieces[-1] = pieces[-1][:-1] + bytes([pieces[-1][-1] ^ 1])
            stream.socket = self.connection()
            for piece in pieces:
                stream.socket.send(piece)
            assert opened(stream.socket, stream.opening)["resumed"] is not broken
            if broken:
                stream.past, stream.known, stream.dropped = [stream.opening], True, 0
            self.send_at_once(stream, 1, 9, 0.1, 0.03, 9)

    @precondition(any_stream)
    @rule(which=st.integers(0, MOST_STREAMS - 1))
    def replay(self, which: int) -> None:
        self.same_again(self.one_of(which))

    def same_again(self, stream: Stream) -> None:
        """The same openings and poses on a new connection give the same bits."""
        if not stream.known:
            return
        socket = self.connection()
        for one in stream.past:
            if isinstance(one, dict):
                opened(socket, one)
                continue
            pose, before = one
            socket.send(wire.pack_pose(pose))
            for now, then in zip(numbers(received(socket)), numbers(before), strict=True):
                assert np.array_equal(now, then), f"other bits for the pose {pose.sequence}"
        socket.close()

    def ended(self, socket: ClientConnection, code: int) -> None:
        got, said = closing(socket)
        assert got == code, said
        if code != 1009:
            about = json.loads(said[-1])
            assert about["type"] == "error" and about["kind"] != "InternalError" and about["cure"]

    def teardown(self) -> None:
        for stream in self.streams:
            self.same_again(stream)
        self.sockets.close()
        wait_until(lambda: not self.running.state.streams.count, ANSWER_S, "a closed stream keeps its place")


def sessions() -> list[StreamSession]:
    gc.collect()
    return [one for one in gc.get_objects() if type(one) is StreamSession]


def test_any_sequence_of_messages_keeps_the_rules_of_streams(running: Running):
    before = sessions()
    machine = type("Streams", (Streams,), {"running": running})
    run_state_machine_as_test(machine, settings=examples(12, stateful_step_count=20))
    until_s = time.monotonic() + ANSWER_S
    while left := [one for one in sessions() if not any(one is other for other in before)]:
        assert time.monotonic() < until_s, f"{len(left)} closed streams are still held"
        del left
        time.sleep(0.05)
    assert running.state.handover._held == 0
    assert 'kind="InternalError"' not in running.state.runtime.metrics.text().decode()
