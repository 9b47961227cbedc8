"""Stream sessions and the batcher that serves them: the newest pose wins, credit bounds what is under way.

A session has a mailbox for one pose; a newer pose replaces it and is counted. It is
computed as soon as the worker is free and the client has credit: frames that wait in
a kernel buffer only grow old. There is no timer.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drape.errors import DrapeError, InputError
from drape.wire.jets import JetFrame, pack_jets
from drape.wire.messages import Frame, Pose, pack_frame
from service.drapery import Draped, DrapedJets, Drapery, Geometry, PoseInput
from service.dynamics import Memory
from service.errors import Busy, InternalError
from service.garments import Scene

log = logging.getLogger("drape.service")


@dataclass(frozen=True, eq=False)
class Waiting:
    """A pose and the time [s] (monotonic) it came."""

    pose: Pose
    arrived_s: float


@dataclass(eq=False)
class Session:
    """One client's stream. ``generation`` counts openings: what was begun for an earlier one is thrown away.

    ``motion`` is the knob, ``memory`` what the body's motion so far leaves behind; both are those of the client and
    go on over a change of garment.
    """

    entry: Scene
    betas: np.ndarray
    push: bool
    credit: int
    motion: float = 0.0
    memory: Memory | None = None
    passes: int | None = None
    geometry: Geometry = "vertices"
    generation: int = 0
    dropped: int = 0
    waiting: Waiting | None = None
    outbox: bytes | None = None
    failure: DrapeError | None = None
    last_heard_s: float = field(default_factory=time.monotonic)
    # Sequence of every frame that was begun and is not acknowledged, and when [s] it was ready; infinity before that.
    under_way: list[tuple[int, float]] = field(default_factory=list)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def reopen(
        self,
        entry: Scene,
        betas: np.ndarray,
        push: bool,
        motion: float = 0.0,
        passes: int | None = None,
        geometry: Geometry = "vertices",
    ) -> None:
        """Turns the session to another garment or outfit, shape, push-out, motion knob, passes or geometry."""
        if motion == 0.0 or not np.array_equal(betas, self.betas):
            self.memory = None  # the joints of another shape are elsewhere: that is no motion
        self.entry, self.betas, self.push, self.motion, self.passes = entry, betas, push, motion, passes
        self.geometry = geometry
        self.generation += 1
        self.waiting, self.outbox = None, None
        self.under_way.clear()

    def put(self, pose: Pose) -> None:
        """Puts a pose into the mailbox; one that waited there is dropped and counted."""
        self.last_heard_s = time.monotonic()
        self.dropped += self.waiting is not None
        self.waiting = Waiting(pose, self.last_heard_s)

    def ready(self) -> bool:
        """Whether a pose waits that may be computed now."""
        return self.waiting is not None and len(self.under_way) < self.credit and self.outbox is None

    def take(self) -> Waiting:
        """The waiting pose, now under way."""
        assert self.waiting is not None
        taken, self.waiting = self.waiting, None
        self.under_way.append((taken.pose.sequence, math.inf))
        return taken

    def acknowledge(self, sequence: int) -> None:
        """Gives one credit back; an answer to a frame of an earlier opening is ignored."""
        self.last_heard_s = time.monotonic()
        for index, (sent, _) in enumerate(self.under_way):
            if sent == sequence:
                del self.under_way[index]
                return
        if self.generation == 0:
            raise InputError(
                "ack message",
                expected="the sequence of a frame that was sent",
                got=str(sequence),
                cure="Acknowledge each frame once.",
            )

    def deliver(self, generation: int, result: bytes | DrapeError, memory: Memory | None = None) -> None:
        """Hands a frame, or the reason that there is none, to the sender, and keeps what the frame leaves behind."""
        if generation != self.generation:
            return
        self.memory = memory
        now = time.monotonic()
        self.under_way = [(sequence, min(ready_s, now)) for sequence, ready_s in self.under_way]
        if isinstance(result, DrapeError):
            self.failure = result
        else:
            self.outbox = result
        self.news.set()


class Streams:
    """All sessions, and the task that computes their frames."""

    def __init__(self, drapery: Drapery) -> None:
        self._drapery = drapery
        self._sessions: set[Session] = set()
        self._wake = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None

    @property
    def count(self) -> int:
        return len(self._sessions)

    def start(self) -> None:
        self._worker = asyncio.create_task(self._work(), name="streams")

    async def stop(self) -> None:
        if self._worker is not None:
            self._worker.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._worker

    def check_place(self) -> None:
        """Refuses when every place is taken."""
        limit = self._drapery.settings.stream_sessions
        if len(self._sessions) >= limit:
            raise Busy(
                "streams",
                expected=f"fewer than {limit} at a time",
                got=str(len(self._sessions)),
                cure="Try again later.",
            )

    def add(self, session: Session) -> None:
        self.check_place()
        self._sessions.add(session)

    def discard(self, session: Session) -> None:
        self._sessions.discard(session)

    def wake(self) -> None:
        """Says that a session may have become ready."""
        self._wake.set()

    async def _work(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while batch := self._next_batch():
                await self._compute(batch)

    def _next_batch(self) -> list[Session]:
        """The session that has waited longest, with all others that wait for the same garment, passes and geometry."""
        ready = sorted(
            (s for s in self._sessions if s.ready()), key=lambda s: s.waiting.arrived_s if s.waiting else 0.0
        )
        same = [s for s in ready if _kind(s) == _kind(ready[0])]
        return same[: self._drapery.settings.chunk_frames]

    async def _compute(self, batch: Sequence[Session]) -> None:
        entry, geometry = batch[0].entry, batch[0].geometry
        generations = [session.generation for session in batch]
        taken = [session.take() for session in batch]
        dropped = [session.dropped for session in batch]
        inputs = [_pose_input(session, waiting) for session, waiting in zip(batch, taken, strict=True)]
        results = await self._drapery.in_thread(self._frames, entry, geometry, inputs, taken, dropped)
        for session, generation, (result, memory) in zip(batch, generations, results, strict=True):
            session.deliver(generation, result, memory)

    def _frames(
        self,
        entry: Scene,
        geometry: Geometry,
        inputs: Sequence[PoseInput],
        taken: Sequence[Waiting],
        dropped: Sequence[int],
    ) -> list[tuple[bytes | DrapeError, Memory | None]]:
        """Packed frames, and what they leave behind.

        Where the batch fails each pose is tried alone, from the memory before it, so that one cannot fail its mates.
        """
        compute = self._drapery.compute if geometry == "vertices" else self._drapery.compute_jets
        try:
            draped = compute(entry, inputs)
        except Exception as error:
            if len(inputs) > 1:
                return [
                    self._frames(entry, geometry, inputs[i : i + 1], taken[i : i + 1], dropped[i : i + 1])[0]
                    for i in range(len(inputs))
                ]
            if not isinstance(error, DrapeError):
                log.exception("a stream frame failed")
            return [(error if isinstance(error, DrapeError) else InternalError(), inputs[0].memory)]
        now = time.monotonic()
        frames = [
            packed_frame(
                draped,
                i,
                sequence=waiting.pose.sequence,
                client_time_s=waiting.pose.client_time_s,
                pushed=inputs[i].push,
                dropped=dropped[i],
                residence_us=int(1e6 * (now - waiting.arrived_s)),
            )
            for i, waiting in enumerate(taken)
        ]
        return list(zip(frames, draped.memories, strict=True))


def packed_frame(
    draped: Draped | DrapedJets,
    row: int,
    *,
    sequence: int,
    client_time_s: float,
    pushed: bool,
    dropped: int = 0,
    residence_us: int = 0,
) -> bytes:
    """The frame ``row`` of ``draped`` as a FRAME or JETS message."""
    said: dict[str, Any] = {
        "sequence": sequence,
        "client_time_s": client_time_s,
        "server_time_s": time.time(),
        "root": draped.root[row],
        "dropped": dropped,
        "residence_us": residence_us,
        "pushed": pushed,
        "pushed_share": float(draped.pushed_share[row]),
        "push_max_m": float(draped.push_max_m[row]),
    }
    if isinstance(draped, Draped):
        return pack_frame(Frame(positions=draped.vertices[row], **said))
    posed = {"jet": draped.jet[row], "rotation": draped.rotation[row], "centre": draped.centre[row]}
    return pack_jets(JetFrame(**posed, **said, left_m=float(draped.left_m[row])))


def _kind(session: Session) -> tuple[Scene, int | None, Geometry]:
    """What sessions must share to be computed together."""
    return session.entry, session.passes, session.geometry


def _pose_input(session: Session, waiting: Waiting) -> PoseInput:
    pose = waiting.pose
    times_s = np.array([pose.client_time_s])
    return PoseInput(
        pose.pose[None],
        pose.trans[None],
        session.betas,
        session.push,
        session.motion,
        times_s,
        session.memory,
        session.passes,
    )
