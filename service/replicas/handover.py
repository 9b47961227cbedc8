"""The state that a stream takes to another process: ``Handover``.

It is signed with the secret of the tickets, for one key, release, model and body, and valid for ``LIFE_S``. It holds
the stages' memories, the number of dropped poses and the step that streams were held to. Its times are the client's. A
stream without a state, or with one that does not fit, begins anew.
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
from drape.network.card_memory import fetched
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

LIFE_S = 60.0  # how long a state is valid
_SIGNATURE_BYTES = 32
_LENGTH = struct.Struct("<I")
STATE_BYTES = 8 * 2**20  # the largest state; a stream with a larger one begins anew
log = logging.getLogger("drape.service")
_CURE = "Open the stream without it: it begins anew."


@dataclass(frozen=True, eq=False)
class MovedState:
    """The state of a stream that comes from another process: the stages' ``memories``, the number of ``dropped`` poses,
    and ``tier``, the index in ``Runtime.steps`` of the step that streams were held to there."""

    memories: Memories
    dropped: int
    tier: int


class Handover:
    """Writes and reads the states of streams, and limits the memory that incoming states take. ``tickets`` sign
    them."""

    def __init__(self, runtime: DrapeRuntime, tickets: Tickets) -> None:
        self._runtime, self._tickets = runtime, tickets
        self._classes = runtime.memory_classes
        self._held = 0

    def state(self, session: StreamSession, client: Client, tier: int, *, now_s: float | None = None) -> bytes:
        """Returns the bytes of the signed state of ``session``; ``tier`` is the index of the step that streams are held
        to. Empty if there is no shared secret, so that no other process could read it, or if it is longer than
        ``STATE_BYTES``. ``now_s`` [s since 1970] is the current time by default."""
        if not self._tickets.shared:
            return b""
        head = self._bound(client, session.plan, session.betas)
        head |= {"expires_s": (time.time() if now_s is None else now_s) + LIFE_S}
        head |= {"dropped": session.dropped, "tier": tier}
        text = json.dumps(head).encode()
        memories = tuple((*key, fetched(memory)) for key, memory in session.memories.items())
        plans = (session.plan, *session.steps)
        raw = _LENGTH.pack(len(text)) + text + encode_value(memories, self._classes, plans)
        whole = self._tickets.sign(raw) + raw
        return whole if len(whole) <= STATE_BYTES else b""

    def read_state(
        self,
        blob: bytes,
        client: Client,
        plan: Plan,
        steps: Sequence[Plan],
        betas: np.ndarray,
        *,
        now_s: float | None = None,
    ) -> MovedState:
        """Returns the state in ``blob`` for a stream of ``plan``, with these ``steps``, on a body of the shape
        ``betas``. Refuses (``Unauthorized``) one that is forged, expired or of another key than the client's, and
        (``InputError``) one of another release, model, body, scene, shape or options."""
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
        rows = decode_value(raw[start:], self._classes, (plan, *steps))
        return MovedState({(stage, owner): memory for stage, owner, memory in rows}, head["dropped"], head["tier"])

    async def send_away(self, socket: WebSocket, session: StreamSession, client: Client, tier: int) -> None:
        """Sends the state of ``session`` and the address of the process to go on at, and closes the connection. Raises
        ``TooSlow`` where the client does not take them within ``SEND_S``."""
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

    def resume(self, pieces: Incoming, session: StreamSession, client: Client) -> MovedState | None:
        """Puts the state in ``pieces`` into ``session`` and returns it. None if there is no state or it does not fit;
        ``session`` then begins anew."""
        if not pieces.messages:
            return None
        try:
            blob = join_state(pieces.messages)
            moved = self.read_state(blob, client, session.plan, session.steps, session.betas)
        except DrapeError as error:
            log.info("stream begins anew: %s", error)
            self._runtime.metrics.brought.labels("false").inc()
            return None
        session.memories, session.dropped = moved.memories, moved.dropped
        self._runtime.metrics.brought.labels("true").inc()
        return moved

    def _bound(self, client: Client, plan: Plan, betas: np.ndarray) -> dict[str, Any]:
        """Returns the facts that must be equal in both processes, as JSON values."""
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
        """Yields an empty ``Incoming`` for the pieces of one state. Their bytes count as in memory until the block
        ends."""
        pieces = Incoming(self)
        try:
            yield pieces
        finally:
            self._held -= pieces.size

    def hold(self, size: int, more: int) -> None:
        """Counts ``more`` bytes of a state of which ``size`` bytes are there. Refuses (``TooLarge``) a state that is
        too large, and (``Busy``) more than ``HELD_BYTES`` of all states together."""
        if size + more > STATE_BYTES + PIECE_BYTES:
            expected = f"at most {STATE_BYTES} bytes"
            raise TooLarge("state", expected=expected, got=f"{size + more} or more", cure=_CURE)
        if self._held + more > HELD_BYTES:
            expected = f"at most {HELD_BYTES} bytes of all streams together"
            raise Busy("states", expected=expected, got=f"{self._held} and {more} more", cure="Try again in a second.")
        self._held += more


class Incoming:
    """The STATE messages of one incoming state so far, and their ``size`` in bytes."""

    def __init__(self, handover: Handover) -> None:
        self._handover = handover
        self.messages: list[bytes] = []
        self.size = 0

    def take(self, message: bytes) -> None:
        """Adds ``message``, a STATE message. Refuses as ``Handover.hold`` does."""
        self._handover.hold(self.size, len(message))
        self.size += len(message)
        self.messages.append(message)


def _foreign(got: str) -> DrapeError:
    return Unauthorized("state", expected="a fresh one of this service and key", got=got, cure=_CURE)
