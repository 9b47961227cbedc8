"""WS /stream: one JSON message opens, binary poses come in, binary frames go out, as in docs/reference/wire.md."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import time
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from drape.errors import DrapeError, InputError
from drape.wire import messages as wire
from service.errors import Draining, InternalError, TooSlow, close_reason, error_message, problem_response, rule_for
from service.guard.access import OFFER
from service.http.json_body import document_of, validated
from service.http.poses import check_poses, shape_array
from service.http.schemas import OpenRequest
from service.stages.scene import Outfit, layer_list
from service.state import State
from service.stream.sessions import Session

if TYPE_CHECKING:
    from service.guard.keys import Client
    from service.replicas.handover import Incoming
    from service.settings import Settings
    from service.watch.metrics import Metrics

router = APIRouter()
WATCH_S = 0.25
ABORT = "drape.abort"  # what service.server puts into the scope: closes the connection without flushing
log = logging.getLogger("drape.service")


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
        text = await _opening(socket, pieces, settings)
        session = await _open_session(text, state, client, None)
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
        await socket.send_text(_opened(session, state, **resumed))
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        state.streams.discard(session)
        for task in tasks:
            task.cancel()
        # Their own errors no longer matter; the first one is being told.
        await asyncio.gather(*tasks, return_exceptions=True)


async def _opening(socket: WebSocket, pieces: Incoming, settings: Settings) -> str:
    """The text that opens a stream; what comes before it of the stream's state goes to ``pieces``."""
    begun_s = time.monotonic()
    while True:
        until_s = begun_s + settings.stream_open_s + pieces.size / settings.body_bytes_s
        try:
            message = await asyncio.wait_for(socket.receive(), max(0.0, until_s - time.monotonic()))
        except TimeoutError:
            raise TooSlow(
                "open message",
                expected=f"within {settings.stream_open_s:g} s",
                got="nothing" if not pieces.messages else f"{pieces.size} bytes of a state",
                cure='Send {"type": "open", "garment": ...} first.',
            ) from None
        payload = message.get("bytes")
        if payload is None or payload[5:6] != bytes([wire.STATE]):
            return _text_of(message)
        pieces.take(payload)


def _text_of(message: Any) -> str:
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    text = message.get("text")
    if text is None:
        raise InputError(
            "open message", expected="JSON text", got="bytes", cure='Send {"type": "open", "garment": ...} first.'
        )
    return text


async def _open_session(text: str, state: State, client: Client, session: Session | None) -> Session:
    """The session that ``text`` asks for: a new one, or ``session`` turned to it."""
    asked = validated(OpenRequest, document_of(text.encode()))
    runtime = state.runtime
    scene = await state.scene(asked.garment, asked.garments, client)
    plan = await runtime.plan_within(scene, asked, messages=True)
    betas = shape_array(asked.betas, runtime.body)
    steps = runtime.steps(plan)
    for step in {plan, *steps}:
        await runtime.prepare(step)
    if session is None:
        link = runtime.tracing.here()
        return Session(
            plan, betas, runtime.settings.stream_credit, steps, moves=asked.moves, same=asked.same, link=link
        )
    session.reopen(plan, betas, steps)
    session.moves, session.same = asked.moves, asked.same
    return session


def _opened(session: Session, state: State, **more: bool) -> str:
    scene, options = session.plan.shown, session.plan.options
    jets = options.geometry == "jets"
    worn = {"garments": layer_list(scene, patches=jets)} if isinstance(scene, Outfit) else {"garment": scene.id}
    if jets:  # an answer about vertices is what it was before there were jets
        worn |= {"geometry": "jets", "patches": scene.patch_count}
    if options.resolution == "fine":
        worn |= {"resolution": "fine"}
    return json.dumps(
        {
            "type": "opened",
            **worn,
            "vertices": scene.vertex_count,
            "model": state.runtime.engine.manifest.digest,
            "body": state.runtime.body.name,
            "credit": session.credit,
            "push_out": options.push_out,
            "motion": options.knob,
            "tier": state.runtime.tier_of(session.plan),
            "passes": state.runtime.engine.pass_count if options.passes is None else options.passes,
            "folds": options.folds,
            "safe_folds": options.safe_folds or 0,
            "bits": options.bits or 16,
            **more,
        }
    )


async def _read(socket: WebSocket, session: Session, state: State, client: Client) -> None:
    while True:
        message = await socket.receive()
        payload = message.get("bytes")
        if message["type"] == "websocket.receive" and payload is not None:
            _take(payload, session, state.runtime.metrics)
        else:
            await _open_session(_text_of(message), state, client, session)
            session.last_heard_s = time.monotonic()
            await socket.send_text(_opened(session, state))
        state.streams.wake()


def _take(payload: bytes, session: Session, metrics: Metrics) -> None:
    """Puts a pose into the mailbox or takes an acknowledgement."""
    if wire.message_kind(payload) == wire.ACK:
        way_s = session.acknowledge(wire.unpack_ack(payload))
        if way_s is not None and math.isfinite(way_s):
            metrics.ack.observe(way_s)
        return
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
