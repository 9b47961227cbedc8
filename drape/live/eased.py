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
from drape.live.clock import FrameMemory, step_between
from drape.live.fold_constants import FoldConstants
from drape.live.fold_step import FoldCall, no_arrays, no_past
from drape.live.sheet import Sheet
from drape.live.untangle import Tangles


@dataclass(frozen=True, eq=False)
class LiftMemory(FrameMemory):
    """What a frame without folds, which was only eased and lifted, leaves to the next one. Its P points are the places
    of the coarse cloth.

    ``own`` (P,) is the index of the skin sample under each, and ``eased`` [m] (P, 3) is how far easing moved it from
    the network's drape, in the local frames of that surface.
    """

    own: np.ndarray
    eased: np.ndarray


class FineLevel(NamedTuple):
    """The fine cloth of two levels: its ``sheet`` of P places, and how these follow the places of the coarse cloth.

    ``near`` and ``weight`` are flat, ``NEAREST`` rows of ``LANES`` numbers a block: the coarse places whose movements
    move each place, and their weights. ``parent`` (P,) is the coarse place of the largest weight. ``tangles`` are the
    triangles that may cross.
    """

    sheet: Sheet
    near: np.ndarray
    weight: np.ndarray
    parent: np.ndarray
    tangles: Tangles


@dataclass(frozen=True, eq=False)
class Levels(Recorded):
    """The two levels of a cloth: the ``coarse`` one, the ``fine`` one, and ``kept`` (n,), the fine vertex at each place
    of the coarse cloth."""

    coarse: FoldConstants
    kept: np.ndarray
    fine: FineLevel


def lift_call(levels: Levels, memory: LiftMemory | None, time_s: float) -> FoldCall:
    """Returns the engine's call that eases and lifts a frame at ``time_s`` [s] after ``memory``.

    The call moves the frame's vertices to the clearance of its ``FoldEffort`` off the skin, and out of the scene's
    colliders.
    """
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
