"""The clock of cloth that moves: a frame, the memory of it, and whether the next frame follows it.

Folds and swing keep a memory each. Both are forgotten at a cut: after a pause, when the clock goes back, and when the
network moves a vertex farther than any motion does. ``leads_to`` decides it for folds; swing decides in the engine
(``source/swing.hpp``), where two frames of one time are a cut too.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np

from drape.geometry.colliders import NONE

PAUSE_S = 0.25  # a frame that comes later than that after the one before has no past
# Frames that come closer together count as this far apart: a clock's jitter must not become an acceleration.
SHORTEST_STEP_S = 1.0 / 240.0
_FLOAT64 = np.dtype(np.float64)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame as folds and swing take it. All coordinates count from the same origin.

    ``vertices`` [m] (V, 3) are the network's; ``skin`` (S, 8) are the posed samples of the skin, rows of
    ``drape.contact.samples.sample_table``; ``colliders`` (M, 16) are the scene's (``drape.geometry.colliders``).
    ``time_s`` [s] is by the client's clock.
    """

    vertices: np.ndarray
    skin: np.ndarray
    time_s: float
    colliders: np.ndarray = field(default_factory=NONE.copy)

    def around(self, dtype: np.dtype) -> Surroundings:
        """Returns skin and colliders as the engine reads them: the skin of ``dtype``, the colliders float64."""
        return Surroundings(writable(self.skin, dtype), writable(self.colliders, _FLOAT64))


def writable(array: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Returns ``array`` of ``dtype``, contiguous and in memory that may be written, as kernels want it: itself if it is
    so already, else a copy."""
    fits = array.dtype == dtype and array.flags.c_contiguous and array.flags.writeable
    return array if fits else np.array(array, dtype, order="C")


class Surroundings(NamedTuple):
    """What cloth does not pass through, as the engine reads it: the samples ``skin`` (S, 8), rows of ``sample_table``,
    and the scene's ``colliders`` (M, 16)."""

    skin: np.ndarray
    colliders: np.ndarray


@dataclass(frozen=True, eq=False)
class FrameMemory:
    """What both folds and swing remember of a frame: its time ``time_s`` [s], and ``network`` [m] (P, 3), where the
    network's drape had P points of the cloth."""

    time_s: float
    network: np.ndarray

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle has of it: not what else was kept for the next frame, which may hold addresses."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def leads_to(self, time_s: float) -> bool:
        """Whether a frame at ``time_s`` [s] may go on from this one: it is not before it and at most ``PAUSE_S`` after
        it."""
        return 0.0 <= time_s - self.time_s <= PAUSE_S

    def at(self, time_s: float) -> Self:
        """Returns the same memory, of a frame at ``time_s`` [s]."""
        return replace(self, time_s=time_s)


def step_between(before_s: float, after_s: float) -> float:
    """Returns the time step [s] between frames at ``before_s`` and ``after_s``, at least ``SHORTEST_STEP_S``."""
    return max(after_s - before_s, SHORTEST_STEP_S)
