"""Frames of one garment from their poses on, by a card: what ``drape.network.frame`` computes on a processor.

The frames of a stream or clip go on from each other in one launch. What they leave stays on the card
(``drape.network.card_memory``).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drape.body.feed import BodyFeed
from drape.engine.card_jobs import FrameLaunch, FrameTemplate, Group
from drape.engine.packer import Record
from drape.live.card_lane import Lane, Slot
from drape.live.card_lanes import Lanes
from drape.live.clock import step_between
from drape.live.fold_step import no_arrays, no_past, read_outcome
from drape.live.swing_step import SwingMemory
from drape.live.two_level import OneLevel, TwoLevel
from drape.network.card_memory import SWING, CardMemory, Layout, fetched, name_of, on_card
from drape.network.frame import OUTCOME, Drawn, FrameCall, FrameGarment, Moment, Past, draw, frame_parts

_FLOAT, _WORD = np.dtype(np.float32), np.dtype(np.uint64)
_POSE, _OWN = 72, 72 + 7  # numbers of a pose, and with two origins and a time
_CLOCK = 14  # words of FoldMemory before its turn and step, and of SwingMemory before its time
KEPT = 256  # templates of a garment, most of them for bodies of other shapes
_NOWHERE = np.zeros(3), np.zeros(0)


class _Kind(NamedTuple):
    """What the rows of frames differ by: whether folds and swing have pasts, and colliders then and now."""

    follows: bool
    swings_on: bool
    colliders_before: int
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
        self.memory_bytes = self.layout.size
        self.vertices, self.steps = worn.vertex_count, worn.vertex_count if worn.step_count else 0
        self._placed, self._made = lane.placed, lru_cache(KEPT)(self._template)

    def template(self, kind: _Kind, feed: BodyFeed) -> tuple[FrameTemplate, np.ndarray]:
        """Returns the row of a frame of this ``kind`` on the body of ``feed``, and the columns of its numbers."""
        return self._made(kind, self._placed(feed))

    def _template(self, kind: _Kind, body: Any) -> tuple[FrameTemplate, np.ndarray]:
        layout, numbers = self.layout, np.zeros(_OWN + 16 * (kind.colliders_before + kind.colliders))
        before, swung_before, after = np.zeros((3, layout.size), np.uint8)
        steps, vertices = np.zeros(6 * self.steps + 16, np.uint8), np.zeros(12 * self.vertices + 16, np.uint8)
        solid_before, solid = np.split(numbers[_OWN:], [16 * kind.colliders_before])
        swung = swung_then = None
        if layout.nodes:
            swung = SwingMemory(0.0, origin=numbers[_POSE:][:3], colliders=solid, **layout.views(after, SWING))
            found = layout.views(swung_before, SWING)
            if not kind.swings_on:
                found = {field: one[:0] for field, one in found.items()} | {"still_since_s": numbers[_OWN - 1 : _OWN]}
            swung_then = SwingMemory(-math.inf, origin=numbers[_POSE + 3 :][:3], colliders=solid_before, **found)
        call = FrameCall(
            self.parts.flat.record,
            body.flat.record,
            layout.name == "lift_alone",
            numbers[:_POSE],
            solid,
            swung_then,
            swung,
            _folded(layout, before) if kind.follows else no_past(_FLOAT),
            _folded(layout, after),
            vertices.view(_FLOAT)[: 3 * self.vertices],
            steps.view(np.uint16)[: 3 * self.steps],
        )
        pieces = before, swung_before, after, steps, vertices
        made = FrameTemplate(Record("FrameCall", call, _FLOAT), numbers.view(_WORD), pieces, [self.parts, body])
        *swings, folds_then, _, own = made.starts[1:]
        clocks = [folds_then + _CLOCK, folds_then + _CLOCK + 1, *(start + _CLOCK for start in swings)]
        return made, np.array([*clocks, *range(own, made.size)])


def _folded(layout: Layout, piece: np.ndarray) -> Record:
    """The record of what folds keep in a ``piece``."""
    found = layout.views(piece, layout.name) if layout.name else {}
    return Record("FoldMemory", no_arrays(_FLOAT)._replace(**found), _FLOAT)


class FrameJob:
    """Frames of one garment that a lane is asked for: those at the ``moments`` of each stream, one after the other, of
    which the first goes on from the stream's past.

    ``drawn`` are the frames once the card has drawn them, as ``frame.draw`` returns them; False for what needs more
    scratch than the card has, and for what goes on from that. ``vertices`` [m] (F, V, 3) come back where there are no
    ``steps`` (F, V, 3), and are no numbers else.
    """

    def __init__(self, worn: FrameGarment, pasts: Sequence[Past], moments: Sequence[Sequence[Moment]]) -> None:
        self._worn, self._pasts, self._lengths = worn, pasts, [len(own) for own in moments]
        self._at = [at for own in moments for at in own]
        self._name = _made_by(worn, pasts[0])
        self.done, self.since_s = threading.Event(), 0.0
        self.drawn: list[Drawn | bool | None] = [False] * len(self._at)
        self.vertices, self.steps = no_frames(worn, len(self._at))

    def __len__(self) -> int:
        return len(self._at)

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``. Raises ``MemoryError`` where the card has no room for what they leave."""
        made = lane.kept(self._worn, self._name, lambda: CardGarment(lane, self._worn, self._name))
        count, self._layout = len(self), made.layout
        self._slots = [Slot(lane, made.memory_bytes) for _ in self._at]
        self._steps_at = launch.reserve(6 * made.steps * count)
        self._vertices_at = launch.reserve(12 * made.vertices * count + 16, back=not made.steps)
        self._first = launch.chains(self._lengths)
        before = self._before(lane)
        kinds: dict[Any, list[int]] = {}
        for i, (at, (swung, folded)) in enumerate(zip(self._at, before, strict=True)):
            follows = folded is not None and folded.leads_to(at.time_s)
            then = 0 if swung is None or swung.colliders is None else swung.colliders.size // 16
            kind = _Kind(follows, swung is not None, then, at.colliders.size // 16)
            kinds.setdefault((kind, at.body), []).append(i)
        addresses = np.array(
            [
                (*(one.slot.address if one else 0 for one in (folded, swung)), slot.address)
                for (swung, folded), slot in zip(before, self._slots, strict=True)
            ]
        )
        for (kind, feed), frames in kinds.items():
            template, columns = made.template(kind, feed)
            row = np.array(frames)
            sizes = np.array([6 * made.steps, 12 * made.vertices])
            written = np.array([self._steps_at, self._vertices_at]) + sizes * row[:, None]
            numbers = self._numbers(kind, [before[i] for i in frames], [self._at[i] for i in frames])
            back = np.array([True, not made.steps])
            launch.add(Group(template, self._first + row, addresses[row], written, back, columns, numbers))

    def read(self, told: np.ndarray, back: np.ndarray) -> None:
        """Takes the frames from what those of the launch have ``told`` (F, TOLD), and from what came ``back``."""
        count = len(self)
        own = told[self._first : self._first + count]
        if self.steps.size:
            self.steps = back[self._steps_at :][: self.steps.nbytes].view(np.uint16).reshape(self.steps.shape)
        else:
            self.vertices = back[self._vertices_at :][: self.vertices.nbytes].view(_FLOAT).reshape(self.vertices.shape)
        reals, boxes = own.view(np.float64)[:, OUTCOME].tolist(), own[:, -4:-1].copy().view(_FLOAT)
        ticks, returned = own[:, OUTCOME + 1 : -4].tolist(), own[:, -1].tolist()
        for i, at in enumerate(self._at):
            if returned[i] != 1:
                self.drawn[i] = None if returned[i] == 0 else False
                continue
            swung = folded = report = None
            if self._name:
                turn, _, report = read_outcome(own[i, :OUTCOME])
                folded = CardMemory(self._slots[i], self._layout, self._name, at.time_s, turn)
            if self._worn.swing is not None:
                swung = CardMemory(self._slots[i], self._layout, SWING, at.time_s, 0, at.origin, at.colliders)
            past: Any = Past(swung, folded)  # pyright: ignore[reportArgumentType]
            self.drawn[i] = Drawn(past, report, reals[i], boxes[i, :3], boxes[i, 3:], ticks[i])

    def _before(self, lane: Lane) -> list[tuple[CardMemory | None, CardMemory | None]]:
        """What each frame goes on from: memories of swing and of folds."""
        found, i = [], 0
        for past, length in zip(self._pasts, self._lengths, strict=True):
            found.append(tuple(on_card(lane, self._layout, one) for one in past))
            for at, slot in zip(self._at[i : i + length - 1], self._slots[i:], strict=False):
                swung = CardMemory(slot, self._layout, SWING, at.time_s, 0, at.origin, at.colliders)
                folded = CardMemory(slot, self._layout, self._name, at.time_s)
                found.append((swung if self._layout.nodes else None, folded if self._name else None))
            i += length
        return found

    def _numbers(self, kind: _Kind, before: Sequence[Any], at: Sequence[Moment]) -> np.ndarray:
        """The numbers (F, n) uint64 of the rows of frames ``at`` moments that go on from those ``before``."""
        swings = bool(self._layout.nodes)
        clocks = np.zeros((len(at), 4 if swings else 2))
        origins, solids = [], []
        for clock, (swung, folded), now in zip(clocks, before, at, strict=True):
            clock[1] = step_between(folded.time_s, now.time_s) if kind.follows else math.inf
            if swings:
                clock[2:] = swung.time_s if swung else -math.inf, now.time_s
            origin, solid = (swung.origin, swung.colliders.reshape(-1)) if swung else _NOWHERE
            origins.append((now.origin, origin))
            solids.append(np.concatenate([solid, now.colliders.reshape(-1)]))
        if kind.follows:
            clocks.view(np.int64)[:, 0] = [folded.turn for _, folded in before]
        poses = np.array([now.pose for now in at]).reshape(len(at), _POSE)
        own = np.array(origins).reshape(len(at), 6), np.zeros((len(at), 1)), np.array(solids).reshape(len(at), -1)
        return np.concatenate([clocks, poses, *own], axis=1).view(_WORD)


def no_frames(worn: FrameGarment, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices (F, V, 3), which are no numbers and take no memory, and room for steps (F, V, 3)."""
    vertices = np.broadcast_to(_FLOAT.type(np.nan), (count, worn.vertex_count, 3))
    return vertices, np.empty((count, worn.vertex_count if worn.step_count else 0, 3), np.uint16)


def _made_by(worn: FrameGarment, past: Past) -> str:
    """The function that makes the folds of a frame."""
    if worn.folds is None:
        return ""
    if isinstance(worn.folds, OneLevel):
        return "fold"
    return "fold_two_levels" if worn.effort.steps or name_of(past.folded) == "fold_two_levels" else "lift_alone"


def draw_by_card(
    lanes: Lanes, worn: FrameGarment, pasts: Sequence[Past], moments: Sequence[Sequence[Moment]]
) -> tuple[list[Drawn | None], np.ndarray, np.ndarray]:
    """Computes frames of streams, each stream's one after the other, as ``frame.draw`` does. Returns them, and the
    vertices and steps that ``FrameJob`` has.

    Those that the card does not draw are the processor's; what a card has that is gone, they do without.
    """
    groups: dict[tuple[str, Lane], list[int]] = {}
    for k, past in enumerate(pasts):
        groups.setdefault((_made_by(worn, past), lanes.of(past)), []).append(k)
    jobs = [FrameJob(worn, [pasts[k] for k in own], [moments[k] for k in own]) for own in groups.values()]
    lanes.draw([(lane, job) for (_, lane), job in zip(groups, jobs, strict=True)])
    if len(jobs) == 1 and False not in jobs[0].drawn:
        return jobs[0].drawn, jobs[0].vertices, jobs[0].steps  # pyright: ignore[reportReturnType]
    begins = np.cumsum([0, *map(len, moments)]).tolist()
    vertices, steps = (np.array(one) for one in no_frames(worn, begins[-1]))
    frames: list[Drawn | None] = [None] * begins[-1]
    for job, own in zip(jobs, groups.values(), strict=True):
        i = 0
        for k in own:
            past = pasts[k]
            for number, at in enumerate(moments[k]):
                row, made = begins[k] + number, job.drawn[i]
                if isinstance(made, bool):
                    made = draw(worn, Past(*map(fetched, past)), at, vertices[row], steps[row])
                else:
                    vertices[row], steps[row] = job.vertices[i], job.steps[i]
                frames[row], past, i = made, made.past if made else past, i + 1
    return frames, vertices, steps
