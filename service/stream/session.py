"""The state of one client's stream: its opening, its mailbox for one pose, its credit and its memories."""

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

CREDIT = 2  # the most frames under way
ACK_S = 3.0  # the time for an acknowledgement
SEND_S = 1.0  # the time in which a client must take a frame, a state or a refusal, before the connection is cut


@dataclass(frozen=True, eq=False)
class Opening:
    """The stream that a client asks for: ``plan`` on a body of the shape ``betas`` (S,).

    ``steps``: the plans that replace ``plan`` when streams step down, the one that computes least first. ``moves``:
    whether the client can go on at another process. ``same``: whether it takes a SAME message in place of a frame that
    it shows already. ``wearer``: the avatar that wears the scene, and whose own rig may send poses; None for the
    standard body.
    """

    plan: Plan
    betas: np.ndarray
    steps: tuple[Plan, ...] = ()
    moves: bool = False
    same: bool = False
    wearer: Wearer | None = None


@dataclass(frozen=True, eq=False)
class Waiting:
    """A pose that waits to be draped, of the standard body or of an avatar's rig, and when it came [s, monotonic]."""

    pose: wire.Pose | RigPose
    arrived_s: float


@dataclass(eq=False)
class StreamSession:
    """The state of one client's stream.

    ``plan``, ``betas``, ``steps``, ``moves``, ``same`` and ``wearer`` are those of its last ``Opening``. ``credit``:
    the most frames under way. ``memories``: what the stages remember of the frames so far. ``generation``: how often it
    was opened again; results of earlier openings are thrown away. ``shown``: the message of the frame that the client
    shows. ``leaving``: whether it moves to another process, so that no frame is begun. ``dropped``: the number of poses
    that newer ones replaced. ``late``: the number of these that waited only for a worker, since the last ``take_late``.
    ``outbox``: the message to send next. ``failure``: the refusal that ends it. ``news`` is set when there is a message
    or a refusal. ``link`` leads to the span of its request.
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
    opening: bool = False  # whether another opening is being prepared, while nothing is read
    # Each frame that was begun and is not acknowledged: its sequence, and when it was ready [s], infinity before that.
    under_way: list[tuple[int, float]] = field(default_factory=list)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def reopen(self, opening: Opening) -> None:
        """Changes the stream to ``opening``. The memories that its plan can use stay, unless the body has another
        shape. The waiting pose and frames under way are thrown away."""
        same_body = np.array_equal(opening.betas, self.betas)
        self.memories = carried(self.memories, self.plan, opening.plan) if same_body else {}
        self.plan, self.betas, self.steps = opening.plan, opening.betas, opening.steps
        self.moves, self.same, self.wearer = opening.moves, opening.same, opening.wearer
        self.generation += 1
        self.last_heard_s = time.monotonic()
        self.waiting, self.outbox, self.shown = None, None, None
        self.under_way.clear()

    def put(self, pose: wire.Pose | RigPose) -> None:
        """Puts ``pose`` into the mailbox. A pose that waits there is dropped, and counted in ``dropped``."""
        self.last_heard_s = time.monotonic()
        self.late += self.due()
        self.dropped += self.waiting is not None
        self.waiting = Waiting(pose, self.last_heard_s)

    def ready(self) -> bool:
        """Returns whether a pose waits that a worker may compute now."""
        return self.due() and not self.computing

    def due(self) -> bool:
        """Returns whether a pose waits, with credit and an empty outbox. A worker may still compute the frame
        before."""
        free = len(self.under_way) < self.credit and self.outbox is None and not self.leaving
        return self.waiting is not None and free

    @property
    def computing(self) -> bool:
        """Whether a frame of this opening is being computed."""
        return not all(math.isfinite(ready_s) for _, ready_s in self.under_way)

    @property
    def settled(self) -> bool:
        """Whether no frame is being computed or waits to be sent."""
        return self.outbox is None and not self.computing

    def plan_at(self, tier: int) -> Plan:
        """Returns the plan of the stream while streams are held to the step with the index ``tier`` of ``steps``; its
        own plan for an index past the last."""
        return self.steps[tier] if tier < len(self.steps) else self.plan

    def take(self) -> Waiting:
        """Takes the waiting pose out of the mailbox, counts its frame as under way, and returns it."""
        assert self.waiting is not None
        waiting, self.waiting = self.waiting, None
        self.under_way.append((waiting.pose.sequence, math.inf))
        return waiting

    def take_late(self) -> int:
        """Returns the number of late poses since the last call, and counts from 0 again."""
        late, self.late = self.late, 0
        return late

    def acknowledge(self, sequence: int) -> float | None:
        """Counts the frame ``sequence`` as no longer under way. Returns the time [s] since it was ready, -inf if it is
        not ready yet; None for a frame of an earlier opening. Refuses (``InputError``) a sequence that was not sent."""
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
        """Puts the message ``result`` of a frame into the outbox, or its refusal into ``failure``, and keeps
        ``memories`` for the next frame. A result of an earlier ``generation`` is thrown away.

        ``since_s``: when the pose of the frame came [s, monotonic], now by default.
        """
        if generation != self.generation:
            return
        self.memories = memories
        now = time.monotonic()
        if isinstance(result, bytes) and wire.message_kind(result) == wire.SAME:
            # A SAME message fills no buffer, so clients do not acknowledge it.
            self.under_way = [frame for frame in self.under_way if math.isfinite(frame[1])]
        self.under_way = [(sequence, min(ready_s, now)) for sequence, ready_s in self.under_way]
        if isinstance(result, DrapeError):
            self.failure = result
        else:
            self.outbox, self.outbox_since_s = result, now if since_s is None else since_s
            self.shown = shown_message(memories)
        self.news.set()
