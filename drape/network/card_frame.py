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
from drape.network.card_memory import SWING, CardMemory, Layout, fetched, name_of, on_card
from drape.network.frame import (
    Drawn,
    FrameCall,
    FrameGarment,
    FrameOutfit,
    LayerCall,
    Moment,
    Past,
    draw,
    frame_parts,
    read_told,
)

_FLOAT, _WORD = np.dtype(np.float32), np.dtype(np.uint64)
_POSE, _OWN = 72, 7  # numbers of a pose, and of a garment: two origins and a time
_CLOCK = 14  # words of FoldMemory before its turn and step, and of SwingMemory before its time
KEPT = 256  # templates of an outfit, most of them for bodies of other shapes
_Before = tuple[CardMemory | None, CardMemory | None]  # what a garment goes on from: memories of swing and of folds


class _Kind(NamedTuple):
    """What a garment's rows differ by: whether folds and swing have pasts, and colliders then."""

    follows: bool
    swings_on: bool
    colliders: int


class CardGarment:
    """A garment, ``worn``, whose folds the function ``name`` makes, as the card of ``lane`` draws it."""

    def __init__(self, lane: Lane, worn: FrameGarment, name: str) -> None:
        folds, shared = worn.folds, (worn.weights, worn.patches, worn.tiles, worn.kept, worn.swing)
        beside, cloth, fine = [lane.placed(one) for one in shared if one is not None], None, 0
        if folds is not None:
            cloth = lane.cloth(folds.constants if isinstance(folds, OneLevel) else folds.levels)
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
        """The call of a garment of this ``kind`` whose memories before and after are in ``pieces`` (3, n) uint8, and
        whose numbers are its ``own``."""
        (before, swung_before, after), layout, swung, swung_then = pieces, self.layout, None, None
        if layout.nodes:
            swung = SwingMemory(0.0, origin=own[:3], colliders=solid, **layout.views(after, SWING))
            found = layout.views(swung_before, SWING)
            if not kind.swings_on:
                found = {field: one[:0] for field, one in found.items()} | {"still_since_s": own[6:7]}
            swung_then = SwingMemory(-math.inf, origin=own[3:6], colliders=own[_OWN:], **found)
        past = _folded(layout, before) if kind.follows else Record("FoldMemory", no_arrays(_FLOAT), _FLOAT)
        lifts = layout.name == "lift_alone"
        return LayerCall(self.parts.flat.record, lifts, swung_then, swung, past, _folded(layout, after), vertices)


def _folded(layout: Layout, piece: np.ndarray) -> Record:
    """The record of what folds keep in a ``piece``."""
    found = layout.views(piece, layout.name) if layout.name else {}
    return Record("FoldMemory", no_arrays(_FLOAT)._replace(**found), _FLOAT)


class CardOutfit:
    """An ``outfit``, whose garments' folds the functions ``names`` make, as the card of ``lane`` draws it."""

    def __init__(self, lane: Lane, outfit: FrameOutfit, names: Sequence[str]) -> None:
        self._outfit, self._placed = outfit, lane.placed
        self.garments = [
            lane.kept(worn, name, lambda worn=worn, name=name: CardGarment(lane, worn, name))
            for worn, name in zip(outfit.garments, names, strict=True)
        ]
        self.vertices, self.steps = outfit.vertex_count, outfit.shown_count if outfit.step_count else 0
        self._made = lru_cache(KEPT)(self._template)

    def template(self, kinds: tuple[_Kind, ...], colliders: int, feed: BodyFeed) -> tuple[FrameTemplate, np.ndarray]:
        """Returns the row of a frame of these ``kinds`` among so many ``colliders``, on the body of ``feed``, and the
        columns of its numbers."""
        return self._made(kinds, colliders, self._placed(feed))

    def _template(self, kinds: tuple[_Kind, ...], colliders: int, body: Any) -> tuple[FrameTemplate, np.ndarray]:
        lengths = [_POSE, 16 * colliders, *(_OWN + 16 * kind.colliders for kind in kinds)]
        numbers = np.zeros(sum(lengths))
        pose, solid, *owns = np.split(numbers, np.cumsum(lengths)[:-1])
        steps, vertices = np.zeros(6 * self.steps + 16, np.uint8), np.zeros(12 * self.vertices + 16, np.uint8)
        places, pieces = vertices.view(_FLOAT)[: 3 * self.vertices].reshape(-1, 3), list[np.ndarray]()
        layers = []
        for made, kind, own, rows in zip(self.garments, kinds, owns, self._outfit.rows, strict=True):
            memories = np.zeros((3, made.layout.size), np.uint8)
            layers.append(made.call(kind, memories, own, solid, places[rows]))
            pieces.extend(memories)
        shown, written = places[: self._outfit.shown_count], steps.view(np.uint16)[: 3 * self.steps]
        call = FrameCall(layers, body.flat.record, pose, solid, shown, written, self._outfit.step_count)
        placed = [*(made.parts for made in self.garments), body]
        made = FrameTemplate(Record("FrameCall", call, _FLOAT), numbers.view(_WORD), [*pieces, steps, vertices], placed)
        _, _, *starts, own = made.starts
        clocks = list[int]()
        for garment in self.garments:
            swings, folds_then = starts[: 2 if garment.layout.nodes else 0], starts[2 if garment.layout.nodes else 0]
            clocks += [folds_then + _CLOCK, folds_then + _CLOCK + 1, *(start + _CLOCK for start in swings)]
            del starts[: len(swings) + 2]
        return made, np.array([*clocks, *range(own, made.size)])


class FrameJob:
    """Frames of one outfit that a lane is asked for: those at the ``moments`` of each stream, one after the other, of
    which the first goes on from the stream's ``pasts``, one of each garment.

    ``drawn`` are the frames once the card has drawn them, as ``frame.draw`` returns them; False for what needs more
    scratch than the card has, and for what goes on from that. ``vertices`` [m] (F, V, 3) come back where there are no
    ``steps`` (F, V', 3), and are no numbers else.
    """

    def __init__(
        self, outfit: FrameOutfit, pasts: Sequence[Sequence[Past]], moments: Sequence[Sequence[Moment]]
    ) -> None:
        self._outfit, self._pasts, self._lengths = outfit, pasts, [len(own) for own in moments]
        self._at = [at for own in moments for at in own]
        self._names = made_by(outfit, pasts[0])
        self.done, self.since_s = threading.Event(), 0.0
        self.drawn: list[Drawn | bool | None] = [False] * len(self._at)
        self.vertices, self.steps = no_frames(outfit, len(self._at))

    def __len__(self) -> int:
        return len(self._at)

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``. Raises ``MemoryError`` where the card has no room for what they leave."""
        made = lane.kept(self._outfit, " ".join(self._names), lambda: CardOutfit(lane, self._outfit, self._names))
        self._layouts = [garment.layout for garment in made.garments]
        self._slots = [[Slot(lane, layout.size) for layout in self._layouts] for _ in self._at]
        self._steps_at = launch.reserve(6 * made.steps * len(self))
        self._vertices_at = launch.reserve(12 * made.vertices * len(self) + 16, back=not made.steps)
        first, self._first = launch.chains(self._lengths, len(self._names))
        before, kinds = list(self._before(lane)), dict[Any, list[int]]()
        self._kept = [[[memory and memory.kept for memory in one] for one in known] for known in before]
        for i, (at, known) in enumerate(zip(self._at, before, strict=True)):
            kind = tuple(_kind_of(one, at) for one in known), at.colliders.size // 16, at.body
            kinds.setdefault(kind, []).append(i)
        addresses = np.array([_addresses(*one) for one in zip(before, self._slots, strict=True)])
        back, sizes = np.array([True, not made.steps]), np.array([6 * made.steps, 12 * made.vertices])
        for (kind, colliders, feed), frames in kinds.items():
            template, columns = made.template(kind, colliders, feed)
            row = np.array(frames)
            written = np.array([self._steps_at, self._vertices_at]) + sizes * row[:, None]
            numbers = self._numbers(kind, [before[i] for i in frames], [self._at[i] for i in frames])
            launch.add(Group(template, first + row, addresses[row], written, back, columns, numbers))

    def read(self, told: np.ndarray, back: np.ndarray) -> None:
        """Takes the frames from what the layers of the launch have ``told`` (L, TOLD), and from what came ``back``."""
        own = told[self._first :][: len(self) * len(self._names)].reshape(len(self), -1, TOLD)
        if self.steps.size:
            self.steps = back[self._steps_at :][: self.steps.nbytes].view(np.uint16).reshape(self.steps.shape)
        else:
            self.vertices = back[self._vertices_at :][: self.vertices.nbytes].view(_FLOAT).reshape(self.vertices.shape)
        (novelty, ticks, low, step), returned = read_told(own), own[:, 0, -1].tolist()
        ends = set(np.cumsum(self._lengths).tolist())
        for i, at in enumerate(self._at):
            if returned[i] != 1:
                self.drawn[i] = None if returned[i] == 0 else False
                continue
            turns, _, reports = zip(*(read_outcome(one) for one in own[i, :, :OUTCOME]), strict=True)
            left = self._left(i, at, turns, self._kept[i])
            if i + 1 in ends:
                left = ([memory and memory.keeping() for memory in one] for one in left)
            pasts: Any = tuple(Past(*one) for one in left)  # pyright: ignore[reportArgumentType]
            reports = tuple(report if name else None for report, name in zip(reports, self._names, strict=True))
            self.drawn[i] = Drawn(pasts, reports, novelty[i], low[i], step[i], ticks[i])

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
            first = [(on_card(lane, layout, past.swung), on_card(lane, layout, past.folded)) for layout, past in both]
            kept = [[memory and memory.kept for memory in one] for one in first]
            yield first
            for number in range(i, i + length - 1):
                yield list(self._left(number, self._at[number], none, kept))  # the card sets turns
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
    each = zip(before, after, strict=True)
    return [at for (swung, folded), slot in each for at in (_address(folded), _address(swung), slot.address)]


def _address(memory: CardMemory | None) -> int:
    return memory.slot.address if memory else 0


def no_frames(outfit: FrameOutfit, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices (F, V, 3), which are no numbers and take no memory, and room for steps (F, V', 3)."""
    vertices = np.broadcast_to(_FLOAT.type(np.nan), (count, outfit.vertex_count, 3))
    return vertices, np.empty((count, outfit.shown_count if outfit.step_count else 0, 3), np.uint16)


def made_by(outfit: FrameOutfit, pasts: Sequence[Past]) -> tuple[str, ...]:
    """Returns the names of the functions that make the folds of a frame's garments."""
    return tuple(_made_by(worn, past, outfit) for worn, past in zip(outfit.garments, pasts, strict=True))


def _made_by(worn: FrameGarment, past: Past, outfit: FrameOutfit) -> str:
    if worn.folds is None:
        return ""
    if isinstance(worn.folds, OneLevel):
        return "fold"
    return "fold_two_levels" if outfit.effort.steps or name_of(past.folded) == "fold_two_levels" else "lift_alone"


def draw_by_card(
    lanes: Lanes, outfit: FrameOutfit, pasts: Sequence[Sequence[Past]], moments: Sequence[Sequence[Moment]]
) -> tuple[list[Drawn | None], np.ndarray, np.ndarray]:
    """Computes frames of streams, each stream's one after the other, as ``frame.draw`` does. Returns them, and the
    vertices and steps that ``FrameJob`` has.

    Those that the card does not draw are the processor's; what a card has that is gone, they do without.
    """
    groups: dict[tuple[tuple[str, ...], Lane], list[int]] = {}
    for k, own in enumerate(pasts):
        memories = [memory for past in own for memory in past]
        groups.setdefault((made_by(outfit, own), lanes.of(memories)), []).append(k)
    jobs = [FrameJob(outfit, [pasts[k] for k in own], [moments[k] for k in own]) for own in groups.values()]
    lanes.draw([(lane, job) for (_, lane), job in zip(groups, jobs, strict=True)])
    if len(jobs) == 1 and False not in jobs[0].drawn:
        return jobs[0].drawn, jobs[0].vertices, jobs[0].steps  # pyright: ignore[reportReturnType]
    begins = np.cumsum([0, *map(len, moments)]).tolist()
    vertices, steps = (np.array(one) for one in no_frames(outfit, begins[-1]))
    frames: list[Drawn | None] = [None] * begins[-1]
    for job, own in zip(jobs, groups.values(), strict=True):
        i = 0
        for k in own:
            before = pasts[k]
            for number, at in enumerate(moments[k]):
                row, made = begins[k] + number, job.drawn[i]
                if isinstance(made, bool):
                    here = [Past(*map(fetched, past)) for past in before]
                    made = draw(outfit, here, at, vertices[row], steps[row])
                else:
                    vertices[row], steps[row] = job.vertices[i], job.steps[i]
                frames[row], before, i = made, made.pasts if made else before, i + 1
    return frames, vertices, steps
