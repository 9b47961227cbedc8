"""One frame of folds: the network's drape and the memory of the frame before in, folded cloth and a new memory out.

The engine computes it (``source/folds.hpp``). The memory holds the folds as a residual r and a velocity u in local
frames R of the network's surface X: r = R (x - X), u = R v / dt, v the way of the last step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from drape.contact.projection import CLEARANCE_M
from drape.engine.calls import call_with_scratch
from drape.engine.packer import Record, Recorded
from drape.live.clock import Frame, FrameMemory, step_between
from drape.live.fold_constants import FoldConstants
from drape.live.skin_walks import TouchedSamples


@dataclass(frozen=True, eq=False)
class FoldMemory(FrameMemory):
    """A frame as folds remember it, in the order of the constants' places.

    In the frames of the network's surface the ``residual`` [m] and ``velocity`` [m/s] (P, 3) of the folds; the samples
    ``touched``; ``grip`` [m] (P, 3): where friction holds each place, in the frame of its own sample. In the next frame
    a quarter of the vertices, those whose number is ``turn`` modulo four, look for other parts of the body.
    """

    residual: np.ndarray
    velocity: np.ndarray
    touched: TouchedSamples
    grip: np.ndarray
    turn: int


@dataclass(frozen=True)
class FoldReport:
    """The outcome of a frame. It ``settled`` if it had no past to go on from. It was ``reset`` if its result was no
    fold, and it was begun anew from the network's drape. ``lifted_share`` of the vertices were lifted off the skin, the
    farthest by ``lifted_max_m`` [m]."""

    settled: bool
    reset: bool = False
    lifted_share: float = 0.0
    lifted_max_m: float = 0.0


class FoldEffort(NamedTuple):
    """The work that a frame gets.

    ``steps`` of the whole cloth, and half as many sweeps over its vertices, at least one; fast motion changes both. A
    frame without a past gets ``settle`` sweeps, and then ``settle`` times all of these. With 0 steps no energy is
    looked at: the folds go along with the network's surface and fade, and a frame without a past has none.

    ``cloth_contact``: whether cloth keeps apart from itself.
    ``clearance_m`` [m]: a vertex nearer to its own part of the skin is lifted; 0 lifts none.
    """

    steps: int
    settle: int = 8
    cloth_contact: bool = False
    clearance_m: float = CLEARANCE_M


class FoldArrays(NamedTuple):
    """What a frame goes on from, or leaves, as the engine has it: the arrays of ``FoldMemory`` and what sweeps
    ``added`` [m] (P, 3) to a fine cloth. The past is ``step_s`` [s] before; infinite where there is none."""

    network: np.ndarray
    residual: np.ndarray
    velocity: np.ndarray
    grip: np.ndarray
    own: np.ndarray
    other: np.ndarray
    added: np.ndarray
    turn: int = 0
    step_s: float = math.inf

    @classmethod
    def empty(cls, places: int, fine_places: int, dtype: np.dtype) -> FoldArrays:
        """Room for a frame of so many places, of the coarse cloth and of the fine one."""
        network, residual, velocity, grip = np.empty((4, places, 3), dtype)
        own, other = np.empty((2, places), np.int32)
        return cls(network, residual, velocity, grip, own, other, np.empty((fine_places, 3), dtype))


def fold(
    constants: FoldConstants, memory: FoldMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, FoldMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    The same input gives the same bits. ``memory`` is not written to.
    """
    dtype = constants.sheet.own.dtype
    after = FoldArrays.empty(len(constants.sheet.vertex), 0, dtype)
    past = past_of(memory, frame.time_s, dtype)
    vertices, turn, report = framed("fold", constants, past, frame, effort, after)
    return vertices, memory_of(frame.time_s, after, turn), report


def past_of(memory: FoldMemory | None, time_s: float, dtype: np.dtype, added: np.ndarray | None = None) -> FoldArrays:
    """What ``memory``, and what sweeps ``added``, say to a frame at ``time_s`` [s], of ``dtype``."""
    none = no_past(dtype)
    if memory is None or not memory.leads_to(time_s):
        return none
    return FoldArrays(
        memory.network, memory.residual, memory.velocity, memory.grip, *memory.touched,
        none.added if added is None else added, memory.turn, step_between(memory.time_s, time_s),
    )  # fmt: skip


@cache
def no_past(dtype: np.dtype) -> FoldArrays:
    """A past of ``dtype`` that is none."""
    return FoldArrays.empty(0, 0, dtype)


def memory_of(time_s: float, after: FoldArrays, turn: int) -> FoldMemory:
    """The memory of a frame at ``time_s`` [s]."""
    touched = TouchedSamples(after.own, after.other)
    return FoldMemory(time_s, after.network, after.residual, after.velocity, touched, after.grip, turn)


def framed(
    name: str, constants: Recorded, past: FoldArrays, frame: Frame, effort: FoldEffort, after: FoldArrays
) -> tuple[np.ndarray, int, FoldReport]:
    """The vertices [m] (V, 3) that the engine's function ``name`` makes of ``frame``, the turn of the next frame, and a
    report. ``after`` is filled; where nothing led to a fold the vertices are the network's."""
    dtype = after.network.dtype
    vertices, around = np.ascontiguousarray(frame.vertices, dtype), frame.around(dtype)
    out, told = np.empty_like(vertices), np.empty(7, np.int64)
    call_with_scratch(
        name, dtype, vertices, Record("FoldMemory", past, dtype), Record("Surroundings", around, dtype), constants,
        _recorded(effort), Record("FoldMemory", after, dtype), out, told,
    )  # fmt: skip
    settled, reset, lost, turn = told[:4].tolist()
    _, share, far_m = told[4:].view(np.float64).tolist()
    report = FoldReport(bool(settled), bool(reset), share, far_m)
    return frame.vertices if lost else out, turn, report


@lru_cache
def _recorded(effort: FoldEffort) -> Record:
    return Record("FoldEffort", effort)
