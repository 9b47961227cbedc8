"""The motion of a body as the network reads it: a memory, which each frame moves on, and a code.

The memory belongs to the body and not to a garment: all that hangs on a body swings with the same motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.body.features import Kinematics, motion_features
from drape.live.clock import step_between
from drape.network.bodies import moments
from drape.stages.batch import Batch, changed
from drape.stages.plan import Plan
from drape.stages.stage import BODY, Stage, StageSetup
from drape.wire.options import DrapeOptions

if TYPE_CHECKING:
    from drape.inference.engine import Engine

STEP_LIMIT_S = 0.25
"""After a longer pause the cloth hangs still again, and motion is measured anew."""
JUMP_M_S = 25.0
"""A joint that is faster was not moved there: a clip began again, or a tracker lost its body."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The kinematics of a body's 24 joints at a time [s] of its client's clock."""

    time_s: float
    at: Kinematics


@dataclass(frozen=True, eq=False)
class Memory:
    """The last two moments of a body, newest first, the recurrent state (H,) after them and its code (C,)."""

    moments: tuple[Moment, ...]
    state: np.ndarray
    code: np.ndarray

    @staticmethod
    def empty(engine: Engine) -> Memory:
        """Returns the memory of a body before its first frame: no moments, and zeros, which give the static drape."""
        return Memory((), np.zeros(engine.state_size, np.float32), np.zeros(engine.code_size, np.float32))


class Motion(Stage):
    """The stage that gives every frame the code of its body's motion, multiplied by the knob."""

    name = "motion"
    key = (name, BODY)
    kept = (Memory, Moment, Kinematics)

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        if self.engine.dynamic:  # so that the first request does not pay for lazy set-up
            rest = Memory.empty(self.engine).state[None]
            self.engine.advance(np.zeros((1, 24, 12)), rest, np.array([1.0 / 30.0]))

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        smooth = options.geometry == "jets" and options.folds_by == "server"
        inertia = options.advanced.inertia or ("network" if smooth else self.settings.inertia)
        knob = 1.0 if options.knob is None else options.knob
        moves = inertia == "mesh" or self.engine.dynamic
        return {"knob": knob if moves else 0.0, "inertia": inertia}

    def wanted(self, plan: Plan) -> bool:
        return bool(plan.options.knob) and plan.options.advanced.inertia == "network"

    def rested(self, memory: Memory, time_s: float) -> Memory:
        """Returns ``memory`` with its two moments moved in time, so that the latest one is at ``time_s`` [s]."""
        if not memory.moments:
            return memory
        later_s = time_s - memory.moments[0].time_s
        return replace(
            memory, moments=tuple(replace(moment, time_s=moment.time_s + later_s) for moment in memory.moments)
        )

    def run(self, batch: Batch) -> Batch:
        """Returns the batch with ``codes`` (F, C), the code of each frame's motion multiplied by the knob.

        Frames are computed one after the other, since each needs the state after the one before. The inputs of one
        frame go through the network together.
        """
        knob = np.float32(batch.plan.options.knob)
        memories = [memory or Memory.empty(self.engine) for memory in batch.remembered(self.key)]
        bodies = [moments(self.body, own.poses, own.trans, own.betas) for own in batch.inputs]
        codes = [np.zeros((len(own.poses), self.engine.code_size), np.float32) for own in batch.inputs]
        for frame in range(max(len(own.poses) for own in batch.inputs)):
            rows = [i for i, own in enumerate(batch.inputs) if frame < len(own.poses)]
            now = [Moment(float(batch.inputs[i].times_s[frame]), bodies[i][frame]) for i in rows]
            after = advance(self.engine, [memories[i] for i in rows], now)
            for i, memory in zip(rows, after, strict=True):
                memories[i] = memory
                codes[i][frame] = knob * memory.code
        return changed(batch, codes=np.concatenate(codes)).remember(self.key, memories)


def advance(engine: Engine, memories: Sequence[Memory], moments: Sequence[Moment]) -> list[Memory]:
    """Returns ``memories``, one for each body, after the next moment of each body in ``moments``. The network runs once
    for all bodies.

    A body begins anew, with zeros for state and code, where it jumps (``JUMP_M_S``), and where its time goes back or
    forward by more than ``STEP_LIMIT_S``. A moment at the time of the last one changes nothing. Motion counts from the
    third moment on.
    """
    after = [_seen(engine, memory, moment) for memory, moment in zip(memories, moments, strict=True)]
    moving = [i for i, memory in enumerate(after) if memory is not memories[i] and len(memory.moments) == 3]
    if not moving:
        return after
    now, before, earlier = (_stacked([after[i].moments[k].at for i in moving]) for k in range(3))
    dt_s, dt_before_s = (_steps([after[i].moments[k : k + 2] for i in moving]) for k in range(2))
    features = motion_features(now, before, earlier, dt_s, dt_before_s)
    codes, states = engine.advance(features, np.stack([after[i].state for i in moving]), dt_s)
    for row, i in enumerate(moving):
        after[i] = Memory(after[i].moments[:2], states[row], codes[row])
    return after


def _seen(engine: Engine, memory: Memory, moment: Moment) -> Memory:
    """``memory`` with ``moment`` in front, or a new memory if the two do not follow each other."""
    if memory.moments:
        last = memory.moments[0]
        dt_s = moment.time_s - last.time_s
        if dt_s == 0.0:
            return memory
        if 0.0 < dt_s <= STEP_LIMIT_S:
            fastest_m_s = np.linalg.norm(moment.at.joints - last.at.joints, axis=-1).max() / step_between(
                last.time_s, moment.time_s
            )
            if fastest_m_s <= JUMP_M_S:
                return replace(memory, moments=(moment, *memory.moments))
    return replace(Memory.empty(engine), moments=(moment,))


def _stacked(bodies: Sequence[Kinematics]) -> Kinematics:
    return Kinematics(
        np.stack([body.static for body in bodies]),
        np.stack([body.joints for body in bodies]),
        np.stack([body.rotations for body in bodies]),
    )


def _steps(pairs: Sequence[tuple[Moment, ...]]) -> np.ndarray:
    """Time steps [s] (n,) between the two moments of each pair, newest first."""
    return np.array([step_between(older.time_s, newer.time_s) for newer, older in pairs])
