"""What frames that a card has drawn leave there to the next ones, and how a processor has it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drape.live.card_lane import Lane, Slot
from drape.live.clock import PAUSE_S
from drape.live.eased import LiftMemory
from drape.live.fold_step import FoldMemory
from drape.live.skin_walks import TouchedSamples
from drape.live.swing_step import SwingMemory
from drape.live.two_level import Memory, TwoLevelMemory

KEPT_S = 0.2  # below the pause at which a memory is forgotten
SWING = "swing"  # the name of its memories, where those of folds have that of the function which made them
_POINTS = {SWING: ("network", "swung", "speed"), "lift_alone": ("network", "residual")}
_FOLDED = ("network", "residual", "velocity", "grip")


class Layout(NamedTuple):
    """Where the arrays of a frame's memories lie in a piece: of swing, on so many ``nodes``, and behind it those of
    folds by ``name``, on so many ``places`` and, of a fine cloth, ``fine`` ones."""

    name: str
    nodes: int
    places: int
    fine: int

    def fields(self, name: str) -> dict[str, tuple[tuple[int, ...], Any]]:
        """The arrays of the memory ``name``, by the fields of the engine's record: their shapes and types."""
        if name == SWING:
            count = self.nodes
            rest = {
                "climb": ((count,), np.float32),
                "touched": ((count,), np.int32),
                "still_since_s": ((1,), np.float64),
            }
        else:
            count = self.places
            rest = {"own": ((count,), np.int32)}
            if name != "lift_alone":
                rest |= {"other": ((count,), np.int32), "fine": ((self.fine, 3), np.float32)}
        return {field: ((count, 3), np.float32) for field in _POINTS.get(name, _FOLDED)} | rest

    @property
    def size(self) -> int:
        """The bytes of the piece."""
        return sum(_bytes(*field) for name in self._names for field in self.fields(name).values())

    def views(self, piece: np.ndarray, name: str) -> dict[str, np.ndarray]:
        """The arrays of the memory ``name`` in a ``piece`` (size,) uint8."""
        found, at = dict[str, np.ndarray](), 0
        for own in self._names[: self._names.index(name) + 1]:
            for field, (shape, dtype) in self.fields(own).items():
                end = at + math.prod(shape) * np.dtype(dtype).itemsize
                if own == name:
                    found[field] = piece[at:end].view(dtype).reshape(shape)
                at += _bytes(shape, dtype)
        return found

    @property
    def _names(self) -> list[str]:
        return [*([SWING] if self.nodes else []), *([self.name] if self.name else [])]


def _bytes(shape: tuple[int, ...], dtype: Any) -> int:
    """The bytes of an array, with room for a number behind it, which is read with a point."""
    return -(-(math.prod(shape) * np.dtype(dtype).itemsize + 4) // 16) * 16


@dataclass(frozen=True, eq=False)
class CardMemory:
    """The memory ``name`` of a frame at ``time_s`` [s], in a ``slot`` of a card by its ``layout``.

    Folds have a ``turn``; swing has the ``origin`` [m] (3,) of its coordinates, and the ``colliders`` (M, 16) from
    there. ``kept`` is the stream's memory of this frame, or of one up to ``KEPT_S`` before it, as a processor has it: a
    card that fails takes no more than frames along.
    """

    slot: Slot
    layout: Layout
    name: str
    time_s: float
    turn: int = 0
    origin: np.ndarray | None = None
    colliders: np.ndarray | None = None
    kept: Any = None

    def at(self, time_s: float) -> CardMemory:
        """Returns the same memory at another time [s]."""
        return replace(self, time_s=time_s)

    def leads_to(self, time_s: float) -> bool:
        """Whether a frame at ``time_s`` [s] may go on from this one, if it is no cut."""
        return 0.0 <= time_s - self.time_s <= PAUSE_S

    def keeping(self) -> CardMemory:
        """Returns the same memory with itself ``kept`` where what is kept is too old."""
        if self.kept is not None and 0.0 <= self.time_s - _time_of(self.kept) < KEPT_S:
            return self
        return replace(self, kept=self.fetched)

    @cached_property
    def fetched(self) -> Memory | SwingMemory | None:
        """The memory as a processor has it; what is ``kept`` if the card is gone."""
        piece = self.slot.read()
        if piece is None:
            return self.kept
        found = self.layout.views(piece, self.name)
        if self.name == SWING:
            assert self.origin is not None and self.colliders is not None
            return SwingMemory(self.time_s, origin=self.origin, colliders=self.colliders, **found)
        if self.name == "lift_alone":
            return LiftMemory(self.time_s, found["network"], found["own"], found["residual"])
        touched = TouchedSamples(found["own"], found["other"])
        memory = FoldMemory(
            self.time_s, found["network"], found["residual"], found["velocity"], touched, found["grip"], self.turn
        )
        return TwoLevelMemory(memory, found["fine"]) if self.name == "fold_two_levels" else memory


def _time_of(memory: Any) -> float:
    return memory.coarse.time_s if isinstance(memory, TwoLevelMemory) else memory.time_s


def fetched(memory: Any) -> Any:
    """Returns ``memory`` as a processor has it, from a card if it is there."""
    return memory.fetched if isinstance(memory, CardMemory) else memory


def name_of(memory: Any) -> str:
    """Returns the name of what made a ``memory``; empty where there is none."""
    if isinstance(memory, CardMemory):
        return memory.name
    names = {TwoLevelMemory: "fold_two_levels", FoldMemory: "fold", LiftMemory: "lift_alone", SwingMemory: SWING}
    return names.get(type(memory), "")


def on_card(lane: Lane, layout: Layout, memory: Any) -> CardMemory | None:
    """Returns a ``memory`` on the card of ``lane``, to which it goes if it is not there; None where a frame of this
    ``layout`` cannot go on from it."""
    name = name_of(memory)
    if name not in (SWING, layout.name):
        return None
    if isinstance(memory, CardMemory):
        if memory.slot.lane is lane:
            return memory
        memory = memory.fetched
    if memory is None:
        return None
    coarse = memory.coarse if isinstance(memory, TwoLevelMemory) else memory
    values = vars(memory) | vars(coarse)
    if isinstance(coarse, FoldMemory):
        values |= coarse.touched._asdict()
    if isinstance(memory, LiftMemory):
        values["residual"] = memory.eased
    piece = np.zeros(layout.size, np.uint8)
    for field, view in layout.views(piece, name).items():
        view[...] = values.get(field, view)
    slot = Slot(lane, layout.size)
    lane.write(slot.address, piece)
    known = (values.get(field, default) for field, default in (("turn", 0), ("origin", None), ("colliders", None)))
    return CardMemory(slot, layout, name, coarse.time_s, *known, kept=memory)
