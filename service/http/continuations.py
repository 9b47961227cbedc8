"""Keeps the end of a clip for the request that continues it, so that a clip in pieces equals the whole clip."""

from __future__ import annotations

import secrets
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from drape.errors import InputError, NotFound
from drape.stages.batch import Memories, PoseInput
from drape.stages.plan import Plan

MOST = 32
LIFE_S = 120.0  # long enough, as clients ask for the next piece at once


@dataclass(frozen=True, eq=False)
class Continuation:
    """The end of a clip: the stages' ``memories`` after its first ``frames`` frames. The clip is of ``plan``, at
    ``fps`` frames per second, on a body of the shape ``betas`` (S,)."""

    plan: Plan
    betas: np.ndarray
    fps: float
    frames: int
    memories: Memories

    def continue_by(self, plan: Plan, clip: PoseInput, fps: float) -> PoseInput:
        """Returns ``clip`` with the memories, times and frame numbers that continue this clip. Refuses (``InputError``)
        a clip of another plan, shape or number of frames per second."""
        if plan != self.plan or fps != self.fps or not np.array_equal(clip.betas, self.betas):
            raise InputError(
                "past",
                expected="a clip of the same garments, options, shape and frames per second",
                got="another",
                cure="Leave past out, and the clip begins anew.",
            )
        times_s = np.arange(self.frames, self.frames + len(clip.poses)) / fps
        return PoseInput(clip.poses, clip.trans, clip.betas, times_s, self.memories, sequence=self.frames)


@dataclass(frozen=True, eq=False)
class _Entry:
    past: Continuation
    owner: str | None
    until_s: float


class Continuations:
    """The ends of clips (``Continuation``) that other requests may continue, by their tokens: the latest ``MOST`` of
    all clients together, each kept for ``LIFE_S``.

    A client sends a long clip in pieces. The answer to one piece names a token (X-Drape-Past), and the request with the
    next piece sends it (``past``). It may do so more than once, in case an answer was lost.
    """

    def __init__(self) -> None:
        self._entries: dict[str, _Entry] = {}

    def __len__(self) -> int:
        return len(self._entries)

    @staticmethod
    def token() -> str:
        """Returns a new random token, for ``put``."""
        return secrets.token_urlsafe(18)

    def put(self, token: str, past: Continuation, owner: str | None) -> None:
        """Keeps ``past`` under ``token`` for the key ``owner``. Where more than ``MOST`` are kept, the key that has the
        most of them loses its oldest."""
        self._drop_old()
        self._entries[token] = _Entry(past, owner, time.monotonic() + LIFE_S)
        while len(self._entries) > MOST:
            ((most, _),) = Counter(entry.owner for entry in self._entries.values()).most_common(1)
            del self._entries[next(name for name, entry in self._entries.items() if entry.owner == most)]

    def get(self, token: str, owner: str | None) -> Continuation:
        """Returns the continuation under ``token``. Refuses (``NotFound``) one that is no longer kept, or another
        key's."""
        self._drop_old()
        entry = self._entries.get(token)
        if entry is None or entry.owner != owner:
            raise NotFound(
                "past",
                expected=f"one of the last {LIFE_S:g} s",
                got="one that is not kept",
                cure="Leave past out, and the clip begins anew.",
            )
        return entry.past

    def _drop_old(self) -> None:
        now_s = time.monotonic()
        for token in [token for token, entry in self._entries.items() if entry.until_s < now_s]:
            del self._entries[token]
