"""The workers that compute frames of streams, and how streams step down while poses come faster than frames.

A session (``service.stream.session``) is served as soon as a worker is free, the frame before is computed and the
client has credit, because frames that wait in a kernel buffer only grow old. There is no timer.

A pose is late if a newer one replaced it while it waited only for a worker. Where more than ``LATE_SHARE`` of the poses
are late, all streams step down: by one step, or by as many as save that share of the time. They step up again after a
while without late poses, if the next step leaves enough time, and after twice as long if the last try failed. No stream
ever gets more than its client asked for (``drape.stages.tiers.capped``). ``Runtime.steps`` says what the steps are.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

import numpy as np

from drape.errors import DrapeError, NotFound
from drape.stages.batch import PoseInput
from drape.wire.rig_pose_message import RigPose
from service.errors import Busy

if TYPE_CHECKING:
    from drape.stages.plan import Plan
    from drape.stages.scene import Entry
    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.threads import SlicedThread
    from service.stream.session import StreamSession, Waiting

WINDOW_S = 0.5  # the time over which poses are counted
LATE_SHARE = 0.05  # the share of late poses above which streams step down
SPARED = 0.125  # the share of a frame's time that one step is taken to save; a tier saves more (tradeoff.json)
CALM_S, CALM_LIMIT_S = 2.0, 64.0  # the time without late poses before a step up, at first and at most
ROOM = 0.8  # the share of the time that workers may be busy after a step up
GUESS = 1.5  # how much longer a frame is expected to take one step up, before that is measured


class Streams:
    """All streams of a service, and the workers that compute their frames: one for each thread for streams."""

    def __init__(self, runtime: DrapeRuntime, sliced_thread: SlicedThread) -> None:
        self._runtime, self._sliced_thread = runtime, sliced_thread
        self._sessions: set[StreamSession] = set()
        self._wake = asyncio.Event()
        self._workers: list[asyncio.Task[None]] = []
        self._count = runtime.threads.stream_threads
        self._step_down = StepDown(runtime.step_count, time.monotonic())

    @property
    def tier(self) -> int:
        """The index in ``Runtime.steps`` of the step that streams are held to; one past the last while each gets the
        plan that it asked for."""
        steps = self._step_down
        return steps.level if self._runtime.settings.stream_step_down else steps.top

    @property
    def count(self) -> int:
        return len(self._sessions)

    @property
    def waiting(self) -> int:
        """The number of sessions with a pose that waits for a worker."""
        return sum(session.waiting is not None for session in list(self._sessions))

    @property
    def runs(self) -> bool:
        """Whether all workers run."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def start(self) -> None:
        self._workers = [asyncio.create_task(self._work(), name=f"streams-{i}") for i in range(self._count)]

    async def stop(self) -> None:
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)

    def check_place(self) -> None:
        """Refuses (``Busy``) another stream where there are ``stream_sessions``."""
        limit = self._runtime.settings.stream_sessions
        if len(self._sessions) >= limit:
            raise Busy(
                "streams",
                expected=f"fewer than {limit} at a time",
                got=str(len(self._sessions)),
                cure="Try again later.",
            )

    def end_wearing(self, entry: Entry) -> None:
        """Ends every stream whose scene has the deleted garment ``entry``, with ``NotFound`` (close code 4404)."""
        got = f"{entry.id}, which was deleted"
        reason = NotFound("garment", expected="one in service", got=got, cure="Open another.")
        for session in self._sessions:
            if entry.id in [layer.id for layer in session.plan.scene.layers]:
                session.failure = reason
                session.news.set()

    def move(self, reason: DrapeError) -> None:
        """Makes every stream that ``moves`` go on at another process, once its computed frame is sent. Ends the others
        with ``reason``."""
        for session in self._sessions:
            if session.moves:
                session.leaving = True
            else:
                session.failure = reason
            session.news.set()

    def release(self, count: int) -> None:
        """Makes ``count`` of the streams that ``moves`` go on at another process, or all if there are fewer."""
        for session in [session for session in self._sessions if session.moves and not session.leaving][:count]:
            session.leaving = True
            session.news.set()

    def add(self, session: StreamSession, tier: int | None = None) -> None:
        """Adds ``session``. If it is the only one and has moved here, streams are held to ``tier``, as in the process
        that it comes from. Refuses as ``check_place`` does."""
        self.check_place()
        if tier is not None and not self._sessions:
            self._step_down.hold(tier, time.monotonic())
        self._sessions.add(session)

    def discard(self, session: StreamSession) -> None:
        self._sessions.discard(session)

    def wake(self) -> None:
        """Wakes a worker, since a session may have become ready."""
        self._wake.set()

    async def _work(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while batch := self._next_batch():
                await self._compute(batch)

    def _next_batch(self) -> list[StreamSession]:
        """Returns the session that has waited longest, with others that wait under an equal plan, so that each worker
        gets as many; empty if none is ready. More would be later: a batch ends with its last frame, and a frame takes
        hardly less than alone (0.86 to 0.97 of the time)."""
        ready = sorted(
            (s for s in self._sessions if s.ready()), key=lambda s: s.waiting.arrived_s if s.waiting else 0.0
        )
        same = [s for s in ready if s.plan_at(self.tier) == ready[0].plan_at(self.tier)]
        share = -(-len(same) // self._count)
        return same[: min(share, self._runtime.settings.chunk_frames)]

    async def _compute(self, batch: Sequence[StreamSession]) -> None:
        plan = batch[0].plan_at(self.tier)
        generations = [session.generation for session in batch]
        inputs = [_pose_input(session, session.take()) for session in batch]
        if any(session.ready() for session in self._sessions):
            self._wake.set()  # another worker may have missed the last wake
        with self._sliced_thread.hold_back(), self._span(plan, batch):
            start_s = time.monotonic()
            results = await self._runtime.stream_frames(plan, inputs)
            now_s = time.monotonic()
        late = sum(session.take_late() for session in batch)
        # With fewer sessions than workers some workers stay idle, so time is counted for those that can be busy.
        workers = max(1, min(self._count, len(self._sessions)))
        self._step_down.note(now_s, frames=len(batch), late=late, busy_s=(now_s - start_s) / workers)
        self._runtime.metrics.batch_frames.observe(len(batch))
        for session, generation, pose, (result, memories) in zip(batch, generations, inputs, results, strict=True):
            session.deliver(generation, result, memories, pose.arrived_s)

    def _span(self, plan: Plan, batch: Sequence[StreamSession]) -> AbstractContextManager[None]:
        """Returns the span of the frames of ``batch``; a context that does nothing without tracing."""
        tracing = self._runtime.tracing
        if not tracing.on:
            return nullcontext()
        links = [session.link for session in batch]
        return tracing.work("frames", links, frames=len(batch), tier=self._runtime.tier_of(plan))


def _pose_input(session: StreamSession, waiting: Waiting) -> PoseInput:
    pose = waiting.pose
    if isinstance(pose, RigPose):
        assert session.wearer is not None  # another opening throws the waiting pose away
        poses, trans = session.wearer.from_rig(pose.quaternions[None], None if pose.place is None else pose.place[None])
    else:
        poses, trans = pose.pose[None], pose.trans[None]
    return PoseInput(
        poses,
        trans,
        session.betas,
        np.array([pose.client_time_s]),
        session.memories,
        sequence=pose.sequence,
        dropped=session.dropped,
        arrived_s=waiting.arrived_s,
        shown=session.shown if session.same else None,
    )


class StepDown:
    """Decides which step streams are held to. ``level`` is its index in ``Runtime.steps``; it is ``top``, one past the
    last, while streams are not held. Times are seconds of one monotonic clock."""

    def __init__(self, top: int, now_s: float) -> None:
        self.top = self.level = top
        self._frame_s: dict[int, float] = {}  # the mean time of a frame, by level
        self._calm_s = CALM_S
        self._raised_s = -math.inf
        self._quiet_since_s = now_s
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._start_s, self._frames, self._late, self._busy_s = now_s, 0, 0, 0.0

    def hold(self, level: int, now_s: float) -> None:
        """Goes down to ``level`` at ``now_s`` [s], unless it is that low already."""
        if level < self.level:
            self.level = level
            self._quiet_since_s = now_s
            self._begin(now_s)

    def note(self, now_s: float, *, frames: int, late: int, busy_s: float) -> None:
        """Counts ``frames`` that took ``busy_s`` [s] of a worker, and ``late`` poses since the last call. Once in
        ``WINDOW_S`` changes the level if the counts ask for it."""
        self._frames += frames
        self._late += late
        self._busy_s += busy_s
        if now_s - self._start_s < WINDOW_S:
            return
        seconds = now_s - self._start_s
        self._frame_s[self.level] = self._busy_s / self._frames
        share = self._late / (self._frames + self._late)
        if share > LATE_SHARE:
            self._quiet_since_s = now_s
            self._down(now_s, max(1, int(share / SPARED)))
        elif self.level < self.top and now_s - self._quiet_since_s >= self._calm_s and self._has_room(seconds):
            self.level += 1
            self._raised_s = self._quiet_since_s = now_s
        self._begin(now_s)

    def _down(self, now_s: float, steps: int) -> None:
        if not self.level:
            return
        self.level = max(0, self.level - steps)
        failed = now_s - self._raised_s < CALM_S
        self._calm_s = min(2.0 * self._calm_s, CALM_LIMIT_S) if failed else CALM_S

    def _has_room(self, seconds: float) -> bool:
        now = self._frame_s[self.level]
        above = self._frame_s.get(self.level + 1, GUESS * now)
        return self._frames * max(above, now) <= ROOM * seconds
