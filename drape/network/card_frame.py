"""Frames of one garment from their poses on, by a card: what ``drape.network.frame`` computes on a processor.

What a frame leaves to the next one stays on the card; a ``CardMemory`` says where, and brings it back for whoever
computes on a processor.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from drape.body.feed import BodyFeed
from drape.engine.card_jobs import TOLD, FrameLaunch, FrameTemplate
from drape.engine.packer import Record
from drape.live.card_lane import Lane, Slot
from drape.live.clock import PAUSE_S, step_between
from drape.live.eased import LiftMemory
from drape.live.fold_step import FoldMemory, no_arrays, no_past, read_outcome
from drape.live.skin_walks import TouchedSamples
from drape.live.swing_step import SwingMemory
from drape.live.two_level import Memory, OneLevel, TwoLevel, TwoLevelMemory
from drape.network.frame import OUTCOME, Drawn, FrameCall, FrameGarment, Moment, Past, draw, frame_parts

_FLOAT, _WORD = np.dtype(np.float32), np.dtype(np.uint64)
_TURNS = 72  # numbers of a pose
_FOLD_CLOCK, _SWING_CLOCK = 14, 14  # words of FoldMemory before turn and step, and of SwingMemory before its time
_COARSE = ("network", "residual", "velocity", "grip", "own", "other")
_LIFTED = ("network", "residual", "own")


class Layout:
    """Where the arrays of memories lie in a piece of ``size`` bytes."""

    def __init__(self) -> None:
        self.size, self._fields = 0, dict[str, tuple[int, tuple[int, ...], Any]]()

    def add(self, name: str, shape: tuple[int, ...], dtype: Any = np.float32) -> None:
        """Adds an array; points are read with a number more, so there is room behind each."""
        self._fields[name] = self.size, shape, dtype
        self.size += -(-(math.prod(shape) * np.dtype(dtype).itemsize + 16) // 16) * 16

    def views(self, piece: np.ndarray, part: str) -> dict[str, np.ndarray]:
        """The arrays of the memory ``part`` in a ``piece`` (size,) uint8."""
        return {
            name.removeprefix(part): piece[at : at + math.prod(shape) * np.dtype(dtype).itemsize]
            .view(dtype)
            .reshape(shape)
            for name, (at, shape, dtype) in self._fields.items()
            if name.startswith(part)
        }


@dataclass(frozen=True, eq=False)
class CardMemory:
    """A memory of folds, by the ``name`` of what made it, or of ``swing``, in a ``slot`` of a card."""

    slot: Slot
    layout: Layout
    name: str
    time_s: float
    turn: int = 0
    origin: np.ndarray | None = None
    colliders: np.ndarray | None = None

    def at(self, time_s: float) -> CardMemory:
        """Returns the same memory at another time [s]."""
        return replace(self, time_s=time_s)

    def leads_to(self, time_s: float) -> bool:
        """Whether a frame at ``time_s`` [s] may go on from this one, if it is no cut."""
        return 0.0 <= time_s - self.time_s <= PAUSE_S

    def fetched(self) -> Memory | SwingMemory | None:
        """Returns the memory as it is on a processor; None if the card is gone."""
        piece = self.slot.read()
        if piece is None:
            return None
        if self.name == "swing":
            found = self.layout.views(piece, "swung/")
            assert self.origin is not None and self.colliders is not None
            return SwingMemory(self.time_s, origin=self.origin, colliders=self.colliders, **found)
        found = self.layout.views(piece, "folded/")
        if self.name == "lift_alone":
            return LiftMemory(self.time_s, found["network"], found["own"], found["residual"])
        touched = TouchedSamples(found["own"], found["other"])
        folds = found["network"], found["residual"], found["velocity"], touched, found["grip"], self.turn
        memory = FoldMemory(self.time_s, *folds)
        return TwoLevelMemory(memory, found["fine"]) if self.name == "fold_two_levels" else memory


def fetched(memory: Any) -> Any:
    """Returns ``memory`` as it is on a processor, if it is on a card."""
    return memory.fetched() if isinstance(memory, CardMemory) else memory


def lifts(past: Past) -> bool:
    """Whether ``past`` is that of cloth that a card has lifted alone."""
    return isinstance(past.folded, CardMemory) and past.folded.name == "lift_alone"


def draw_by_card(
    lane: Lane,
    worn: FrameGarment,
    pasts: Sequence[Past],
    at: Sequence[Moment],
    written: tuple[np.ndarray, np.ndarray],
    rows: Sequence[int],
) -> list[Drawn | None]:
    """Computes frames of streams, each as ``frame.draw`` does, into the ``rows`` of the vertices and steps ``written``.
    Those that the card does not draw are the processor's; what a card has that is gone, they do without."""
    job = FrameJob(worn, pasts, at)
    lane.draw(job)
    found: list[Drawn | None] = []
    for k, row in enumerate(rows):
        own = [each[row] for each in written]
        drawn = job.drawn[k] if job.drawn else False
        if isinstance(drawn, bool):
            drawn = draw(worn, Past(*map(fetched, pasts[k])), at[k], *own)
        else:
            own[0][...], own[1][...] = job.vertices[k], job.steps[k]
        found.append(drawn)
    return found


class _Kind(NamedTuple):
    """What the rows of frames differ by: what makes the folds, whether there are pasts, and colliders then and now."""

    name: str
    follows: bool
    swings_on: bool
    colliders_before: int
    colliders: int


class CardGarment:
    """A garment, ``worn``, as the card of ``lane`` draws it."""

    def __init__(self, lane: Lane, worn: FrameGarment) -> None:
        folds = worn.folds
        cloth = folds.constants if isinstance(folds, OneLevel) else folds.levels if folds else None
        self._lane = lane
        shared = [worn.weights, worn.patches, worn.tiles, *(one for one in (worn.kept, worn.swing) if one is not None)]
        beside = [lane.placed(one) for one in shared]
        beside += [] if cloth is None else [lane.cloth(cloth)]
        self._parts = lane.place(worn, frame_parts(worn, beside[-1].flat.record if cloth else None), *beside)
        self._templates = dict[tuple[int, _Kind], tuple[FrameTemplate, np.ndarray]]()
        self._layouts = dict[str, Layout]()
        self.levels = folds.levels if isinstance(folds, TwoLevel) else None
        self._places = 0 if folds is None else len(_coarse(folds).sheet.vertex)
        self._nodes = 0 if worn.swing is None else len(worn.swing.mesh.vertex)
        self._vertices, self._steps = worn.vertex_count, worn.vertex_count if worn.step_count else 0

    def layout(self, name: str) -> Layout:
        """Where the memories of a frame lie whose folds the function ``name`` made."""
        if name not in self._layouts:
            made = self._layouts[name] = Layout()
            if self._nodes:  # first, so that they lie where those of another way of folding do
                for each in ("network", "swung", "speed"):
                    made.add(f"swung/{each}", (self._nodes, 3))
                made.add("swung/climb", (self._nodes,))
                made.add("swung/touched", (self._nodes,), np.int32)
                made.add("swung/still_since_s", (1,), np.float64)
            for each in _LIFTED if name == "lift_alone" else _COARSE if name else ():
                whole = each in ("own", "other")
                made.add(
                    f"folded/{each}", (self._places,) if whole else (self._places, 3), np.int32 if whole else _FLOAT
                )
            if name == "fold_two_levels" and self.levels is not None:
                made.add("folded/fine", (len(self.levels.fine.sheet.vertex), 3))
        return self._layouts[name]

    def written(self, count: int, out: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The steps (F, V, 3) uint16 and vertices [m] (F, V, 3) of so many frames in what they have written."""
        half = 6 * self._steps * count
        vertices = out[-(-half // 16) * 16 :][: 12 * self._vertices * count]
        return out[:half].view(np.uint16).reshape(count, -1, 3), vertices.view(_FLOAT).reshape(count, -1, 3)

    def written_bytes(self, count: int) -> int:
        """The bytes that so many frames write."""
        return -(-6 * self._steps * count // 16) * 16 + 12 * self._vertices * count + 16

    def template(self, kind: _Kind, feed: BodyFeed) -> tuple[FrameTemplate, np.ndarray]:
        """The row of a frame of this ``kind`` on the body of ``feed``, and the columns of its numbers."""
        body = self._lane.placed(feed)
        key = body.address, kind
        if key not in self._templates:
            self._templates[key] = self._made(kind, feed)
        return self._templates[key]

    def _made(self, kind: _Kind, feed: BodyFeed) -> tuple[FrameTemplate, np.ndarray]:
        body = self._lane.placed(feed)
        layout, numbers = self.layout(kind.name), np.zeros(_TURNS + 7 + 16 * (kind.colliders_before + kind.colliders))
        before, after = np.zeros(layout.size, np.uint8), np.zeros(layout.size, np.uint8)
        swung_before = np.zeros(layout.size, np.uint8)
        steps, vertices = (np.zeros(3 * count + 8, dtype) for count, dtype in
                           ((self._steps, np.uint16), (self._vertices, np.float32)))  # fmt: skip
        origin, then = numbers[_TURNS : _TURNS + 3], numbers[_TURNS + 3 : _TURNS + 6]
        solid_then, solid = np.split(numbers[_TURNS + 7 :], [16 * kind.colliders_before])
        swung = swung_then = None
        if self._nodes:
            swung = SwingMemory(0.0, origin=origin, colliders=solid, **layout.views(after, "swung/"))
            found = layout.views(swung_before, "swung/")
            if not kind.swings_on:
                found = {name: one[:0] for name, one in found.items()} | {
                    "still_since_s": numbers[_TURNS + 6 : _TURNS + 7]
                }
            swung_then = SwingMemory(-math.inf, origin=then, colliders=solid_then, **found)
        folded = _fold_record(layout.views(after, "folded/"))
        folded_then = _fold_record(layout.views(before, "folded/")) if kind.follows else no_past(_FLOAT)
        call = FrameCall(
            self._parts.flat.record, feed, kind.name == "lift_alone", numbers[:_TURNS], solid,
            swung_then, swung, folded_then, folded, vertices[: 3 * self._vertices], steps[: 3 * self._steps],
        )  # fmt: skip
        pieces = [each.view(np.uint8) for each in (before, swung_before, after, steps, vertices)]
        made = FrameTemplate(Record("FrameCall", call, _FLOAT), numbers.view(_WORD), pieces, [self._parts, body])
        starts = made.starts[1:]
        swings = [starts[0] + _SWING_CLOCK, starts[1] + _SWING_CLOCK] if self._nodes else []
        clock = starts[-3] + _FOLD_CLOCK
        own = np.arange(starts[-1], made.size)
        return made, np.concatenate([[clock, clock + 1], swings, own]).astype(np.int64)


def _coarse(folds: OneLevel | TwoLevel) -> Any:
    return folds.constants if isinstance(folds, OneLevel) else folds.levels.coarse


def _fold_record(found: dict[str, np.ndarray]) -> Record:
    return Record("FoldMemory", no_arrays(_FLOAT)._replace(**found), _FLOAT)


class FrameJob:
    """Frames of one garment, each of another stream, that a lane is asked for: those at the moments ``at``, which go on
    from ``pasts``. ``drawn`` are the frames once the card has drawn them, each as ``frame.draw`` returns it or False
    where the card had too little scratch, with their ``vertices`` [m] (F, V, 3) and ``steps`` (F, V, 3)."""

    def __init__(self, worn: FrameGarment, pasts: Sequence[Past], at: Sequence[Moment]) -> None:
        self._worn, self._pasts, self._moments = worn, pasts, at
        self.done, self.since_s = threading.Event(), 0.0
        self.drawn: list[Drawn | bool | None] | None = None
        self.vertices = self.steps = np.empty((0, 0, 3), _FLOAT)

    def __len__(self) -> int:
        return len(self._moments)

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``. Raises ``MemoryError`` where the card has no room for what they leave."""
        made = self._garment = lane.kept(self._worn, lambda: CardGarment(lane, self._worn))
        count = len(self)
        self._told, self._out = launch.reserve(8 * TOLD * count), launch.reserve(made.written_bytes(count))
        self._names = [self._name(past) for past in self._pasts]
        self._slots = [Slot(lane, made.layout(name).size) for name in self._names]
        groups: dict[Any, list[int]] = {}
        given = [self._placed(lane, made, i) for i in range(count)]
        for i, (kind, *_) in enumerate(given):
            groups.setdefault((kind, self._moments[i].body), []).append(i)
        vertices = self._out + made.written_bytes(count) - 12 * self._worn.vertex_count * count - 16
        for (kind, feed), frames in groups.items():
            template, columns = made.template(kind, feed)
            row = np.array(frames)
            pieces = np.array([given[i][1:4] for i in frames])
            steps = self._out + 6 * (self._worn.vertex_count if self._worn.step_count else 0) * row
            out = np.stack([steps, vertices + 12 * self._worn.vertex_count * row], axis=1)
            launch.add(template, self._told + 8 * TOLD * row, out, pieces, columns, self._numbers(given, frames))

    def read(self, found: np.ndarray) -> None:
        """Takes the frames from what came back ``found`` of their launch."""
        count = len(self)
        told = found[self._told : self._told + 8 * TOLD * count].view(np.int64).reshape(count, TOLD)
        self.steps, self.vertices = self._garment.written(count, found[self._out :])
        self.drawn = [self._read(i, told[i]) for i in range(count)]

    def _read(self, i: int, told: np.ndarray) -> Drawn | bool | None:
        if told[-1] != 1:
            return None if told[-1] == 0 else False
        at, name, layout = self._moments[i], self._names[i], self._garment.layout(self._names[i])
        swung = folded = report = None
        if name:
            turn, _, report = read_outcome(told[:OUTCOME])
            folded = CardMemory(self._slots[i], layout, name, at.time_s, turn)
        if self._worn.swing is not None:
            swung = CardMemory(self._slots[i], layout, "swing", at.time_s, 0, at.origin, at.colliders)
        box = told[-4:-1].view(_FLOAT)
        novelty = float(told[OUTCOME : OUTCOME + 1].view(np.float64)[0])
        return Drawn(Past(swung, folded), report, novelty, box[:3], box[3:], told[OUTCOME + 1 : -4].tolist())  # pyright: ignore[reportArgumentType]

    def _name(self, past: Past) -> str:
        """The function that makes a frame's folds."""
        if self._worn.folds is None:
            return ""
        if isinstance(self._worn.folds, OneLevel):
            return "fold"
        known = past.folded
        folded = isinstance(known, TwoLevelMemory) or getattr(known, "name", "") == "fold_two_levels"
        return "fold_two_levels" if folded or self._worn.effort.steps else "lift_alone"

    def _placed(self, lane: Lane, made: CardGarment, i: int) -> tuple[Any, ...]:
        """The kind of a frame, the addresses of its pasts and of what it leaves, and the pasts on the card."""
        at, name = self._moments[i], self._names[i]
        swung, folded = (self._on_card(lane, made, one, name) for one in self._pasts[i])
        follows = folded is not None and folded.name == name and folded.leads_to(at.time_s)
        before = 0 if swung is None or swung.colliders is None else len(swung.colliders.reshape(-1)) // 16
        kind = _Kind(name, follows, swung is not None, before, len(at.colliders.reshape(-1)) // 16)
        slots = (one.slot.address if one else 0 for one in (folded, swung))
        return kind, *slots, self._slots[i].address, folded, swung

    def _on_card(self, lane: Lane, made: CardGarment, memory: Any, name: str) -> CardMemory | None:
        """A ``memory`` on the card, to which it goes if it is not there."""
        if memory is None or isinstance(memory, CardMemory):
            return memory
        layout, part, values = made.layout(name), "folded/", dict[str, np.ndarray]()
        own, turn, origin, colliders, time_s = name, 0, None, None, getattr(memory, "time_s", 0.0)
        if isinstance(memory, SwingMemory):
            own, part, origin, colliders = "swing", "swung/", memory.origin, memory.colliders
            values = vars(memory)
        elif isinstance(memory, LiftMemory):
            own, values = "lift_alone", {"network": memory.network, "own": memory.own, "residual": memory.eased}
        else:
            coarse = memory.coarse if isinstance(memory, TwoLevelMemory) else memory
            own = "fold_two_levels" if isinstance(memory, TwoLevelMemory) else "fold"
            values = vars(coarse) | coarse.touched._asdict() | {"fine": getattr(memory, "fine", None)}
            turn, time_s = coarse.turn, coarse.time_s
        if own not in (name, "swing"):
            return None  # that of another way of folding counts as none
        piece = np.zeros(layout.size, np.uint8)
        for field, view in layout.views(piece, part).items():
            view[...] = values[field]
        slot = Slot(lane, layout.size)
        lane.write(slot.address, piece)
        return CardMemory(slot, layout, own, time_s, turn, origin, colliders)

    def _numbers(self, given: Sequence[tuple[Any, ...]], frames: Sequence[int]) -> np.ndarray:
        """The numbers (F, n) uint64 of the rows of these frames."""
        rows = []
        for i in frames:
            (kind, *_, folded, swung), at = given[i], self._moments[i]
            step_s = step_between(folded.time_s, at.time_s) if kind.follows else math.inf
            times = [] if self._worn.swing is None else [swung.time_s if swung else -math.inf, at.time_s]
            then = (np.zeros(3), []) if swung is None else (swung.origin, swung.colliders.reshape(-1))
            turn = np.array([folded.turn if kind.follows else 0]).view(np.float64)
            rows.append(np.concatenate([turn, [step_s], times, at.pose.reshape(-1), at.origin, then[0], [0.0], then[1],
                                        at.colliders.reshape(-1)]))  # fmt: skip
        return np.array(rows).view(_WORD)
