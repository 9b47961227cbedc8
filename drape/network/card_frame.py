"""Frames from their poses on, by a card: what ``drape.network.frame`` computes on a processor.

The frames of a stream or clip go on from each other in one launch. What they leave stays on the card
(``drape.network.card_memory``).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drape.body.feed import BodyFeed
from drape.engine.card_jobs import TOLD, FrameLaunch, FrameTemplate, Group
from drape.engine.packer import Record
from drape.live.card_lane import Lane, Slot
from drape.live.card_lanes import Lanes
from drape.live.clock import step_between
from drape.live.fold_step import OUTCOME, no_arrays, read_outcome
from drape.live.swing_step import SwingMemory
from drape.live.two_level import OneLevel, TwoLevel
from drape.network.card_memory import SWING, CardMemory, Layout, name_of, to_card, to_processor
from drape.network.frame import (
    FrameCall,
    FrameGarment,
    FrameOutfit,
    FrameResult,
    LayerCall,
    Moment,
    Past,
    draw,
    frame_parts,
    read_results,
)

_FLOAT, _WORD = np.dtype(np.float32), np.dtype(np.uint64)
_POSE, _OWN = 72, 7  # how many numbers a pose has, and a garment: two origins and a time
_CLOCK = 14  # the word of FoldMemory that is its turn, before its step, and of SwingMemory that is its time
KEPT = 256  # the most templates of an outfit: bodies of other shapes have their own
_Before = tuple[CardMemory | None, CardMemory | None]  # what a garment goes on from: memories of swing and of folds


class _Kind(NamedTuple):
    """What a garment's rows differ by: whether folds and swing have pasts, and colliders then."""

    follows: bool
    swings_on: bool
    colliders: int


class CardGarment:
    """A garment's constants on the card of ``lane``. The engine's function ``name`` makes its folds; empty: it has
    none."""

    def __init__(self, lane: Lane, worn: FrameGarment, name: str) -> None:
        folds, shared = worn.folds, (worn.weights, worn.patches, worn.tiles, worn.kept, worn.swing)
        beside, cloth, fine = [lane.place_constants(part) for part in shared if part is not None], None, 0
        if folds is not None:
            cloth = lane.place_cloth(folds.constants if isinstance(folds, OneLevel) else folds.levels)
            beside.append(cloth)
        if isinstance(folds, TwoLevel):
            fine = len(folds.levels.fine.sheet.vertex)
        self.parts = lane.place(worn, frame_parts(worn, cloth and cloth.flat.record), *beside)
        coarse = None if folds is None else folds.constants if isinstance(folds, OneLevel) else folds.levels.coarse
        nodes = 0 if worn.swing is None else len(worn.swing.mesh.vertex)
        self.layout = Layout(name, nodes, 0 if coarse is None else len(coarse.sheet.vertex), fine)

    def call(
        self, kind: _Kind, pieces: np.ndarray, own: np.ndarray, solid: np.ndarray, vertices: np.ndarray
    ) -> LayerCall:
        """Returns the engine's record of the garment in a frame of this ``kind``, from which a template is made.

        ``pieces`` (3, n) uint8 stand for the memories of folds before the frame, of swing before it, and of both after
        it. ``own`` (7 + 16 M',) are the garment's numbers: the origins [m] (3,) of this frame and of the one before,
        ``still_since_s`` for a frame without a past, and the M' colliders of the frame before. ``solid`` are the
        colliders of this frame. The vertices are written to ``vertices`` [m] (V, 3).
        """
        (before, swung_before, after), layout, swung, swung_then = pieces, self.layout, None, None
        if layout.nodes:
            swung = SwingMemory(0.0, origin=own[:3], colliders=solid, **layout.views(after, SWING))
            found = layout.views(swung_before, SWING)
            if not kind.swings_on:
                found = {field: array[:0] for field, array in found.items()} | {"still_since_s": own[6:7]}
            swung_then = SwingMemory(-math.inf, origin=own[3:6], colliders=own[_OWN:], **found)
        past = _folded(layout, before) if kind.follows else Record("FoldMemory", no_arrays(_FLOAT), _FLOAT)
        lifts = layout.name == "lift_alone"
        return LayerCall(self.parts.flat.record, lifts, swung_then, swung, past, _folded(layout, after), vertices)


def _folded(layout: Layout, piece: np.ndarray) -> Record:
    """The record of what folds keep in a ``piece``."""
    found = layout.views(piece, layout.name) if layout.name else {}
    return Record("FoldMemory", no_arrays(_FLOAT)._replace(**found), _FLOAT)


class CardOutfit:
    """An outfit's constants on the card of ``lane``. The engine's functions ``names`` make the folds of its
    garments."""

    def __init__(self, lane: Lane, outfit: FrameOutfit, names: Sequence[str]) -> None:
        self._outfit, self._place = outfit, lane.place_constants
        self.garments = [
            lane.cached(worn, name, lambda worn=worn, name=name: CardGarment(lane, worn, name))
            for worn, name in zip(outfit.garments, names, strict=True)
        ]
        self.vertices, self.steps = outfit.vertex_count, outfit.shown_count if outfit.step_count else 0
        self._templates = lru_cache(KEPT)(self._template)

    def template(self, kinds: tuple[_Kind, ...], colliders: int, feed: BodyFeed) -> tuple[FrameTemplate, np.ndarray]:
        """Returns the template of frames on the body of ``feed`` with so many ``colliders`` and garments of these
        ``kinds``: the words that a launch reads for one frame. Also returns the columns (n,) of the words that differ
        from frame to frame."""
        return self._templates(kinds, colliders, self._place(feed))

    def _template(self, kinds: tuple[_Kind, ...], colliders: int, body: Any) -> tuple[FrameTemplate, np.ndarray]:
        lengths = [_POSE, 16 * colliders, *(_OWN + 16 * kind.colliders for kind in kinds)]
        numbers = np.zeros(sum(lengths))
        pose, solid, *owns = np.split(numbers, np.cumsum(lengths)[:-1])
        steps, vertices = np.zeros(6 * self.steps + 16, np.uint8), np.zeros(12 * self.vertices + 16, np.uint8)
        places, pieces = vertices.view(_FLOAT)[: 3 * self.vertices].reshape(-1, 3), list[np.ndarray]()
        layers = []
        for garment, kind, own, rows in zip(self.garments, kinds, owns, self._outfit.rows, strict=True):
            memories = np.zeros((3, garment.layout.size), np.uint8)
            layers.append(garment.call(kind, memories, own, solid, places[rows]))
            pieces.extend(memories)
        shown, written = places[: self._outfit.shown_count], steps.view(np.uint16)[: 3 * self.steps]
        call = FrameCall(layers, body.flat.record, pose, solid, shown, written, self._outfit.step_count)
        placed = [*(garment.parts for garment in self.garments), body]
        template = FrameTemplate(
            Record("FrameCall", call, _FLOAT), numbers.view(_WORD), [*pieces, steps, vertices], placed
        )
        _, _, *starts, own = template.starts
        clocks = list[int]()
        for garment in self.garments:
            swings, folds_then = starts[: 2 if garment.layout.nodes else 0], starts[2 if garment.layout.nodes else 0]
            clocks += [folds_then + _CLOCK, folds_then + _CLOCK + 1, *(start + _CLOCK for start in swings)]
            del starts[: len(swings) + 2]
        return template, np.array([*clocks, *range(own, template.size)])


class FrameJob:
    """F frames of one outfit that a lane is asked for: those of the first stream at its ``moments``, then those of the
    next. The first frame of a stream goes on from its ``pasts``, one for each garment.

    ``drawn`` are the F results of ``frame.draw`` once the card has computed them. False: not computed, since the frame
    or one before it needs more scratch than the card has. Of two arrays one is filled. It is ``steps`` (F, V', 3)
    uint16, the coordinates of the V' vertices that are seen, as ``FrameOutfit`` says; ``vertices`` are then NaN. For an
    outfit without steps it is ``vertices`` [m] (F, V, 3).
    """

    def __init__(
        self, outfit: FrameOutfit, pasts: Sequence[Sequence[Past]], moments: Sequence[Sequence[Moment]]
    ) -> None:
        self._outfit, self._pasts, self._lengths = outfit, pasts, [len(own) for own in moments]
        self._at = [at for own in moments for at in own]
        self._names = fold_functions(outfit, pasts[0])
        self.done, self.since_s = threading.Event(), 0.0
        self.drawn: list[FrameResult | bool | None] = [False] * len(self._at)
        self.vertices, self.steps = no_frames(outfit, len(self._at))

    def __len__(self) -> int:
        return len(self._at)

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``. Raises ``MemoryError`` where the card has no room for the memories that they
        leave."""
        constants = lane.cached(
            self._outfit, " ".join(self._names), lambda: CardOutfit(lane, self._outfit, self._names)
        )
        self._layouts = [garment.layout for garment in constants.garments]
        self._slots = [[Slot(lane, layout.size) for layout in self._layouts] for _ in self._at]
        self._steps_at = launch.reserve(6 * constants.steps * len(self))
        self._vertices_at = launch.reserve(12 * constants.vertices * len(self) + 16, back=not constants.steps)
        first, self._first = launch.chains(self._lengths, len(self._names))
        before, kinds = list(self._before(lane)), dict[Any, list[int]]()
        self._kept = [[[memory and memory.kept for memory in pair] for pair in known] for known in before]
        for i, (at, known) in enumerate(zip(self._at, before, strict=True)):
            kind = tuple(_kind_of(pair, at) for pair in known), at.colliders.size // 16, at.body
            kinds.setdefault(kind, []).append(i)
        addresses = np.array([_addresses(*pair) for pair in zip(before, self._slots, strict=True)])
        back, sizes = np.array([True, not constants.steps]), np.array([6 * constants.steps, 12 * constants.vertices])
        for (kind, colliders, feed), frames in kinds.items():
            template, columns = constants.template(kind, colliders, feed)
            row = np.array(frames)
            written = np.array([self._steps_at, self._vertices_at]) + sizes * row[:, None]
            numbers = self._numbers(kind, [before[i] for i in frames], [self._at[i] for i in frames])
            launch.add(Group(template, first + row, addresses[row], written, back, columns, numbers))

    def read(self, results: np.ndarray, back: np.ndarray) -> None:
        """Fills ``drawn`` and the arrays from a launch that has ended. ``results`` (L, TOLD) int64 has a row for each
        garment of each frame of the launch (``frame.read_results``); ``back`` (n,) uint8 are all bytes that it copied
        from the card."""
        own = results[self._first :][: len(self) * len(self._names)].reshape(len(self), -1, TOLD)
        if self.steps.size:
            self.steps = back[self._steps_at :][: self.steps.nbytes].view(np.uint16).reshape(self.steps.shape)
        else:
            self.vertices = back[self._vertices_at :][: self.vertices.nbytes].view(_FLOAT).reshape(self.vertices.shape)
        (novelty, ticks, low, step), returned = read_results(own), own[:, 0, -1].tolist()
        ends = set(np.cumsum(self._lengths).tolist())
        for i, at in enumerate(self._at):
            if returned[i] != 1:
                self.drawn[i] = None if returned[i] == 0 else False
                continue
            turns, _, reports = zip(*(read_outcome(outcome) for outcome in own[i, :, :OUTCOME]), strict=True)
            left = self._left(i, at, turns, self._kept[i])
            if i + 1 in ends:
                left = ([memory and memory.with_copy() for memory in pair] for pair in left)
            pasts: Any = tuple(Past(*pair) for pair in left)  # pyright: ignore[reportArgumentType]
            reports = tuple(report if name else None for report, name in zip(reports, self._names, strict=True))
            self.drawn[i] = FrameResult(pasts, reports, novelty[i], low[i], step[i], ticks[i])

    def _left(self, i: int, at: Moment, turns: Sequence[int], kept: Sequence[Any]) -> Iterator[_Before]:
        """The memories that frame ``i``, ``at`` a moment, leaves of each garment, of which folds have these ``turns``,
        and pairs are ``kept``."""
        for slot, layout, turn, (swung, folded) in zip(self._slots[i], self._layouts, turns, kept, strict=True):
            swings = (slot, layout, SWING, at.time_s, 0, at.origin, at.colliders, swung)
            folds = (slot, layout, layout.name, at.time_s, turn, None, None, folded)
            yield CardMemory(*swings) if layout.nodes else None, CardMemory(*folds) if layout.name else None

    def _before(self, lane: Lane) -> Iterator[list[_Before]]:
        """What each frame goes on from, of each garment."""
        i, none = 0, [0] * len(self._names)
        for pasts, length in zip(self._pasts, self._lengths, strict=True):
            both = zip(self._layouts, pasts, strict=True)
            first = [(to_card(lane, layout, past.swung), to_card(lane, layout, past.folded)) for layout, past in both]
            kept = [[memory and memory.kept for memory in pair] for pair in first]
            yield first
            for number in range(i, i + length - 1):
                yield list(self._left(number, self._at[number], none, kept))  # the card sets their turns
            i += length

    def _numbers(self, kinds: Sequence[_Kind], before: Sequence[Sequence[_Before]], at: Sequence[Moment]) -> np.ndarray:
        """The numbers (F, n) uint64 of the rows of frames ``at`` moments that go on from those ``before``."""
        clocks, owns = list[np.ndarray](), list[np.ndarray]()
        for number, (kind, layout) in enumerate(zip(kinds, self._layouts, strict=True)):
            clock, own = np.zeros((len(at), 4 if layout.nodes else 2)), np.zeros((len(at), _OWN + 16 * kind.colliders))
            for row, mine, known, now in zip(clock, own, before, at, strict=True):
                swung, folded = known[number]
                row[1] = step_between(folded.time_s, now.time_s) if kind.follows and folded else math.inf
                if layout.nodes:
                    row[2:] = swung.time_s if swung else -math.inf, now.time_s
                mine[:3] = now.origin
                if swung and swung.colliders is not None:
                    mine[3:6], mine[_OWN:] = swung.origin, swung.colliders.reshape(-1)
            if kind.follows:
                clock.view(np.int64)[:, 0] = [known[number][1].turn for known in before]  # pyright: ignore
            clocks.append(clock)
            owns.append(own)
        poses = np.array([now.pose for now in at]).reshape(len(at), _POSE)
        solid = np.array([now.colliders for now in at]).reshape(len(at), -1)
        return np.concatenate([*clocks, poses, solid, *owns], axis=1).view(_WORD)


def _kind_of(before: _Before, at: Moment) -> _Kind:
    swung, folded = before
    then = 0 if swung is None or swung.colliders is None else swung.colliders.size // 16
    return _Kind(folded is not None and folded.leads_to(at.time_s), swung is not None, then)


def _addresses(before: Sequence[_Before], after: Sequence[Slot]) -> list[int]:
    """Where the memories of a frame's garments are: of folds and swing before it, and of both after it."""
    pairs = zip(before, after, strict=True)
    return [at for (swung, folded), slot in pairs for at in (_address(folded), _address(swung), slot.address)]


def _address(memory: CardMemory | None) -> int:
    return memory.slot.address if memory else 0


def no_frames(outfit: FrameOutfit, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices (F, V, 3) of ``count`` frames, a view of a single NaN, and unwritten steps (F, V', 3)
    uint16; V' is 0 for an outfit without steps."""
    vertices = np.broadcast_to(_FLOAT.type(np.nan), (count, outfit.vertex_count, 3))
    return vertices, np.empty((count, outfit.shown_count if outfit.step_count else 0, 3), np.uint16)


def fold_functions(outfit: FrameOutfit, pasts: Sequence[Past]) -> tuple[str, ...]:
    """Returns for each garment the name of the engine's function that makes its folds in the frame after ``pasts``;
    empty for a garment without folds."""
    return tuple(_fold_function(worn, past, outfit) for worn, past in zip(outfit.garments, pasts, strict=True))


def _fold_function(worn: FrameGarment, past: Past, outfit: FrameOutfit) -> str:
    if worn.folds is None:
        return ""
    if isinstance(worn.folds, OneLevel):
        return "fold"
    return "fold_two_levels" if outfit.effort.steps or name_of(past.folded) == "fold_two_levels" else "lift_alone"


def draw_by_card(
    lanes: Lanes, outfit: FrameOutfit, pasts: Sequence[Sequence[Past]], moments: Sequence[Sequence[Moment]]
) -> tuple[list[FrameResult | None], np.ndarray, np.ndarray]:
    """Returns F frames, those of one stream after the other, as ``frame.draw`` does, their vertices [m] (F, V, 3) and
    their steps (F, V', 3); of the two arrays one is filled, as in ``FrameJob``.

    ``pasts`` and ``moments`` are by stream. The processor computes what no card does. For memories of a card that is
    gone it takes their copies (``CardMemory.kept``).
    """
    groups: dict[tuple[tuple[str, ...], Lane], list[int]] = {}
    for k, own in enumerate(pasts):
        memories = [memory for past in own for memory in past]
        groups.setdefault((fold_functions(outfit, own), lanes.of(memories)), []).append(k)
    jobs = [FrameJob(outfit, [pasts[k] for k in own], [moments[k] for k in own]) for own in groups.values()]
    lanes.draw([(lane, job) for (_, lane), job in zip(groups, jobs, strict=True)])
    if len(jobs) == 1 and False not in jobs[0].drawn:
        return jobs[0].drawn, jobs[0].vertices, jobs[0].steps  # pyright: ignore[reportReturnType]
    begins = np.cumsum([0, *map(len, moments)]).tolist()
    vertices, steps = (np.array(rows) for rows in no_frames(outfit, begins[-1]))
    frames: list[FrameResult | None] = [None] * begins[-1]
    for job, own in zip(jobs, groups.values(), strict=True):
        i = 0
        for k in own:
            before = pasts[k]
            for number, at in enumerate(moments[k]):
                row, result = begins[k] + number, job.drawn[i]
                if isinstance(result, bool):
                    here = [Past(*map(to_processor, past)) for past in before]
                    result = draw(outfit, here, at, vertices[row], steps[row])
                else:
                    vertices[row], steps[row] = job.vertices[i], job.steps[i]
                frames[row], before, i = result, result.pasts if result else before, i + 1
    return frames, vertices, steps
