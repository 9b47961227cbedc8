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
from drape.live.fold_step import OUTCOME, FoldEffort, FoldReport, no_past, read_outcome, recorded
from drape.live.swing_step import NO_PAST, SwingConstants, SwingMemory, empty_memory
from drape.live.two_level import Memory, OneLevel, TwoLevel
from drape.network.bodies import BodyFeed
from drape.network.novelty import KeptPoses
from drape.network.patch_rows import PatchRows
from drape.network.weights import Weights

PARTS = ("novelty", "network", "swing", "folds", "encode")
MOST_LAYERS = 8  # garments that the engine draws in one call
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
    laid: LaidCloth | None
    effort: Record
    novel_effort: Record
    passes: int
    share: float
    read: bool


@dataclass(frozen=True, eq=False)
class FrameGarment:
    """The constants that drape a garment.

    They are the network's ``weights`` with the number of its ``passes``, the garment's ``patches`` and ``tiles``, its
    ``swing`` by a ``share``, and its ``folds`` by ``efforts``, of which the second is for novel poses; ``kept`` are the
    poses that the network was trained on. A part that is None does not exist. The garment has ``vertex_count``
    vertices. ``felt``: it and those worn with it feel each other. ``read``: somebody looks at its vertices, so that
    they lie below what is worn over it.
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
        """The record that the engine reads of it."""
        folds = self.folds
        return frame_parts(self, folds.constants if isinstance(folds, OneLevel) else folds.levels if folds else None)


@dataclass(frozen=True, eq=False)
class FrameOutfit:
    """The ``garments`` that a stream wears, the innermost first, and whether each is ``seen``. The coordinates of those
    that are get steps from 0 to ``step_count``; 0: they get none.

    The vertices of all are one array: first those of the garments that are seen, and behind them those of others.
    """

    garments: tuple[FrameGarment, ...]
    seen: tuple[bool, ...]
    step_count: int

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """The rows of each garment among all vertices."""
        begin, found = 0, dict[int, slice]()
        for i in sorted(range(len(self.seen)), key=lambda i: not self.seen[i]):
            found[i] = slice(begin, begin + self.garments[i].vertex_count)
            begin = found[i].stop
        return tuple(found[i] for i in range(len(self.seen)))

    @cached_property
    def vertex_count(self) -> int:
        """The vertices of all garments."""
        return max(rows.stop for rows in self.rows)

    @cached_property
    def shown_count(self) -> int:
        """The vertices of the garments that are seen."""
        return max((rows.stop for rows, seen in zip(self.rows, self.seen, strict=True) if seen), default=0)

    @property
    def effort(self) -> FoldEffort:
        """The effort of a frame whose pose is like training, the same for all garments."""
        return self.garments[0].efforts[0]

    @property
    def folds(self) -> bool:
        """Whether the garments have folds."""
        return self.garments[0].folds is not None


def identity(constants: FrameGarment | FrameOutfit) -> tuple[Any, ...]:
    """Returns what two such constants have in common that draw the same."""
    given = (getattr(constants, field.name) for field in fields(constants))
    return tuple(each if isinstance(each, int | float | tuple) else id(each) for each in given)


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
        worn.folds.laid if worn.folds is not None and worn.felt else None,
        effort,
        novel_effort,
        worn.passes,
        worn.share,
        worn.read,
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
    """A frame that the engine has computed: of each garment the memories ``pasts`` that it leaves and the ``reports``
    of its folds; the ``novelty`` of its pose (0 where no poses are kept), and the ``low`` corner and the ``step`` size
    (3,) of its coordinates.

    ``ticks``: the processor's ticks that each of ``PARTS`` took.
    """

    pasts: tuple[Past, ...]
    reports: tuple[FoldReport | None, ...]
    novelty: float
    low: np.ndarray
    step: np.ndarray
    ticks: list[int]


class LayerCall(NamedTuple):
    """The record that the engine reads of a garment in a frame, with the addresses at which it writes."""

    parts: Record
    lifts: bool
    swung_before: SwingMemory | None
    swung: SwingMemory | None
    folded_before: Record
    folded: Record
    vertices: np.ndarray


class FrameCall(NamedTuple):
    """The record that the engine reads of a frame. It writes ``steps`` of the vertices ``shown``."""

    layers: Sequence[LayerCall]
    body: BodyFeed
    turns: np.ndarray
    colliders: np.ndarray
    shown: np.ndarray
    steps: np.ndarray
    step_count: int


def draw(
    outfit: FrameOutfit, pasts: Sequence[Past], at: Moment, vertices: np.ndarray, steps: np.ndarray = _NO_STEPS
) -> Drawn | None:
    """Computes the frame ``at`` a moment and returns it; None if the network's numbers are not finite.

    ``vertices`` [m] (V, 3) of all garments are written, and ``steps`` (V', 3) of those that are seen, if given. The
    ``pasts`` of the garments are not written to. No garment may be one that ``begins`` to fold after the lift alone.
    """
    told, made = np.zeros((len(pasts), TOLD), np.int64), list[tuple[SwingMemory | None, Any]]()
    layers = []
    for worn, past, rows in zip(outfit.garments, pasts, outfit.rows, strict=True):
        swung = before = folding = None
        if worn.swing is not None:
            swung, before = empty_memory(worn.swing, at.time_s, at.origin, at.colliders), past.swung or NO_PAST
        if worn.folds is not None:
            folding = worn.folds.call(past.folded, at.time_s, outfit.effort)
        none, lifts = no_past(_FLOAT), folding is not None and folding.name == "lift_alone"
        read, left = (none, none) if folding is None else (folding.past, folding.after)
        layers.append(LayerCall(worn.record, lifts, before, swung, read, left, vertices[rows]))
        made.append((swung, folding))
    shown = vertices[: outfit.shown_count]
    call = FrameCall(layers, at.body, at.pose, at.colliders, shown, steps, outfit.step_count)
    if not call_with_scratch("frame", _FLOAT, Record("FrameCall", call, _FLOAT), told):
        return None
    left, reports = list[Past](), list[FoldReport | None]()
    for (swung, folding), own in zip(made, told, strict=True):
        turn, _, report = read_outcome(own[:OUTCOME])
        left.append(Past(swung, folding and folding.remembered(turn)))
        reports.append(folding and report)
    novelty, ticks, low, step = read_told(told[None])
    return Drawn(tuple(left), tuple(reports), novelty[0], low[0], step[0], ticks[0])


def read_told(told: np.ndarray) -> tuple[list[float], list[list[int]], np.ndarray, np.ndarray]:
    """Reads what F frames of L garments tell, ``told`` (F, L, TOLD) int64.

    Returns by frame: the novelty of its pose; how long each of ``PARTS`` took, in ticks of the processor's clock; the
    low corner [m] (F, 3) of its coordinates, and their steps [m] (F, 3).
    """
    first = told[:, 0]
    boxes = first[:, _BOX:-1].copy().view(_FLOAT)
    novelty, ticks = first.view(np.float64)[:, OUTCOME], first[:, OUTCOME + 1 : _BOX]
    return novelty.tolist(), ticks.tolist(), boxes[:, :3], boxes[:, 3:]
