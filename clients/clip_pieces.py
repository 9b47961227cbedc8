"""Clips longer than a request may be, in pieces: the service remembers the cloth from one to the next, so that together
they are the undivided clip, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import httpx
import numpy as np

from clients.calls import DRAPE, Call

Answer = TypeVar("Answer")
OPTION_BYTES = 16384  # room in a request for all but its frames
UNASKED = 60
"""A clip of no more frames is sent without asking the service how many it takes."""


def most_frames(health: dict[str, Any], frame_bytes: int) -> int:
    """Returns how many frames of ``frame_bytes`` each a request may have; ``health`` is what the service's /health
    answers."""
    in_body = (int(health["max_body_bytes"]) - OPTION_BYTES) // frame_bytes
    return max(1, min(int(health["max_frames"]), in_body))


def piece(call: Call[Answer], rows: slice, past: str | None) -> Call[tuple[Answer, str | None]]:
    """Returns a call like ``call`` for the frames ``rows`` of its clip. Its answer is a pair: the answer for these
    frames, and the name under which the service remembers the cloth after the last of them, None where it does not.

    ``past`` is the name that came with the piece before, None for the first piece.
    """
    assert call.clip is not None
    more: dict[str, Any] = {}
    if call.path == DRAPE:  # a posed body remembers nothing
        more = {"keep": rows.stop < len(call.clip.poses)} | ({} if past is None else {"past": past})

    def read(response: httpx.Response) -> tuple[Answer, str | None]:
        return call.read(response), response.headers.get("X-Drape-Past")

    part = call.clip.part(rows)
    return Call(call.method, call.path, read, call.params, call.headers, json=call.json | more, clip=part)


def joined_answers(answers: Sequence[Any]) -> Any:
    """Returns the answer of the whole clip from those of its pieces, which are arrays of frames, tuples or lists of
    such arrays, or lists of frames."""
    first = answers[0]
    if isinstance(first, np.ndarray):
        return np.concatenate(answers)
    if isinstance(first, tuple):
        return tuple(np.concatenate(parts) for parts in zip(*answers, strict=True))
    if first and isinstance(first[0], np.ndarray):
        return [np.concatenate(parts) for parts in zip(*answers, strict=True)]
    return [frame for answer in answers for frame in answer]
