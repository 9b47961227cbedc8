"""One frame of one garment in one call of the engine: a pose in, draped vertices, memories and wire coordinates out.

The engine calls its own functions one after the other (``source/frame.cpp``). So it gives the bits of ``pose_bodies``,
``checked_jets``, ``blend``, ``swing`` and folds, and what is between them never becomes an object of Python.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.packer import Record
from drape.graph.blend import Tiles
from drape.live.fold_step import OUTCOME, FoldEffort, FoldReport, no_past, read_outcome, recorded
from drape.live.swing_step import NO_PAST, SwingConstants, SwingMemory, empty_memory
from drape.live.two_level import Memory, OneLevel, TwoLevel
from drape.network.bodies import BodyFeed
from drape.network.novelty import KeptPoses
from drape.network.patch_rows import PatchRows
from drape.network.weights import Weights

PARTS = ("novelty", "network", "swing", "folds", "encode")
_BOX = OUTCOME + 1 + len(PARTS)  # after what folds tell come the novelty and the ticks of the parts
_FLOAT = np.dtype(np.float32)
_NO_STEPS = np.empty((0, 3), np.uint16)


class FrameParts(NamedTuple):
    """The record that the engine reads of a ``FrameGarment``."""

    weights: Weights
    kept: KeptPoses | None
    patches: PatchRows
    tiles: Tiles
    swing: SwingConstants | None
    cloth: Any
    levels: Any
    effort: Record
    novel_effort: Record
    passes: int
    share: float
    step_count: int


@dataclass(frozen=True, eq=False)
class FrameGarment:
    """The constants that drape a garment.

    They are the network's ``weights`` with the number of its ``passes``, the garment's ``patches`` and ``tiles``, its
    ``swing`` by a ``share``, and its ``folds`` by ``efforts``, of which the second is for novel poses; ``kept`` are the
    poses that the network was trained on. A part that is None does not exist. The garment has ``vertex_count``
    vertices, whose coordinates get steps from 0 to ``step_count``.
    """

    weights: Weights
    passes: int
    patches: PatchRows
    tiles: Tiles
    kept: KeptPoses | None
    swing: SwingConstants | None
    share: float
    folds: OneLevel | TwoLevel | None
    efforts: tuple[FoldEffort, FoldEffort]
    vertex_count: int
    step_count: int

    @property
    def effort(self) -> FoldEffort:
        """The effort of a frame whose pose is like training."""
        return self.efforts[0]

    @property
    def identity(self) -> tuple[Any, ...]:
        """What two such constants have in common that draw the same."""
        given = (getattr(self, field.name) for field in fields(self))
        return tuple(each if isinstance(each, int | float | tuple) else id(each) for each in given)

    @cached_property
    def record(self) -> Record:
        """The record that the engine reads of it."""
        folds = self.folds
        return frame_parts(self, folds.constants if isinstance(folds, OneLevel) else folds.levels if folds else None)


def frame_parts(worn: FrameGarment, cloth: Any) -> Record:
    """Returns the record that the engine reads of ``worn``, with the constants of folds ``cloth``, or their record."""
    one_level = isinstance(worn.folds, OneLevel)
    effort, novel_effort = map(recorded, worn.efforts)
    given = FrameParts(
        worn.weights,
        worn.kept,
        worn.patches,
        worn.tiles,
        worn.swing,
        cloth if one_level else None,
        None if one_level else cloth,
        effort,
        novel_effort,
        worn.passes,
        worn.share,
        worn.step_count,
    )
    return Record("FrameParts", given, _FLOAT)


class Past(NamedTuple):
    """The memories of swing and of folds that a frame leaves to the next one. None: the garment has no such part, or
    there was no frame before."""

    swung: SwingMemory | None
    folded: Memory | None


class Moment(NamedTuple):
    """A ``pose`` (24, 3) [rad] of a ``body`` at ``time_s``, whose ``origin`` [m] (3,) is that of the coordinates in the
    world, and the ``colliders`` (M, 16) seen from there, float64. ``body`` is without a pose."""

    body: BodyFeed
    pose: np.ndarray
    time_s: float
    origin: np.ndarray
    colliders: np.ndarray


class Drawn(NamedTuple):
    """A frame that the engine has computed: the memories ``past`` that it leaves, the ``report`` of its folds, the
    ``novelty`` of its pose (0 where no poses are kept), and the ``low`` corner and the ``step`` size (3,) of its
    coordinates.

    ``ticks``: the processor's ticks that each of ``PARTS`` took.
    """

    past: Past
    report: FoldReport | None
    novelty: float
    low: np.ndarray
    step: np.ndarray
    ticks: list[int]


class FrameCall(NamedTuple):
    """The record that the engine reads of a frame, with the addresses at which it writes."""

    parts: Record
    body: BodyFeed
    lifts: bool
    turns: np.ndarray
    colliders: np.ndarray
    swung_before: SwingMemory | None
    swung: SwingMemory | None
    folded_before: Record
    folded: Record
    vertices: np.ndarray
    steps: np.ndarray


def draw(
    worn: FrameGarment, past: Past, at: Moment, vertices: np.ndarray, steps: np.ndarray = _NO_STEPS
) -> Drawn | None:
    """Computes the frame ``at`` a moment and returns it; None if the network's numbers are not finite.

    ``vertices`` [m] (V, 3) are written, and ``steps`` (V, 3) if given. ``past`` is not written to. The frame must not
    be one that ``begins`` to fold after the lift alone.
    """
    outcome = np.empty(_BOX + 3, np.int64)
    swung = before = folding = None
    if worn.swing is not None:
        swung, before = empty_memory(worn.swing, at.time_s, at.origin, at.colliders), past.swung or NO_PAST
    if worn.folds is not None:
        folding = worn.folds.call(past.folded, at.time_s, worn.effort)
    call = FrameCall(
        worn.record,
        at.body,
        folding is not None and folding.name == "lift_alone",
        at.pose,
        at.colliders,
        before,
        swung,
        no_past(_FLOAT) if folding is None else folding.past,
        no_past(_FLOAT) if folding is None else folding.after,
        vertices,
        steps,
    )
    if not call_with_scratch("frame", _FLOAT, Record("FrameCall", call, _FLOAT), outcome):
        return None
    folded = report = None
    if folding is not None:
        turn, _, report = read_outcome(outcome[:OUTCOME])
        folded = folding.remembered(turn)
    novelty = float(outcome[OUTCOME : OUTCOME + 1].view(np.float64)[0])
    box = outcome[_BOX:].view(np.float32)
    return Drawn(Past(swung, folded), report, novelty, box[:3], box[3:], outcome[OUTCOME + 1 : _BOX].tolist())
