"""The state of a stream that moves to another process, in pieces: ``split_state`` and ``join_state``.

A piece is the 16 bytes of every message, of the kind STATE with the piece's number as its sequence and the number of
pieces as its count, and then bytes that only the service reads. A client hands them on as they came.
"""

from __future__ import annotations

from collections.abc import Sequence

from drape.errors import InputError
from drape.wire.messages import MAGIC, PREFIX, STATE, WIRE_VERSION, message_kind, record

PIECE_BYTES = 32 * 1024
_PREFIX = record(PREFIX)


def split_state(blob: bytes, most: int = PIECE_BYTES) -> list[bytes]:
    """Returns STATE messages of at most ``most`` bytes that hold the bytes ``blob`` in order; none if it is empty."""
    size = most - _PREFIX.size
    parts = [blob[start : start + size] for start in range(0, len(blob), size)]
    return [_PREFIX.pack(MAGIC, WIRE_VERSION, STATE, 0, index, len(parts)) + part for index, part in enumerate(parts)]


def join_state(messages: Sequence[bytes]) -> bytes:
    """Returns the bytes that ``split_state`` has split into ``messages``.

    Refuses (``InputError``) anything but all pieces in their order.
    """
    for index, message in enumerate(messages):
        kind = message_kind(message)
        prefix = _PREFIX.unpack_from(message)
        if prefix != (MAGIC, WIRE_VERSION, STATE, 0, index, len(messages)):
            raise InputError(
                "state message",
                expected=f"piece {index + 1} of {len(messages)}",
                got=f"kind {kind}, piece {prefix[4] + 1} of {prefix[5]}",
                cure="Send the pieces as they came, each once.",
            )
    return b"".join(message[_PREFIX.size :] for message in messages)
