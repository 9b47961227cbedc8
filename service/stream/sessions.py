"""Stream sessions and the workers that serve them: the newest pose wins, credit bounds what is under way.

A session has a mailbox for one pose; a newer pose replaces it and is counted. It is
computed as soon as a worker is free, the frame before is through and the client has credit: frames that wait in
a kernel buffer only grow old. There is no timer.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drape.errors import DrapeError, InputError, NotFound
from drape.wire.messages import SAME, Pose, message_kind
from service.errors import Busy
from service.stages.batch import Memories, Plan, PoseInput, carried
from service.stages.unchanged import shown_message
from service.stream.step_down import StepDown

if TYPE_CHECKING:
    from opentelemetry.trace import Link

    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.sliced_thread import SlicedThread
    from service.stages.scene import Entry


@dataclass(frozen=True, eq=False)
class Waiting:
    """A pose and the time [s] (monotonic) it came."""

    pose: Pose
    arrived_s: float


@dataclass(eq=False)
class Session:
    """One client's stream. ``generation`` counts openings: what was begun for an earlier one is thrown away.

    ``steps``: the plan as each tier holds it, the least first; ``memories``: what the stages keep of the frames so far
    (``service.stages``). Of ``dropped`` poses those that are ``late`` waited for a worker alone. One that ``moves``
    can go on at another process; while it is ``leaving`` nothing is begun for it here. A client that takes ``same``
    need not get a frame again that it has: ``shown``, the message that was computed for it. ``link`` leads to its
    request.
    """

    plan: Plan
    betas: np.ndarray
    credit: int
    steps: tuple[Plan, ...] = ()
    memories: Memories = field(default_factory=dict)
    generation: int = 0
    moves: bool = False
    same: bool = False
    shown: bytes | None = None
    link: Link | None = None
    leaving: bool = False
    dropped: int = 0
    late: int = 0
    waiting: Waiting | None = None
    outbox: bytes | None = None
    outbox_since_s: float = 0.0  # when the pose of the frame in the outbox came
    failure: DrapeError | None = None
    last_heard_s: float = field(default_factory=time.monotonic)
    # Sequence of every frame that was begun and is not acknowledged, and when [s] it was ready; infinity before that.
    under_way: list[tuple[int, float]] = field(default_factory=list)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def reopen(self, plan: Plan, betas: np.ndarray, steps: tuple[Plan, ...] = ()) -> None:
        """Turns the session to another plan or shape; what another shape leaves behind is no motion of this one."""
        same = np.array_equal(betas, self.betas)
        self.memories = carried(self.memories, self.plan, plan) if same else {}
        self.plan, self.betas, self.steps = plan, betas, steps
        self.generation += 1
        self.waiting, self.outbox, self.shown = None, None, None
        self.under_way.clear()

    def put(self, pose: Pose) -> None:
        """Puts a pose into the mailbox; one that waited there is dropped and counted."""
        self.last_heard_s = time.monotonic()
        self.late += self.due()
        self.dropped += self.waiting is not None
        self.waiting = Waiting(pose, self.last_heard_s)

    def ready(self) -> bool:
        """Whether a pose waits that may be computed now."""
        return self.due() and not self.computing

    def due(self) -> bool:
        """Whether a pose waits for nothing but a worker, if only for the one that computes the frame before."""
        free = len(self.under_way) < self.credit and self.outbox is None and not self.leaving
        return self.waiting is not None and free

    @property
    def computing(self) -> bool:
        """Whether a frame of this opening is being computed."""
        return not all(math.isfinite(ready_s) for _, ready_s in self.under_way)

    @property
    def settled(self) -> bool:
        """Whether nothing is computed for it and no frame waits to be sent."""
        return self.outbox is None and not self.computing

    def held_to(self, tier: int) -> Plan:
        """Its plan with no more than the step of that index computes."""
        return self.steps[tier] if tier < len(self.steps) else self.plan

    def take(self) -> Waiting:
        """The waiting pose, now under way."""
        assert self.waiting is not None
        taken, self.waiting = self.waiting, None
        self.under_way.append((taken.pose.sequence, math.inf))
        return taken

    def taken_late(self) -> int:
        """The number of poses that were late since the last call."""
        late, self.late = self.late, 0
        return late

    def acknowledge(self, sequence: int) -> float | None:
        """Gives one credit back; how long [s] the frame was on its way, None for one of an earlier opening."""
        self.last_heard_s = time.monotonic()
        for index, (sent, ready_s) in enumerate(self.under_way):
            if sent == sequence:
                del self.under_way[index]
                return self.last_heard_s - ready_s
        if self.generation == 0:
            raise InputError(
                "ack message",
                expected="the sequence of a frame that was sent",
                got=str(sequence),
                cure="Acknowledge each frame once.",
            )
        return None

    def deliver(
        self, generation: int, result: bytes | DrapeError, memories: Memories, since_s: float | None = None
    ) -> None:
        """Hands a frame, or the reason that there is none, to the sender, and keeps what the frame leaves behind.

        ``since_s``: when [s] (monotonic) its pose came.
        """
        if generation != self.generation:
            return
        self.memories = memories
        now = time.monotonic()
        if isinstance(result, bytes) and message_kind(result) == SAME:
            # It fills no buffer, so nobody says that it was taken.
            self.under_way = [one for one in self.under_way if math.isfinite(one[1])]
        self.under_way = [(sequence, min(ready_s, now)) for sequence, ready_s in self.under_way]
        if isinstance(result, DrapeError):
            self.failure = result
        else:
            self.outbox, self.outbox_since_s = result, now if since_s is None else since_s
            self.shown = shown_message(memories)
        self.news.set()


class Streams:
    """All sessions, and the workers that compute their frames: as many as ``DrapeRuntime`` has threads for streams."""

    def __init__(self, runtime: DrapeRuntime, sliced_thread: SlicedThread) -> None:
        self._runtime, self._sliced_thread = runtime, sliced_thread
        self._sessions: set[Session] = set()
        self._wake = asyncio.Event()
        self._workers: list[asyncio.Task[None]] = []
        self._count, self._busy = runtime.threads.stream_threads, 0  # workers, and how many of them compute
        self._step_down = StepDown(runtime.step_count, time.monotonic())

    @property
    def tier(self) -> int:
        """The index in ``DrapeRuntime.steps`` of the most that streams get; past the last one nothing holds them."""
        steps = self._step_down
        return steps.level if self._runtime.settings.stream_step_down else steps.top

    @property
    def count(self) -> int:
        return len(self._sessions)

    @property
    def waiting(self) -> int:
        """Poses that wait."""
        return sum(session.waiting is not None for session in list(self._sessions))

    @property
    def runs(self) -> bool:
        """Whether frames are being computed when poses come."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def start(self) -> None:
        self._workers = [asyncio.create_task(self._work(), name=f"streams-{i}") for i in range(self._count)]

    async def stop(self) -> None:
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)

    def check_place(self) -> None:
        """Refuses when every place is taken."""
        limit = self._runtime.settings.stream_sessions
        if len(self._sessions) >= limit:
            raise Busy(
                "streams",
                expected=f"fewer than {limit} at a time",
                got=str(len(self._sessions)),
                cure="Try again later.",
            )

    def end_wearing(self, entry: Entry) -> None:
        """Ends (4404) every stream that wears ``entry``, which was deleted."""
        got = f"{entry.id}, which was deleted"
        reason = NotFound("garment", expected="one in service", got=got, cure="Open another.")
        for session in self._sessions:
            if entry.id in [layer.id for layer in session.plan.scene.layers]:
                session.failure = reason
                session.news.set()

    def move(self, reason: DrapeError) -> None:
        """Lets every stream that ``moves`` send what is computed and go; ends the others with ``reason``."""
        for session in self._sessions:
            if session.moves:
                session.leaving = True
            else:
                session.failure = reason
            session.news.set()

    def release(self, count: int) -> None:
        """Lets ``count`` of the streams that ``moves``, or as many as there are, go on at another process."""
        for session in [one for one in self._sessions if one.moves and not one.leaving][:count]:
            session.leaving = True
            session.news.set()

    def add(self, session: Session, tier: int | None = None) -> None:
        """Takes ``session`` in; the first is held to the ``tier`` that it was held to where it comes from."""
        self.check_place()
        if tier is not None and not self._sessions:
            self._step_down.hold(tier, time.monotonic())
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
        """The session that has waited longest, with its share of the others that wait under the same plan: what other
        workers have nothing else to do for is left to them."""
        ready = sorted(
            (s for s in self._sessions if s.ready()), key=lambda s: s.waiting.arrived_s if s.waiting else 0.0
        )
        same = [s for s in ready if s.held_to(self.tier) == ready[0].held_to(self.tier)]
        share = -(-len(same) // (self._count - self._busy))
        return same[: min(share, self._runtime.settings.chunk_frames)]

    async def _compute(self, batch: Sequence[Session]) -> None:
        plan = batch[0].held_to(self.tier)
        generations = [session.generation for session in batch]
        inputs = [_pose_input(session, session.take()) for session in batch]
        if any(session.ready() for session in self._sessions):
            self._wake.set()  # for another worker, which may not have waited when it was told
        self._busy += 1
        links = [session.link for session in batch]
        tier = self._runtime.tier_of(plan)
        try:
            with self._sliced_thread.held(), self._runtime.tracing.work("frames", links, frames=len(batch), tier=tier):
                start_s = time.monotonic()
                results = await self._runtime.stream_frames(plan, inputs)
                now_s = time.monotonic()
        finally:
            self._busy -= 1
        late = sum(session.taken_late() for session in batch)
        # Workers that sessions can keep busy share the time that there is.
        workers = max(1, min(self._count, len(self._sessions)))
        self._step_down.note(now_s, frames=len(batch), late=late, busy_s=(now_s - start_s) / workers)
        self._runtime.metrics.batch_frames.observe(len(batch))
        for session, generation, one, (result, memories) in zip(batch, generations, inputs, results, strict=True):
            session.deliver(generation, result, memories, one.arrived_s)


def _pose_input(session: Session, waiting: Waiting) -> PoseInput:
    pose = waiting.pose
    return PoseInput(
        pose.pose[None],
        pose.trans[None],
        session.betas,
        np.array([pose.client_time_s]),
        session.memories,
        sequence=pose.sequence,
        dropped=session.dropped,
        arrived_s=waiting.arrived_s,
        shown=session.shown if session.same else None,
    )
