"""The message that answers a pose: a frame relative to its root, or for an idle body the last one again.

Nothing is computed for a body whose cloth has come to rest. Its last message, which stands in the stream's memories
under ``KEY``, is sent again, or a SAME message in its place. The memories of the stages grow no
older meanwhile (``Stage.rested``), so that the first frame that moves again goes on from where the cloth hangs.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from drape.stages.batch import Batch, Memories, PoseInput, changed
from drape.stages.plan import Plan
from drape.stages.stage import BODY, Stage
from drape.wire.jets import JetFrame, pack_jets
from drape.wire.messages import Answer, Frame, pack_frame, pack_same, resent
from drape.wire.options import DrapeOptions
from drape.wire.quantised import quantise

KEY = ("idle", BODY)
REST_S = 2.0  # cloth has come to rest after so long in one pose, by the client's clock,
REST_FRAMES = 30  # and after so many computed frames: a slow stream has fewer in that time


class Encode(Stage):
    """The stage that packs every frame as a FRAME or JETS message, with its pose's sequence number and time."""

    name = "encode"

    def wanted(self, plan: Plan) -> bool:
        return plan.messages

    def run(self, batch: Batch) -> Batch:
        now = time.monotonic()
        messages = []
        as_jets = batch.plan.options.geometry == "jets"
        jets = batch.jets if as_jets else None
        vertices = None if as_jets else batch.vertices
        for client, rows in batch.rows():
            residence_s = 0.0 if client.arrived_s is None else now - client.arrived_s
            for i, row in enumerate(range(rows.start, rows.stop)):
                header = {
                    "sequence": client.sequence + i,
                    "client_time_s": float(client.times_s[i]),
                    "server_time_s": time.time(),
                    "root": batch.root[row],
                    "dropped": client.dropped,
                    "residence_us": int(1e6 * residence_s),
                    "pushed": bool(batch.plan.options.advanced.push_out),
                    "stepped": batch.plan.stepped,
                    "novelty": float(batch.quality.novelty[row]),
                    "pushed_share": float(batch.quality.pushed_share[row]),
                    "push_max_m": float(batch.quality.push_max_m[row]),
                }
                if jets is not None:
                    posed = {name: array[row] for name, array in vars(jets).items()}
                    messages.append(pack_jets(JetFrame(**header, **posed, left_m=float(batch.quality.left_m[row]))))
                elif vertices is not None:
                    frame = Frame(**header, positions=vertices[row], bits=coordinate_bits(batch.plan.options))
                    steps_of = quantise if not batch.steps else lambda *_, row=row: batch.steps[row]
                    messages.append(pack_frame(frame, steps_of))
        return changed(batch, messages=tuple(messages))


def coordinate_bits(options: DrapeOptions) -> int:
    """Returns the bits of a coordinate in a FRAME message under the ``options`` of a plan: 8 for a garment that is far
    away, which alone has ``pixels_per_m`` there, and 16 otherwise."""
    return 16 if options.pixels_per_m is None else 8


@dataclass(frozen=True, eq=False)
class Idle:
    """A body that has kept one pose: ``pose`` (24, 3) [rad], ``trans`` (3,) [m] and ``betas`` (S,) under ``plan``.

    ``since_s`` and ``last_s`` are the times [s] of the first and of the last frame in this pose by the client's clock,
    ``frames`` is the number of computed frames in it, and ``message`` the last of their messages.
    """

    pose: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    plan: Plan
    since_s: float
    last_s: float
    frames: int
    message: bytes

    def holds_for(self, plan: Plan, client: PoseInput) -> bool:
        """Returns whether the first frame of ``client`` has this pose and shape under an equal ``plan``, and is not
        earlier than the last one."""
        return (
            np.array_equal(client.poses[0], self.pose)  # what nearly always differs comes first
            and np.array_equal(client.trans[0], self.trans)
            and np.array_equal(client.betas, self.betas)
            and plan == self.plan
            and float(client.times_s[0]) >= self.last_s
        )


def idle_before(plan: Plan, client: PoseInput) -> Idle | None:
    """Returns the ``Idle`` that the stream of ``client`` remembers, whose single frame is next; None if there is none
    or the body has moved."""
    idle: Idle | None = client.memories.get(KEY)
    return idle if idle is not None and idle.holds_for(plan, client) else None


def answer_again(plan: Plan, client: PoseInput, idle: Idle | None) -> tuple[bytes, Memories] | None:
    """Returns the message that answers the single frame of ``client`` without computing it, and the stream's memories
    after it; None if the body of ``idle`` (``idle_before``) has not come to rest.

    A client that still shows the last frame gets a SAME message. A pause does not count as rest: only computed frames
    bring cloth to rest.
    """
    if idle is None or idle.frames < REST_FRAMES or idle.last_s - idle.since_s < REST_S:
        return None
    now_s = float(client.times_s[0])
    residence_us = 0 if client.arrived_s is None else int(1e6 * (time.monotonic() - client.arrived_s))
    answer = Answer(client.sequence, now_s, time.time(), client.dropped, residence_us)
    message = pack_same(answer) if client.shown is idle.message else resent(idle.message, answer)
    stages = {stage.name: stage for stage in plan.stages}
    rested = {
        key: stages[key[0]].rested(memory, now_s) if key[0] in stages else memory
        for key, memory in client.memories.items()
    }
    return message, rested


def shown_message(memories: Memories) -> bytes | None:
    """Returns the last computed message of the stream that has these ``memories``, which its client shows once it has
    taken all frames; None if there is none."""
    idle: Idle | None = memories.get(KEY)
    return None if idle is None else idle.message


def remember(plan: Plan, client: PoseInput, before: Idle | None, memories: Memories, message: bytes) -> Memories:
    """Returns ``memories`` with the ``Idle`` that ``idle_before`` reads at the next frame of the stream.

    ``client`` is the input of the frame that was just computed, and ``message`` its message. ``before`` is what
    ``idle_before`` returned for it; the new ``Idle`` counts on from it, or anew from None.
    """
    now_s = float(client.times_s[0])
    since_s, frames = (now_s, 0) if before is None else (before.since_s, before.frames)
    idle = Idle(client.poses[0], client.trans[0], client.betas, plan, since_s, now_s, frames + 1, message)
    return {**memories, KEY: idle}
