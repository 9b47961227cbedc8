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

KEPT_S = 0.2  # less than PAUSE_S, after which a memory is forgotten
SWING = "swing"  # the name of memories of swing; those of folds are called by the function that made them
_POINTS = {SWING: ("network", "swung", "speed"), "lift_alone": ("network", "residual")}
_FOLDED = ("network", "residual", "velocity", "grip")


class Layout(NamedTuple):
    """Where the memories that a frame leaves lie in a piece of a card's memory: those of swing, of ``nodes`` nodes,
    then those of the folds that the engine's function ``name`` makes, of ``places`` places and, of a fine cloth,
    ``fine`` ones."""

    name: str
    nodes: int
    places: int
    fine: int

    def fields(self, name: str) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Returns the shape and dtype of each array of a memory, by its field of the engine's record. ``name`` is
        ``SWING`` for the memory of swing, else that of folds."""
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
        """The size of the piece in bytes."""
        return sum(_bytes(*field) for name in self._names for field in self.fields(name).values())

    def views(self, piece: np.ndarray, name: str) -> dict[str, np.ndarray]:
        """Returns views of the arrays of the memory ``name`` in a ``piece`` (size,) uint8, by field (``fields``)."""
        arrays, at = dict[str, np.ndarray](), 0
        for own in self._names[: self._names.index(name) + 1]:
            for field, (shape, dtype) in self.fields(own).items():
                end = at + math.prod(shape) * np.dtype(dtype).itemsize
                if own == name:
                    arrays[field] = piece[at:end].view(dtype).reshape(shape)
                at += _bytes(shape, dtype)
        return arrays

    @property
    def _names(self) -> list[str]:
        return [*([SWING] if self.nodes else []), *([self.name] if self.name else [])]


def _bytes(shape: tuple[int, ...], dtype: Any) -> int:
    """The bytes of an array, with room for a number behind it, which is read with a point."""
    return -(-(math.prod(shape) * np.dtype(dtype).itemsize + 4) // 16) * 16


@dataclass(frozen=True, eq=False)
class CardMemory:
    """The memory that a frame at ``time_s`` [s] left in a ``slot`` of a card: of swing, or of the folds that the
    engine's function ``name`` makes. ``layout`` says where its arrays are.

    Folds have a ``turn``; swing has the ``origin`` [m] (3,) of its coordinates in the world, and the ``colliders`` (M,
    16) as seen from there. ``kept`` is a copy for the processor, of this frame's memory or of one up to ``KEPT_S``
    before it; so a card that fails takes no more than these frames along.
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
        """Returns the same memory, of a frame at ``time_s`` [s]."""
        return replace(self, time_s=time_s)

    def leads_to(self, time_s: float) -> bool:
        """Whether a frame at ``time_s`` [s] may go on from this one: it is not before it and at most ``PAUSE_S`` after
        it."""
        return 0.0 <= time_s - self.time_s <= PAUSE_S

    def with_copy(self) -> CardMemory:
        """Returns this memory, with a new copy ``kept`` if the copy is ``KEPT_S`` old or there is none."""
        if self.kept is not None and 0.0 <= self.time_s - _time_of(self.kept) < KEPT_S:
            return self
        return replace(self, kept=self.on_processor)

    @cached_property
    def on_processor(self) -> Memory | SwingMemory | None:
        """The memory, copied from the card, for the processor; if the card is gone ``kept``, which may be None."""
        piece = self.slot.read()
        if piece is None:
            return self.kept
        arrays = self.layout.views(piece, self.name)
        if self.name == SWING:
            assert self.origin is not None and self.colliders is not None
            return SwingMemory(self.time_s, origin=self.origin, colliders=self.colliders, **arrays)
        if self.name == "lift_alone":
            return LiftMemory(self.time_s, arrays["network"], arrays["own"], arrays["residual"])
        touched = TouchedSamples(arrays["own"], arrays["other"])
        memory = FoldMemory(
            self.time_s, arrays["network"], arrays["residual"], arrays["velocity"], touched, arrays["grip"], self.turn
        )
        return TwoLevelMemory(memory, arrays["fine"]) if self.name == "fold_two_levels" else memory


def _time_of(memory: Any) -> float:
    return memory.coarse.time_s if isinstance(memory, TwoLevelMemory) else memory.time_s


def to_processor(memory: Any) -> Any:
    """Returns ``memory`` for the processor: one on a card is copied from it (``CardMemory.on_processor``), any other,
    also None, is returned itself."""
    return memory.on_processor if isinstance(memory, CardMemory) else memory


def name_of(memory: Any) -> str:
    """Returns the name of the engine's function that made the folds of a ``memory``, ``SWING`` for a memory of swing,
    and an empty name for None."""
    if isinstance(memory, CardMemory):
        return memory.name
    names = {TwoLevelMemory: "fold_two_levels", FoldMemory: "fold", LiftMemory: "lift_alone", SwingMemory: SWING}
    return names.get(type(memory), "")


def to_card(lane: Lane, layout: Layout, memory: Any) -> CardMemory | None:
    """Returns ``memory`` on the card of ``lane``, copied there if need be. None: there is no memory, or a frame of this
    ``layout`` cannot go on from it."""
    name = name_of(memory)
    if name not in (SWING, layout.name):
        return None
    if isinstance(memory, CardMemory):
        if memory.slot.lane is lane:
            return memory
        memory = memory.on_processor
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
