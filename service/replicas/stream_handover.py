"""Streams on their way: what one that goes is told and given, and what one that comes has brought."""

from __future__ import annotations

import asyncio
import json
import logging

from fastapi import WebSocket

from drape.errors import DrapeError
from drape.wire.state import PIECE_BYTES, join_state, split_state
from service.errors import Draining, TooSlow, close_reason, rule_for
from service.guard.keys import Client
from service.replicas.handover import Brought, Incoming
from service.state import State
from service.stream.sessions import Session

log = logging.getLogger("drape.service")


async def send_away(socket: WebSocket, session: Session, state: State, client: Client) -> None:
    """Sends the state of ``session`` and where to go with it, and closes; the client has ``DRAPE_STREAM_SEND_S`` to
    take it."""
    settings, reason = state.runtime.settings, Draining()
    blob = state.handover.state(session, client, state.streams.tier)
    pieces = split_state(blob, min(PIECE_BYTES, settings.stream_message_bytes))
    moved: dict[str, str | int] = {"type": "moved", "to": settings.successor, "pieces": len(pieces)}
    if client.name is not None:
        moved["ticket"] = state.access.tickets.make(client.name)  # the one that opened this stream is spent
    try:
        async with asyncio.timeout(settings.stream_send_s):
            for piece in pieces:
                await socket.send_bytes(piece)
            await socket.send_text(json.dumps(moved))
            await socket.close(rule_for(reason).close_code, close_reason(reason))
    except TimeoutError:
        expected = f"a state taken within {settings.stream_send_s:g} s"
        cure = "Read faster; the next stream begins anew."
        raise TooSlow("stream", expected=expected, got="a full connection", cure=cure) from None
    state.runtime.metrics.moved.labels(str(bool(pieces)).lower()).inc()


def brought_along(pieces: Incoming, session: Session, state: State, client: Client) -> Brought | None:
    """What ``session`` goes on from, already in it; None where nothing came or it does not fit: then it begins anew."""
    if not pieces.messages:
        return None
    try:
        blob = join_state(pieces.messages)
        brought = state.handover.brought(blob, client, session.plan, session.steps, session.betas)
    except DrapeError as error:
        log.info("stream begins anew: %s", error)
        state.runtime.metrics.brought.labels("false").inc()
        return None
    session.memories, session.dropped = brought.memories, brought.dropped
    state.runtime.metrics.brought.labels("true").inc()
    return brought
