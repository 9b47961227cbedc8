"""One client's stream: its mailbox for one pose, its credit, and what an opening turns it to."""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drape.errors import DrapeError, InputError
from drape.stages.batch import Memories
from drape.stages.encode import shown_message
from drape.stages.plan import Plan
from drape.stages.stage import carried
from drape.wire import messages as wire
from drape.wire.rig_pose_message import RigPose

if TYPE_CHECKING:
    from opentelemetry.trace import Link

    from drape.avatar.wearer import Wearer

CREDIT = 2  # frames under way
ACK_S = 3.0  # for an acknowledgement
SEND_S = 1.0  # for taking a frame, a state or a refusal; then the connection is cut


@dataclass(frozen=True, eq=False)
class Opening:
    """The stream that a client asks for.

    ``steps``: ``plan`` as each tier holds it, the one that computes least first. ``moves``: the stream can go on at
    another process. ``same``: the client takes the word that its frame still holds in place of the frame. ``wearer``:
    the avatar that the stream shows, whose own rig may then send poses; None for our body.
    """

    plan: Plan
    betas: np.ndarray
    steps: tuple[Plan, ...] = ()
    moves: bool = False
    same: bool = False
    wearer: Wearer | None = None


@dataclass(frozen=True, eq=False)
class Waiting:
    """A pose, ours or one of the avatar's rig, and the time [s] (monotonic) it came."""

    pose: wire.Pose | RigPose
    arrived_s: float


@dataclass(eq=False)
class StreamSession:
    """One client's stream.

    ``steps``: ``plan`` as each tier holds it, the one that computes least first. ``memories``: what the stages keep of
    the frames so far. ``generation``: the number of openings; a result that was begun for an earlier one is thrown
    away. ``dropped``: poses that newer ones replaced; of these ``late`` waited for nothing but a worker. ``moves``: it
    can go on at another process; while it is ``leaving`` nothing is begun for it here. ``same``: the client takes the
    word that its frame still holds; ``shown`` is the message of that frame. ``wearer``: the avatar that it shows.
    ``link`` leads to its request's span.
    """

    plan: Plan
    betas: np.ndarray
    credit: int
    steps: tuple[Plan, ...] = ()
    memories: Memories = field(default_factory=dict)
    generation: int = 0
    moves: bool = False
    same: bool = False
    wearer: Wearer | None = None
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
    opening: bool = False  # another opening is being made ready, and nothing is read meanwhile
    # Sequence of every frame that was begun and is not acknowledged, and when [s] it was ready; infinity before that.
    under_way: list[tuple[int, float]] = field(default_factory=list)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def reopen(self, asked: Opening) -> None:
        """Turns the session to another plan or shape; what another shape leaves behind is no motion of this one."""
        same_body = np.array_equal(asked.betas, self.betas)
        self.memories = carried(self.memories, self.plan, asked.plan) if same_body else {}
        self.plan, self.betas, self.steps = asked.plan, asked.betas, asked.steps
        self.moves, self.same, self.wearer = asked.moves, asked.same, asked.wearer
        self.generation += 1
        self.last_heard_s = time.monotonic()
        self.waiting, self.outbox, self.shown = None, None, None
        self.under_way.clear()

    def put(self, pose: wire.Pose | RigPose) -> None:
        """Puts a pose into the mailbox; one that waited there is dropped and counted."""
        self.last_heard_s = time.monotonic()
        self.late += self.due()
        self.dropped += self.waiting is not None
        self.waiting = Waiting(pose, self.last_heard_s)

    def ready(self) -> bool:
        """Whether a pose waits that may be computed now."""
        return self.due() and not self.computing

    def due(self) -> bool:
        """Whether a pose waits and lacks nothing but a worker, even if one still computes the frame before."""
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
        """Returns its plan as the step with the index ``tier`` holds it."""
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
        if isinstance(result, bytes) and wire.message_kind(result) == wire.SAME:
            # It fills no buffer, so nobody says that it was taken.
            self.under_way = [one for one in self.under_way if math.isfinite(one[1])]
        self.under_way = [(sequence, min(ready_s, now)) for sequence, ready_s in self.under_way]
        if isinstance(result, DrapeError):
            self.failure = result
        else:
            self.outbox, self.outbox_since_s = result, now if since_s is None else since_s
            self.shown = shown_message(memories)
        self.news.set()
