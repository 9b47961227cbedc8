"""One frame of folds: the network's drape and the memory of the frame before in, folded cloth and a new memory out.

The engine computes it (``source/folds.hpp``). The memory holds the folds as a residual r and a velocity u in local
frames R of the network's surface X: r = R (x - X), u = R v / dt, v the way of the last step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from drape.contact.projection import CLEARANCE_M
from drape.engine.calls import call_with_scratch
from drape.engine.packer import Record, Recorded
from drape.live.clock import Frame, FrameMemory, step_between
from drape.live.fold_constants import FoldConstants
from drape.live.skin_walks import TouchedSamples

OUTCOME = 7  # numbers of 64 bits that the engine writes about a frame


@dataclass(frozen=True, eq=False)
class FoldMemory(FrameMemory):
    """What a frame of folds leaves to the next one. Its P points are the places of the ``Sheet`` of ``FoldConstants``.

    ``residual`` [m] (P, 3) is how far the folds have moved each from the network's drape, and ``velocity`` [m/s] (P, 3)
    how fast they move it, both in the local frames of that surface. ``touched`` are the skin samples at the places.
    ``grip`` [m] (P, 3) is where friction holds each place, in the local frame of its own sample. In the next frame a
    quarter of the vertices, those whose number is ``turn`` modulo four, look for other parts of the body.
    """

    residual: np.ndarray
    velocity: np.ndarray
    touched: TouchedSamples
    grip: np.ndarray
    turn: int

    def arrays(self, fine: np.ndarray) -> Record:
        """Returns the record that the engine reads of this memory and of ``fine`` [m] (Q, 3), the positions of a fine
        cloth; its time step is not set. The record is made once for the same array ``fine``."""
        left: Record | None = vars(self).get("left")
        if left is None or left.arrays[-1] is not fine:
            arrays = FoldArrays(self.network, self.residual, self.velocity, self.grip, *self.touched, fine)
            left = vars(self)["left"] = Record("FoldMemory", arrays, self.network.dtype)
        return left


@dataclass(frozen=True)
class FoldReport:
    """How a frame of folds came out.

    ``settled``: it had no past to go on from. ``reset``: it was begun anew from the network's drape, because a vertex
    had come more than 0.25 m away from that, or the network had jumped too far. ``lifted_share`` in [0, 1] of the
    vertices were lifted off the skin, the farthest by ``lifted_max_m`` [m].
    """

    settled: bool
    reset: bool = False
    lifted_share: float = 0.0
    lifted_max_m: float = 0.0


class FoldEffort(NamedTuple):
    """The work that a frame of folds gets: ``steps`` of the whole cloth, and as many sweeps over its vertices.

    A frame without a past gets ``settle`` sweeps, and then ``settle`` times these steps and sweeps. With 0 steps no
    energy is looked at: the folds go along with the network's surface and fade, and a frame without a past has none.

    ``cloth_contact``: whether cloth keeps apart from itself. ``clearance_m`` [m]: a vertex nearer to its own part of
    the skin is lifted; 0 lifts none.
    """

    steps: int
    settle: int = 8
    cloth_contact: bool = False
    clearance_m: float = CLEARANCE_M


class FoldArrays(NamedTuple):
    """The arrays of a ``FoldMemory``, and for a cloth of two levels where the Q places of the ``fine`` one are, [m]
    (Q, 3), as the engine reads them before a frame and writes them after it.

    ``step_s`` [s] is the time from this past to the frame; infinite where there is none.
    """

    network: np.ndarray
    residual: np.ndarray
    velocity: np.ndarray
    grip: np.ndarray
    own: np.ndarray
    other: np.ndarray
    fine: np.ndarray
    turn: int = 0
    step_s: float = math.inf


def empty_arrays(places: int, fine_places: int, dtype: np.dtype) -> tuple[FoldArrays, Record]:
    """Returns unwritten arrays for the memory of a frame, of a cloth of ``places`` places and a fine one of
    ``fine_places``, 0 if there is none; and the record that points to them."""
    points, samples = np.empty((4, places, 3), dtype), np.empty((2, places), np.int32)
    fine = np.empty((fine_places, 3), dtype) if fine_places else no_places(dtype)
    (network, residual, velocity, grip), (own, other) = points, samples
    arrays = FoldArrays(network, residual, velocity, grip, own, other, fine)
    record = Record.of_rows((points, samples, fine[None]), 0, math.inf)
    record.arrays[-1] = fine
    return arrays, record


class FoldCall(NamedTuple):
    """A frame of folds for the engine: the ``name`` of its function, the ``constants``, the record ``past`` that it
    reads and the record ``after`` that it writes.

    ``remembered(turn)`` returns the frame's memory once it is computed; ``turn`` is that of the next frame.
    """

    name: str
    constants: Recorded
    past: Record
    after: Record
    remembered: Callable[[int], Any]


def fold(
    constants: FoldConstants, memory: FoldMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, FoldMemory, FoldReport]:
    """Returns the vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    The same input gives the same bits. ``memory`` is only read.
    """
    return compute_frame(fold_call(constants, memory, frame.time_s), frame, effort)


def fold_call(constants: FoldConstants, memory: FoldMemory | None, time_s: float) -> FoldCall:
    """Returns the engine's call of ``fold`` for a frame at ``time_s`` [s] after ``memory``."""
    dtype = constants.sheet.own.dtype
    after, record = empty_arrays(len(constants.sheet.vertex), 0, dtype)
    past = past_of(memory, time_s, no_places(dtype))
    return FoldCall("fold", constants, past, record, lambda turn: memory_of(time_s, after, turn, record))


def past_of(memory: FoldMemory | None, time_s: float, fine: np.ndarray) -> Record:
    """Returns the record of the past of a frame at ``time_s`` [s]: ``memory`` and the positions ``fine`` [m] (Q, 3) of
    a fine cloth. It is ``no_past`` if there is no memory, or if the frame does not follow it."""
    if memory is None or not memory.leads_to(time_s):
        return no_past(fine.dtype)
    return memory.arrays(fine).ending(memory.turn, step_between(memory.time_s, time_s))


@cache
def no_places(dtype: np.dtype) -> np.ndarray:
    """Returns an empty array (0, 3) of ``dtype``: the fine places where there is no fine cloth or no past."""
    return np.empty((0, 3), dtype)


@cache
def no_arrays(dtype: np.dtype) -> FoldArrays:
    """Returns the arrays of a memory of no places, floats of ``dtype``."""
    return empty_arrays(0, 0, dtype)[0]


@cache
def no_past(dtype: np.dtype) -> Record:
    """Returns the engine's record for a frame without a past, floats of ``dtype``."""
    return Record("FoldMemory", no_arrays(dtype), dtype)


def memory_of(time_s: float, after: FoldArrays, turn: int, left: Record) -> FoldMemory:
    """Returns the memory of a frame at ``time_s`` [s] from the arrays ``after`` that the engine wrote; ``left`` is the
    record that points to these."""
    touched = TouchedSamples(after.own, after.other)
    memory = FoldMemory(time_s, after.network, after.residual, after.velocity, touched, after.grip, turn)
    vars(memory)["left"] = left
    return memory


def compute_frame(call: FoldCall, frame: Frame, effort: FoldEffort) -> tuple[np.ndarray, Any, FoldReport]:
    """Returns for ``frame``, which it computes by ``call``, the vertices [m] (V, 3), the memory for the next frame, and
    a report. If folds take any vertex more than 0.25 m away from the network's drape, even without a past, the vertices
    are all as the network has them."""
    dtype = call.after.arrays[0].dtype
    vertices, around = np.ascontiguousarray(frame.vertices, dtype), frame.around(dtype)
    out, outcome = np.empty_like(vertices), np.empty(OUTCOME, np.int64)
    call_with_scratch(
        call.name, dtype, vertices, call.past, Record("Surroundings", around, dtype),
        call.constants, effort_record(effort), call.after, out, outcome,
    )  # fmt: skip
    turn, lost, report = read_outcome(outcome)
    return frame.vertices if lost else out, call.remembered(turn), report


def read_outcome(outcome: np.ndarray) -> tuple[int, bool, FoldReport]:
    """Reads the ``outcome`` (OUTCOME,) int64 that the engine writes for a frame. Returns the turn of the next frame;
    whether the folds are lost, because a vertex came too far away from the network's drape; and the report."""
    settled, reset, lost, turn = outcome[:4].tolist()
    _, share, far_m = outcome[4:].view(np.float64).tolist()
    return turn, bool(lost), FoldReport(bool(settled), bool(reset), share, far_m)


@lru_cache
def effort_record(effort: FoldEffort) -> Record:
    """Returns ``effort`` as the record that the engine reads."""
    return Record("FoldEffort", effort)
