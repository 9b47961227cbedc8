"""The route WS /stream: a JSON message opens it, binary poses come in, binary frames go out (docs/reference/wire.md).

A session has a mailbox for one pose. A newer pose replaces it, which is counted. Credit bounds the frames under way.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from typing import TYPE_CHECKING

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from drape.errors import DrapeError, InputError
from drape.stages.batch import check_places, check_poses
from drape.wire import messages as wire
from drape.wire.rig_pose_message import unpack_rig_pose
from service.errors import Draining, InternalError, TooSlow, close_reason, error_message, problem_response, rule_for
from service.guard.access import OFFER
from service.state import State
from service.stream.opening import first_text, opening_answer, read_opening, text_of
from service.stream.session import ACK_S, CREDIT, SEND_S, StreamSession

if TYPE_CHECKING:
    from service.guard.key_file import Client
    from service.watch.prometheus import Metrics

router = APIRouter()
WATCH_S = 0.25
ABORT = "drape.abort"  # what service.server puts into the scope: closes the connection without flushing
log = logging.getLogger("drape.service")


@router.websocket("/stream")
async def stream(socket: WebSocket) -> None:
    """Serves one client of the stream, from its handshake until it leaves, is refused or moves to another process."""
    state: State = socket.app.state.drape
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
        await _refuse(socket, error)
    except Exception:
        log.exception("a stream failed")
        state.runtime.metrics.evictions.labels(InternalError.__name__).inc()
        await _refuse(socket, InternalError())


def _check_protocol(offered: list[str]) -> None:
    if wire.SUBPROTOCOL not in offered:
        raise InputError(
            "Sec-WebSocket-Protocol",
            expected=wire.SUBPROTOCOL,
            got=", ".join(protocol for protocol in offered if not protocol.startswith(OFFER)) or "none",
            cure="Use a client of the same release.",
        )


async def _converse(socket: WebSocket, state: State, client: Client) -> None:
    """Opens the session and runs it until the client leaves or something is refused."""
    state.streams.check_place()
    with state.handover.incoming() as pieces:
        opening = await read_opening(await first_text(socket, pieces), state, client)
        session = StreamSession(
            opening.plan,
            opening.betas,
            CREDIT,
            opening.steps,
            moves=opening.moves,
            same=opening.same,
            wearer=opening.wearer,
            link=state.runtime.tracing.here(),
        )
        moved = state.handover.resume(pieces, session, client)
    if state.life.draining:
        raise Draining
    state.streams.add(session, None if moved is None else moved.tier)
    tasks = [
        asyncio.create_task(part)
        for part in (
            _read(socket, session, state, client),
            _send(socket, session, state, client),
            _watch(session, state),
        )
    ]
    resumed = {"resumed": moved is not None} if pieces.messages else {}
    try:
        await socket.send_text(opening_answer(session.plan, state, session.wearer, **resumed))
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        state.streams.discard(session)
        for task in tasks:
            task.cancel()
        # The first error is being raised; those of the other tasks do not matter.
        await asyncio.gather(*tasks, return_exceptions=True)


async def _read(socket: WebSocket, session: StreamSession, state: State, client: Client) -> None:
    while True:
        message = await socket.receive()
        payload = message.get("bytes")
        if message["type"] == "websocket.receive" and payload is not None:
            _take(payload, session, state.runtime.metrics)
        else:
            text = text_of(message)
            session.opening = True
            session.reopen(await read_opening(text, state, client))
            session.opening = False
            await socket.send_text(opening_answer(session.plan, state, session.wearer))
        state.streams.wake()


def _take(payload: bytes, session: StreamSession, metrics: Metrics) -> None:
    """Puts the pose in the message ``payload`` into the mailbox, or counts its acknowledgement."""
    if wire.message_kind(payload) == wire.ACK:
        way_s = session.acknowledge(wire.unpack_ack(payload))
        if way_s is not None and math.isfinite(way_s):
            metrics.ack.observe(way_s)
        return
    if wire.message_kind(payload) == wire.RIG_POSE:
        if session.wearer is None:
            cure = 'Open the stream with "avatar": ID, or send POSE messages.'
            raise InputError("rig pose message", expected="a stream on an avatar", got="none", cure=cure)
        pose = unpack_rig_pose(payload, len(session.wearer.nodes))
        check_places(np.zeros((1, 3)) if pose.place is None else pose.place[None])
    else:
        pose = wire.unpack_pose(payload)
        check_poses(pose.pose[None], pose.trans[None])
    metrics.poses.inc()
    metrics.poses_dropped.inc(session.waiting is not None)
    session.put(pose)


async def _send(socket: WebSocket, session: StreamSession, state: State, client: Client) -> None:
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
            async with asyncio.timeout(SEND_S):  # wait_for would make a task for each frame
                await socket.send_bytes(frame)
        except TimeoutError:
            raise TooSlow(
                "stream",
                expected=f"a frame taken within {SEND_S:g} s",
                got="a full connection",
                cure="Read faster or ask for fewer frames.",
            ) from None
        state.runtime.metrics.count_sent(time.monotonic() - since_s, state.runtime.settings.frame_deadline_s)
        state.streams.wake()
    await state.handover.send_away(socket, session, client, state.streams.tier)


async def _watch(session: StreamSession, state: State) -> None:
    """Raises ``TooSlow`` when the client stops acknowledging or sending."""
    idle_s = state.runtime.settings.stream_idle_s
    while True:
        await asyncio.sleep(min(WATCH_S, ACK_S / 4, idle_s / 4))
        if session.opening:  # nothing is read meanwhile, so nothing can be heard
            continue
        now = time.monotonic()
        if session.under_way and now - session.under_way[0][1] > ACK_S:
            raise TooSlow(
                "stream",
                expected=f"an acknowledgement within {ACK_S:g} s",
                got="none",
                cure="Acknowledge every frame that came.",
            )
        if now - session.last_heard_s > idle_s:
            raise TooSlow(
                "stream",
                expected=f"a pose within {idle_s:g} s",
                got="none",
                cure="Open the stream again when there is motion.",
            )


async def _refuse(socket: WebSocket, error: DrapeError) -> None:
    """Sends the whole sentence of ``error``, closes the stream with its code, and aborts the connection if the client
    does not read."""
    log.info("stream refused: %s", error)
    try:
        async with asyncio.timeout(SEND_S):
            await socket.send_text(error_message(error))
            await socket.close(rule_for(error).close_code, close_reason(error))
    except (TimeoutError, RuntimeError, WebSocketDisconnect):
        abort = socket.scope.get("extensions", {}).get(ABORT)
        if abort is not None:
            with contextlib.suppress(Exception):
                abort["call"]()
