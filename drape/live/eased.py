"""Cloth without folds: the network's drape, eased by steps of the whole coarse cloth, and lifted off the skin.

The network stretches cloth that no triangle of it feels. One step a frame of the stiffness that the coarse cloth has at
rest (``whole``) takes most of that out, over the skin below and other parts of the body (``source/eased.hpp`` of the
engine). How far a frame was eased goes along with the network's surface, fades, and is where the next step begins. What
is left in the skin is lifted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.engine.packer import Record, Recorded
from drape.live.clock import Frame, FrameMemory, step_between
from drape.live.fold_constants import FoldConstants
from drape.live.fold_step import FoldCall, FoldEffort, FoldReport, framed, no_arrays, no_past
from drape.live.sheet import Sheet
from drape.live.untangle import Tangles


@dataclass(frozen=True, eq=False)
class LiftMemory(FrameMemory):
    """A frame of cloth that was eased and lifted alone: at the coarse cloth's places the network's points, the samples
    ``own`` (P,), and how far it was ``eased`` [m] (P, 3), in the frames of the network's surface."""

    own: np.ndarray
    eased: np.ndarray


class FineLevel(NamedTuple):
    """The fine cloth of two levels, its ``sheet``, and how its places follow coarse ones.

    ``near`` and ``weight`` are flat, ``NEAREST`` rows of ``LANES`` numbers a block: the coarse places from which each
    place takes its movement, and how much. ``parent`` (P,) is the coarse place that it takes most from. ``tangles`` are
    the triangles that may cross.
    """

    sheet: Sheet
    near: np.ndarray
    weight: np.ndarray
    parent: np.ndarray
    tangles: Tangles


@dataclass(frozen=True, eq=False)
class Levels(Recorded):
    """The ``coarse`` cloth, the fine vertex ``kept`` (n,) at each of its places, and the ``fine`` level."""

    coarse: FoldConstants
    kept: np.ndarray
    fine: FineLevel


def lifted_alone(
    levels: Levels, memory: LiftMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, LiftMemory, FoldReport]:
    """Returns the vertices [m] (V, 3) of ``frame`` after easing and lift, the memory for the next frame, and a report.

    The vertices are up to the clearance off the skin, and out of the scene's colliders.
    """
    return framed(lift_call(levels, memory, frame.time_s), frame, effort)


def lift_call(levels: Levels, memory: LiftMemory | None, time_s: float) -> FoldCall:
    """The call of ``lifted_alone`` for a frame at ``time_s`` [s]."""
    dtype, places = levels.fine.sheet.own.dtype, len(levels.kept)
    none, past = no_arrays(dtype), no_past(dtype)
    if memory is not None and memory.leads_to(time_s):
        step_s = step_between(memory.time_s, time_s)
        arrays = none._replace(network=memory.network, own=memory.own, residual=memory.eased, step_s=step_s)
        past = Record("FoldMemory", arrays, dtype)
    network, eased = np.empty((2, places, 3), dtype)
    after = none._replace(network=network, own=np.empty(places, np.int32), residual=eased)
    made = LiftMemory(time_s, network, after.own, eased)
    return FoldCall("lift_alone", levels, past, Record("FoldMemory", after, dtype), lambda _: made)
