"""WS /stream: one JSON message opens, binary poses come in, binary frames go out, as in docs/reference/wire.md.

A session has a mailbox for one pose; a newer pose replaces it and is counted. Credit bounds the frames under way.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from drape.errors import DrapeError, InputError
from drape.stages.batch import Memories, check_places, check_poses
from drape.stages.encode import shown_message
from drape.stages.plan import Plan
from drape.stages.stage import carried
from drape.wire import messages as wire
from drape.wire.rig_poses import RigPose, unpack_rig_pose
from service.errors import Draining, InternalError, TooSlow, close_reason, error_message, problem_response, rule_for
from service.guard.access import OFFER
from service.state import State
from service.stream.opening import Opening, first_text, opened, read_opening, text_of

if TYPE_CHECKING:
    from opentelemetry.trace import Link

    from drape.avatar.wearer import Wearer
    from service.guard.keys import Client
    from service.watch.metrics import Metrics

router = APIRouter()
WATCH_S = 0.25
ABORT = "drape.abort"  # what service.server puts into the scope: closes the connection without flushing
log = logging.getLogger("drape.service")


@dataclass(frozen=True, eq=False)
class Waiting:
    """A pose, ours or one of the avatar's rig, and the time [s] (monotonic) it came."""

    pose: wire.Pose | RigPose
    arrived_s: float


@dataclass(eq=False)
class Session:
    """One client's stream.

    ``steps``: ``plan`` as each tier holds it, the one that computes least first. ``memories``: what the stages keep of
    the frames so far. ``generation``: the number of openings; a result that was begun for an earlier one is thrown
    away. ``dropped``: poses that newer ones replaced; of these ``late`` waited for nothing but a worker. ``moves``: it
    can go on at another process; while it is ``leaving`` nothing is begun for it here. ``same``: the client takes the
    word that its frame still holds; ``shown`` is the message of that frame. ``wearer``: the avatar that it shows.
    ``link`` leads to its request's span.
    """

    plan: Plan
    betas: np.ndarray
    credit: int
    steps: tuple[Plan, ...] = ()
    memories: Memories = field(default_factory=dict)
    generation: int = 0
    moves: bool = False
    same: bool = False
    wearer: Wearer | None = None
    shown: bytes | None = None
    link: Link | None = None
    leaving: bool = False
    dropped: int = 0
    late: int = 0
    waiting: Waiting | None = None
    outbox: bytes | None = None
    outbox_since_s: float = 0.0  # when the pose of the frame in the outbox came
    failure: DrapeError | None = None
    last_heard_s: float = field(default_factory=time.monotonic)
    # Sequence of every frame that was begun and is not acknowledged, and when [s] it was ready; infinity before that.
    under_way: list[tuple[int, float]] = field(default_factory=list)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def reopen(self, asked: Opening) -> None:
        """Turns the session to another plan or shape; what another shape leaves behind is no motion of this one."""
        same_body = np.array_equal(asked.betas, self.betas)
        self.memories = carried(self.memories, self.plan, asked.plan) if same_body else {}
        self.plan, self.betas, self.steps = asked.plan, asked.betas, asked.steps
        self.moves, self.same, self.wearer = asked.moves, asked.same, asked.wearer
        self.generation += 1
        self.last_heard_s = time.monotonic()
        self.waiting, self.outbox, self.shown = None, None, None
        self.under_way.clear()

    def put(self, pose: wire.Pose | RigPose) -> None:
        """Puts a pose into the mailbox; one that waited there is dropped and counted."""
        self.last_heard_s = time.monotonic()
        self.late += self.due()
        self.dropped += self.waiting is not None
        self.waiting = Waiting(pose, self.last_heard_s)

    def ready(self) -> bool:
        """Whether a pose waits that may be computed now."""
        return self.due() and not self.computing

    def due(self) -> bool:
        """Whether a pose waits for nothing but a worker; the one that computes the frame before counts too."""
        free = len(self.under_way) < self.credit and self.outbox is None and not self.leaving
        return self.waiting is not None and free

    @property
    def computing(self) -> bool:
        """Whether a frame of this opening is being computed."""
        return not all(math.isfinite(ready_s) for _, ready_s in self.under_way)

    @property
    def settled(self) -> bool:
        """Whether nothing is computed for it and no frame waits to be sent."""
        return self.outbox is None and not self.computing

    def held_to(self, tier: int) -> Plan:
        """Returns its plan as the step with the index ``tier`` holds it."""
        return self.steps[tier] if tier < len(self.steps) else self.plan

    def take(self) -> Waiting:
        """The waiting pose, now under way."""
        assert self.waiting is not None
        taken, self.waiting = self.waiting, None
        self.under_way.append((taken.pose.sequence, math.inf))
        return taken

    def taken_late(self) -> int:
        """The number of poses that were late since the last call."""
        late, self.late = self.late, 0
        return late

    def acknowledge(self, sequence: int) -> float | None:
        """Gives one credit back; how long [s] the frame was on its way, None for one of an earlier opening."""
        self.last_heard_s = time.monotonic()
        for index, (sent, ready_s) in enumerate(self.under_way):
            if sent == sequence:
                del self.under_way[index]
                return self.last_heard_s - ready_s
        if self.generation == 0:
            raise InputError(
                "ack message",
                expected="the sequence of a frame that was sent",
                got=str(sequence),
                cure="Acknowledge each frame once.",
            )
        return None

    def deliver(
        self, generation: int, result: bytes | DrapeError, memories: Memories, since_s: float | None = None
    ) -> None:
        """Hands a frame, or the reason that there is none, to the sender, and keeps what the frame leaves behind.

        ``since_s``: when [s] (monotonic) its pose came.
        """
        if generation != self.generation:
            return
        self.memories = memories
        now = time.monotonic()
        if isinstance(result, bytes) and wire.message_kind(result) == wire.SAME:
            # It fills no buffer, so nobody says that it was taken.
            self.under_way = [one for one in self.under_way if math.isfinite(one[1])]
        self.under_way = [(sequence, min(ready_s, now)) for sequence, ready_s in self.under_way]
        if isinstance(result, DrapeError):
            self.failure = result
        else:
            self.outbox, self.outbox_since_s = result, now if since_s is None else since_s
            self.shown = shown_message(memories)
        self.news.set()


@router.websocket("/stream")
async def stream(socket: WebSocket) -> None:
    """One client, from its handshake to its close."""
    state: State = socket.app.state.drape
    settings = state.runtime.settings
    offered = socket.scope.get("subprotocols", [])
    try:
        _check_protocol(offered)
        if state.life.draining:
            raise Draining
        client = state.access.admit(socket.headers, offered, stream=True)
    except DrapeError as error:
        await socket.send_denial_response(problem_response(error))
        return
    await socket.accept(subprotocol=wire.SUBPROTOCOL)
    try:
        with state.access.using(client, "streams"):
            await _converse(socket, state, client)
    except WebSocketDisconnect:
        return
    except DrapeError as error:
        state.runtime.metrics.evictions.labels(type(error).__name__).inc()
        await _refuse(socket, error, settings.stream_send_s)
    except Exception:
        log.exception("a stream failed")
        await _refuse(socket, InternalError(), settings.stream_send_s)


def _check_protocol(offered: list[str]) -> None:
    if wire.SUBPROTOCOL not in offered:
        raise InputError(
            "Sec-WebSocket-Protocol",
            expected=wire.SUBPROTOCOL,
            got=", ".join(one for one in offered if not one.startswith(OFFER)) or "none",
            cure="Use a client of the same release.",
        )


async def _converse(socket: WebSocket, state: State, client: Client) -> None:
    """Opens the session and runs it until the client leaves or something is refused."""
    settings = state.runtime.settings
    state.streams.check_place()
    with state.handover.incoming() as pieces:
        asked = await read_opening(await first_text(socket, pieces, settings), state, client)
        session = Session(
            asked.plan,
            asked.betas,
            settings.stream_credit,
            asked.steps,
            moves=asked.moves,
            same=asked.same,
            wearer=asked.wearer,
            link=state.runtime.tracing.here(),
        )
        brought = state.handover.resume(pieces, session, client)
    if state.life.draining:
        raise Draining
    state.streams.add(session, None if brought is None else brought.tier)
    tasks = [
        asyncio.create_task(part)
        for part in (
            _read(socket, session, state, client),
            _send(socket, session, state, client),
            _watch(session, state),
        )
    ]
    resumed = {"resumed": brought is not None} if pieces.messages else {}
    try:
        await socket.send_text(opened(session.plan, state, session.wearer, **resumed))
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        state.streams.discard(session)
        for task in tasks:
            task.cancel()
        # Their own errors no longer matter; the first one is being told.
        await asyncio.gather(*tasks, return_exceptions=True)


async def _read(socket: WebSocket, session: Session, state: State, client: Client) -> None:
    while True:
        message = await socket.receive()
        payload = message.get("bytes")
        if message["type"] == "websocket.receive" and payload is not None:
            _take(payload, session, state.runtime.metrics)
        else:
            session.reopen(await read_opening(text_of(message), state, client))
            await socket.send_text(opened(session.plan, state, session.wearer))
        state.streams.wake()


def _take(payload: bytes, session: Session, metrics: Metrics) -> None:
    """Puts a pose into the mailbox or takes an acknowledgement."""
    if wire.message_kind(payload) == wire.ACK:
        way_s = session.acknowledge(wire.unpack_ack(payload))
        if way_s is not None and math.isfinite(way_s):
            metrics.ack.observe(way_s)
        return
    if wire.message_kind(payload) == wire.RIG_POSE:
        if session.wearer is None:
            cure = 'Open with "avatar": ID, or send poses of ours.'
            raise InputError("rig pose message", expected="a stream on an avatar", got="none", cure=cure)
        pose = unpack_rig_pose(payload, len(session.wearer.nodes))
        check_places(np.zeros((1, 3)) if pose.place is None else pose.place[None])
    else:
        pose = wire.unpack_pose(payload)
        check_poses(pose.pose[None], pose.trans[None])
    metrics.poses.inc()
    metrics.poses_dropped.inc(session.waiting is not None)
    session.put(pose)


async def _send(socket: WebSocket, session: Session, state: State, client: Client) -> None:
    limit = state.runtime.settings.stream_send_s
    while not (session.leaving and session.settled and session.failure is None):
        await session.news.wait()
        session.news.clear()
        if session.failure is not None:
            raise session.failure
        frame, since_s = session.outbox, session.outbox_since_s
        session.outbox = None
        if frame is None:
            continue
        try:
            async with asyncio.timeout(limit):  # which, unlike wait_for, makes no task
                await socket.send_bytes(frame)
        except TimeoutError:
            raise TooSlow(
                "stream",
                expected=f"a frame taken within {limit:g} s",
                got="a full connection",
                cure="Read faster or ask for fewer frames.",
            ) from None
        state.runtime.metrics.sent(time.monotonic() - since_s, state.runtime.settings.frame_deadline_s)
        state.streams.wake()
    await state.handover.send_away(socket, session, client, state.streams.tier)


async def _watch(session: Session, state: State) -> None:
    """Raises when the client neither acknowledges nor sends."""
    settings = state.runtime.settings
    while True:
        await asyncio.sleep(min(WATCH_S, settings.stream_ack_s / 4, settings.stream_idle_s / 4))
        now = time.monotonic()
        if session.under_way and now - session.under_way[0][1] > settings.stream_ack_s:
            raise TooSlow(
                "stream",
                expected=f"an acknowledgement within {settings.stream_ack_s:g} s",
                got="none",
                cure="Acknowledge every frame that came.",
            )
        if now - session.last_heard_s > settings.stream_idle_s:
            raise TooSlow(
                "stream",
                expected=f"a pose within {settings.stream_idle_s:g} s",
                got="none",
                cure="Open the stream again when there is motion.",
            )


async def _refuse(socket: WebSocket, error: DrapeError, limit_s: float) -> None:
    """Says why in full, closes with the code of the error, and cuts the line if the client does not read."""
    log.info("stream refused: %s", error)
    try:
        async with asyncio.timeout(limit_s):
            await socket.send_text(error_message(error))
            await socket.close(rule_for(error).close_code, close_reason(error))
    except (TimeoutError, RuntimeError, WebSocketDisconnect):
        abort = socket.scope.get("extensions", {}).get(ABORT)
        if abort is not None:
            with contextlib.suppress(Exception):
                abort["call"]()
