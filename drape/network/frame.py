"""One frame of one stream in one call of the engine: a pose in; vertices, memories and wire coordinates out.

The engine calls its own functions one after the other (``source/frame_steps.hpp``). So it gives the bits of
``pose_bodies``, ``checked_jets``, ``blend``, ``swing``, folds and layers, and what is between them never becomes an
object of Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.card_jobs import TOLD
from drape.engine.packer import Record
from drape.graph.blend import Tiles
from drape.live.fold_constants import LaidCloth
from drape.live.fold_step import OUTCOME, FoldEffort, FoldReport, effort_record, no_past, read_outcome
from drape.live.swing_step import NO_PAST, SwingConstants, SwingMemory, empty_memory
from drape.live.two_level import Memory, OneLevel, TwoLevel
from drape.network.bodies import BodyFeed
from drape.network.novelty import KeptPoses
from drape.network.patch_rows import PatchRows
from drape.network.weights import Weights

PARTS = ("novelty", "network", "swing", "folds", "encode")
MOST_LAYERS = 8  # garments that the engine draws in one call
_BOX = OUTCOME + 1 + len(PARTS)  # after the outcome of folds come the novelty and the ticks of the parts
_FLOAT = np.dtype(np.float32)
_NO_STEPS = np.empty((0, 3), np.uint16)


class FrameParts(NamedTuple):
    """The fields of a ``FrameGarment`` as the engine reads them.

    ``cloth`` are the constants of folds on one level, ``levels`` those on two; the other is None, or both without
    folds. ``laid`` is what garments over and below it read, None where these do not feel each other. ``effort`` and
    ``novel_effort`` are the two efforts.
    """

    weights: Weights
    kept: KeptPoses | None
    patches: PatchRows
    tiles: Tiles
    swing: SwingConstants | None
    cloth: Any
    levels: Any
    laid: LaidCloth | None
    effort: Record
    novel_effort: Record
    passes: int
    share: float
    read: bool


@dataclass(frozen=True, eq=False)
class FrameGarment:
    """The constants by which a garment is draped. A part that is None does not take place.

    They are the network's ``weights`` and the number of its ``passes``, the garment's ``patches`` and ``tiles``, the
    poses ``kept`` of training, ``swing`` by a ``share`` of 0 to 1, and ``folds`` by ``efforts``, of which the second is
    for novel poses. ``felt``: the garments of the outfit feel each other. ``read``: the garment is shown, so it is
    pressed below what is worn over it.
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
    felt: bool
    read: bool

    @cached_property
    def record(self) -> Record:
        """The garment as the record that the engine reads."""
        folds = self.folds
        return frame_parts(self, folds.constants if isinstance(folds, OneLevel) else folds.levels if folds else None)


@dataclass(frozen=True, eq=False)
class FrameOutfit:
    """The ``garments`` that a stream wears, the innermost first, and whether each is ``seen``.

    The vertices of all are one array: first those of the garments that are seen, then those of others. The coordinates
    of the first are also written as steps from 0 to ``step_count``; 0: there are none.
    """

    garments: tuple[FrameGarment, ...]
    seen: tuple[bool, ...]
    step_count: int

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """The rows of each garment in the array of all vertices."""
        begin, slices = 0, dict[int, slice]()
        for i in sorted(range(len(self.seen)), key=lambda i: not self.seen[i]):
            slices[i] = slice(begin, begin + self.garments[i].vertex_count)
            begin = slices[i].stop
        return tuple(slices[i] for i in range(len(self.seen)))

    @cached_property
    def vertex_count(self) -> int:
        """The number of vertices of all garments."""
        return max(rows.stop for rows in self.rows)

    @cached_property
    def shown_count(self) -> int:
        """The number of vertices of the garments that are seen."""
        return max((rows.stop for rows, seen in zip(self.rows, self.seen, strict=True) if seen), default=0)

    @property
    def effort(self) -> FoldEffort:
        """The effort of folds in a frame whose pose is not novel, the same for all garments."""
        return self.garments[0].efforts[0]

    @property
    def folds(self) -> bool:
        """Whether the garments have folds."""
        return self.garments[0].folds is not None


def identity(constants: FrameGarment | FrameOutfit) -> tuple[Any, ...]:
    """Returns a key for dictionaries. It is equal for two constants that have the same numbers and the same objects as
    parts, so that they draw the same."""
    values = (getattr(constants, field.name) for field in fields(constants))
    return tuple(value if isinstance(value, int | float | tuple) else id(value) for value in values)


def frame_parts(worn: FrameGarment, cloth: Any) -> Record:
    """Returns the record of ``worn`` that the engine reads. ``cloth`` are its constants of folds, or their record."""
    one_level = isinstance(worn.folds, OneLevel)
    effort, novel_effort = map(effort_record, worn.efforts)
    parts = FrameParts(
        worn.weights,
        worn.kept,
        worn.patches,
        worn.tiles,
        worn.swing,
        cloth if one_level else None,
        None if one_level else cloth,
        worn.folds.laid if worn.folds is not None and worn.felt else None,
        effort,
        novel_effort,
        worn.passes,
        worn.share,
        worn.read,
    )
    return Record("FrameParts", parts, _FLOAT)


class Past(NamedTuple):
    """The memories of swing and of folds that a garment's frame leaves to the next one. None: the garment has no such
    part, or there was no frame before."""

    swung: SwingMemory | None
    folded: Memory | None


class Moment(NamedTuple):
    """A frame's pose and what surrounds it: the ``pose`` (24, 3) [rad] of a ``body`` (a feed without a pose) at
    ``time_s`` [s]. Coordinates count from ``origin`` [m] (3,) in the world, those of the ``colliders`` (M, 16) float64
    too."""

    body: BodyFeed
    pose: np.ndarray
    time_s: float
    origin: np.ndarray
    colliders: np.ndarray


class FrameResult(NamedTuple):
    """The result of a frame. By garment: the memories ``pasts`` that it leaves, and the ``reports`` of its folds, None
    without folds.

    ``novelty`` is that of the pose, 0 where no poses are kept. ``low`` [m] (3,) is the low corner of the coordinates
    and ``step`` [m] (3,) the size of one of their steps. ``ticks`` are those of the processor's clock in each of
    ``PARTS``.
    """

    pasts: tuple[Past, ...]
    reports: tuple[FoldReport | None, ...]
    novelty: float
    low: np.ndarray
    step: np.ndarray
    ticks: list[int]


class LayerCall(NamedTuple):
    """The record of one garment in a frame as the engine reads it: its constants ``parts``, whether its folds are those
    of ``lift_alone``, and its memories of swing and folds before the frame.

    The engine writes the memories ``swung`` and ``folded`` after the frame, and the ``vertices`` [m] (V, 3).
    """

    parts: Record
    lifts: bool
    swung_before: SwingMemory | None
    swung: SwingMemory | None
    folded_before: Record
    folded: Record
    vertices: np.ndarray


class FrameCall(NamedTuple):
    """The record of a frame as the engine reads it: its garments, the body with the rotation vectors ``turns`` [rad]
    (24, 3) of the pose, and the ``colliders`` (M, 16).

    The engine writes to ``steps`` (V', 3) uint16, 0 to ``step_count``, the coordinates of the vertices ``shown`` (V',
    3).
    """

    layers: Sequence[LayerCall]
    body: BodyFeed
    turns: np.ndarray
    colliders: np.ndarray
    shown: np.ndarray
    steps: np.ndarray
    step_count: int


def draw(
    outfit: FrameOutfit, pasts: Sequence[Past], at: Moment, vertices: np.ndarray, steps: np.ndarray = _NO_STEPS
) -> FrameResult | None:
    """Returns the result of the frame ``at`` a moment; None if the network's numbers are not finite.

    ``vertices`` [m] (V, 3) of all garments are written, relative to the moment's origin, and ``steps`` (V', 3) uint16
    of those that are seen, if given. ``pasts``, one for each garment, are only read. A garment for which
    ``TwoLevel.begins`` is true cannot be drawn so.
    """
    results, calls = np.zeros((len(pasts), TOLD), np.int64), list[tuple[SwingMemory | None, Any]]()
    layers = []
    for worn, past, rows in zip(outfit.garments, pasts, outfit.rows, strict=True):
        swung = before = folding = None
        if worn.swing is not None:
            swung, before = empty_memory(worn.swing, at.time_s, at.origin, at.colliders), past.swung or NO_PAST
        if worn.folds is not None:
            folding = worn.folds.call(past.folded, at.time_s, outfit.effort)
        none, lifts = no_past(_FLOAT), folding is not None and folding.name == "lift_alone"
        read, after = (none, none) if folding is None else (folding.past, folding.after)
        layers.append(LayerCall(worn.record, lifts, before, swung, read, after, vertices[rows]))
        calls.append((swung, folding))
    shown = vertices[: outfit.shown_count]
    call = FrameCall(layers, at.body, at.pose, at.colliders, shown, steps, outfit.step_count)
    if not call_with_scratch("frame", _FLOAT, Record("FrameCall", call, _FLOAT), results):
        return None
    after_all, reports = list[Past](), list[FoldReport | None]()
    for (swung, folding), own in zip(calls, results, strict=True):
        turn, _, report = read_outcome(own[:OUTCOME])
        after_all.append(Past(swung, folding and folding.remembered(turn)))
        reports.append(folding and report)
    novelty, ticks, low, step = read_results(results[None])
    return FrameResult(tuple(after_all), tuple(reports), novelty[0], low[0], step[0], ticks[0])


def read_results(results: np.ndarray) -> tuple[list[float], list[list[int]], np.ndarray, np.ndarray]:
    """Reads the ``results`` (F, L, TOLD) int64 that the engine writes for the L garments of F frames. Returns by frame
    the novelty of the pose; the ticks of the processor's clock that each of ``PARTS`` took; the low corner [m] (F, 3)
    of the coordinates; and the size [m] (F, 3) of their steps."""
    first = results[:, 0]
    boxes = first[:, _BOX:-1].copy().view(_FLOAT)
    novelty, ticks = first.view(np.float64)[:, OUTCOME], first[:, OUTCOME + 1 : _BOX]
    return novelty.tolist(), ticks.tolist(), boxes[:, :3], boxes[:, 3:]
