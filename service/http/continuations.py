"""The end of a clip, kept for the request that goes on from there: a clip in pieces is the whole clip."""

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
LIFE_S = 120.0  # a client asks for the next piece at once


@dataclass(frozen=True, eq=False)
class Continuation:
    """The end of a clip: the stages' ``memories`` after so many ``frames`` of a clip of ``plan`` at ``fps``, on a body
    of the shape ``betas`` (S,)."""

    plan: Plan
    betas: np.ndarray
    fps: float
    frames: int
    memories: Memories

    def followed_by(self, plan: Plan, clip: PoseInput, fps: float) -> PoseInput:
        """Returns ``clip`` as the input that goes on from here. Refuses (``InputError``) another plan, shape or number
        of frames a second."""
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
class _Kept:
    past: Continuation
    owner: str | None
    until_s: float


class Continuations:
    """The last ``MOST`` continuations by their tokens, of all clients together, each for ``LIFE_S``.

    One may be followed more than once, so that a request whose answer was lost can be sent again.
    """

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}

    def __len__(self) -> int:
        return len(self._kept)

    @staticmethod
    def token() -> str:
        """Returns a new random name, under which a clip's end will be kept."""
        return secrets.token_urlsafe(18)

    def put(self, token: str, past: Continuation, owner: str | None) -> None:
        """Keeps ``past`` for the key ``owner``; where there are too many, the key that has most loses its oldest."""
        self._drop_old()
        self._kept[token] = _Kept(past, owner, time.monotonic() + LIFE_S)
        while len(self._kept) > MOST:
            ((most, _),) = Counter(kept.owner for kept in self._kept.values()).most_common(1)
            del self._kept[next(name for name, kept in self._kept.items() if kept.owner == most)]

    def get(self, token: str, owner: str | None) -> Continuation:
        """The continuation of ``token``; refuses (``NotFound``) one that is gone, or another key's."""
        self._drop_old()
        kept = self._kept.get(token)
        if kept is None or kept.owner != owner:
            raise NotFound(
                "past",
                expected=f"one of the last {LIFE_S:g} s",
                got="one that is not kept",
                cure="Leave past out, and the clip begins anew.",
            )
        return kept.past

    def _drop_old(self) -> None:
        now_s = time.monotonic()
        for token in [token for token, kept in self._kept.items() if kept.until_s < now_s]:
            del self._kept[token]
