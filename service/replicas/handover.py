"""The state that a stream takes along to another process: ``Handover``.

Signed under the secret of the tickets, for one key, one release, one model and one body, and good for ``LIFE_S``. It
holds what the stages remember, how many poses were dropped and to which tier streams were held; times in it are the
client's own. Whoever has none, or one that does not fit, begins anew.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drape import __version__
from drape.errors import DrapeError, InputError, TooLarge
from drape.network.card_memory import to_processor
from drape.wire.state_pieces import PIECE_BYTES, join_state, split_state
from service.errors import Busy, Draining, TooSlow, Unauthorized, close_reason, rule_for
from service.guard.limits import HELD_BYTES
from service.replicas.memory_codec import decode_value, encode_value
from service.stream.session import SEND_S, StreamSession

if TYPE_CHECKING:
    from fastapi import WebSocket

    from drape.stages.batch import Memories
    from drape.stages.plan import Plan
    from service.compute.drape_runtime import DrapeRuntime
    from service.guard.key_file import Client
    from service.guard.tickets import Tickets

LIFE_S = 60.0
_SIGNATURE_BYTES = 32
_LENGTH = struct.Struct("<I")
STATE_BYTES = 8 * 2**20  # of the state that a stream takes along; one with a larger one begins anew
log = logging.getLogger("drape.service")
_CURE = "Open the stream without it: it begins anew."


@dataclass(frozen=True, eq=False)
class Brought:
    """The state that a stream has brought from another process: the stages' ``memories``, the number of poses
    ``dropped`` so far, and the ``tier`` that streams were held to there."""

    memories: Memories
    dropped: int
    tier: int


class Handover:
    """Makes and reads the states of streams, and counts the bytes of incoming states that are held."""

    def __init__(self, runtime: DrapeRuntime, tickets: Tickets) -> None:
        self._runtime, self._tickets = runtime, tickets
        self._classes = runtime.memory_classes
        self._held = 0

    def state(self, session: StreamSession, client: Client, tier: int, *, now_s: float | None = None) -> bytes:
        """Returns the signed state of ``session``, while streams are held to ``tier``. Empty if no other process could
        read it, or if it is longer than ``STATE_BYTES``."""
        if not self._tickets.shared:
            return b""
        head = self._bound(client, session.plan, session.betas)
        head |= {"expires_s": (time.time() if now_s is None else now_s) + LIFE_S}
        head |= {"dropped": session.dropped, "tier": tier}
        text = json.dumps(head).encode()
        kept = tuple((*key, to_processor(memory)) for key, memory in session.memories.items())
        raw = _LENGTH.pack(len(text)) + text + encode_value(kept, self._classes, _plans(session.plan, session.steps))
        whole = self._tickets.sign(raw) + raw
        return whole if len(whole) <= STATE_BYTES else b""

    def brought(
        self,
        blob: bytes,
        client: Client,
        plan: Plan,
        steps: Sequence[Plan],
        betas: np.ndarray,
        *,
        now_s: float | None = None,
    ) -> Brought:
        """The state in ``blob`` for a stream of ``plan`` and ``betas``; refuses (``Unauthorized``) one that is forged,
        expired or of another key, and (``InputError``) one of another release, model, scene or shape."""
        raw = blob[_SIGNATURE_BYTES:]
        if not hmac.compare_digest(blob[:_SIGNATURE_BYTES], self._tickets.sign(raw)):
            raise _foreign("one that this service did not sign")
        start = _LENGTH.size + _LENGTH.unpack_from(raw)[0]
        head: dict[str, Any] = json.loads(raw[_LENGTH.size : start])
        if (time.time() if now_s is None else now_s) > head["expires_s"]:
            raise _foreign("one that has expired")
        if head["key"] != client.name:
            raise _foreign("one of another key")
        for name, ours in self._bound(client, plan, betas).items():
            if head[name] != ours:
                raise InputError("state", expected=f"the same {name}", got="another", cure=_CURE)
        kept = decode_value(raw[start:], self._classes, _plans(plan, steps))
        return Brought({(stage, owner): memory for stage, owner, memory in kept}, head["dropped"], head["tier"])

    async def send_away(self, socket: WebSocket, session: StreamSession, client: Client, tier: int) -> None:
        """Sends the state of ``session`` and the address to go to, and closes the connection. The client has
        ``SEND_S`` to take it."""
        reason = Draining()
        blob = self.state(session, client, tier)
        pieces = split_state(blob)
        moved: dict[str, str | int] = {"type": "moved", "to": self._runtime.settings.successor, "pieces": len(pieces)}
        if client.name is not None:
            moved["ticket"] = self._tickets.make(client.name)  # the one that opened this stream is spent
        try:
            async with asyncio.timeout(SEND_S):
                for piece in pieces:
                    await socket.send_bytes(piece)
                await socket.send_text(json.dumps(moved))
                await socket.close(rule_for(reason).close_code, close_reason(reason))
        except TimeoutError:
            expected = f"a state taken within {SEND_S:g} s"
            cure = "Read faster; the next stream begins anew."
            raise TooSlow("stream", expected=expected, got="a full connection", cure=cure) from None
        self._runtime.metrics.moved.labels(str(bool(pieces)).lower()).inc()

    def resume(self, pieces: Incoming, session: StreamSession, client: Client) -> Brought | None:
        """Lets ``session`` go on from the state in ``pieces`` and returns that; None if there is none, or if it does
        not fit."""
        if not pieces.messages:
            return None
        try:
            blob = join_state(pieces.messages)
            brought = self.brought(blob, client, session.plan, session.steps, session.betas)
        except DrapeError as error:
            log.info("stream begins anew: %s", error)
            self._runtime.metrics.brought.labels("false").inc()
            return None
        session.memories, session.dropped = brought.memories, brought.dropped
        self._runtime.metrics.brought.labels("true").inc()
        return brought

    def _bound(self, client: Client, plan: Plan, betas: np.ndarray) -> dict[str, Any]:
        """The facts that must be the same on both sides, as JSON has them."""
        return {
            "release": __version__,
            "key": client.name,
            "model": self._runtime.engine.manifest.digest,
            "body": self._runtime.body.digest,
            "garments": [*plan.keys, *plan.draped_keys],
            "options": plan.options.model_dump(mode="json"),
            "shape": betas.tolist(),
        }

    @contextmanager
    def incoming(self) -> Iterator[Incoming]:
        """Yields room for the pieces of one state, which are counted until the block ends."""
        pieces = Incoming(self)
        try:
            yield pieces
        finally:
            self._held -= pieces.size

    def hold(self, size: int, more: int) -> None:
        """Counts ``more`` bytes of a state of which ``size`` bytes have come. Refuses (``TooLarge``, ``Busy``) what is
        too much for one state or for all together."""
        if size + more > STATE_BYTES + PIECE_BYTES:
            expected = f"at most {STATE_BYTES} bytes"
            raise TooLarge("state", expected=expected, got=f"{size + more} or more", cure=_CURE)
        if self._held + more > HELD_BYTES:
            expected = f"at most {HELD_BYTES} bytes of all streams together"
            raise Busy("states", expected=expected, got=f"{self._held} and {more} more", cure="Try again in a second.")
        self._held += more


class Incoming:
    """The pieces of one state so far, ``size`` bytes."""

    def __init__(self, handover: Handover) -> None:
        self._handover = handover
        self.messages: list[bytes] = []
        self.size = 0

    def take(self, message: bytes) -> None:
        """Adds one piece, a STATE message."""
        self._handover.hold(self.size, len(message))
        self.size += len(message)
        self.messages.append(message)


def _plans(plan: Plan, steps: Sequence[Plan]) -> tuple[Plan, ...]:
    return (plan, *steps)


def _foreign(got: str) -> DrapeError:
    return Unauthorized("state", expected="a fresh one of this service and key", got=got, cure=_CURE)
