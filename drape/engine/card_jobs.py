"""Frames from their poses on, as a card is asked for them: a row of words a frame, and one copy in and out a launch.

A row is a ``FrameCall`` with the records that it points to, which lie behind it, and the numbers of the frame. It is
copied from a ``FrameTemplate``, whose addresses are relative to the pieces in which they lie, so that the rows of a
launch are made by a few sums over all of them. This file needs NumPy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drape.engine.card_frames import CardRecord, Pool, Ranges, piece_bytes
from drape.engine.packer import Record, address_of

FRAME_SCRATCH_BYTES = 32 << 20  # of a group of threads
TASK = 5  # words of a task: the row, where the frame tells, scratch and its size, and the frames of its chain
TOLD = 17  # numbers of 64 bits that a frame tells of a garment, the last of which is what the engine's function returns


class FrameTemplate:
    """The row of a frame before it has a place and numbers.

    ``call`` is a ``FrameCall``; its parts lie in the row but for those that are ``placed`` on the card. ``pieces`` are
    arrays uint8 of this machine that stand for memory which each frame has for itself. ``numbers`` (n,) uint64 are the
    frame's own, at the end of the row.
    """

    def __init__(
        self, call: Record, numbers: np.ndarray, pieces: Sequence[np.ndarray], placed: Sequence[CardRecord]
    ) -> None:
        there = {one.flat.record.address for one in placed}
        inner = (one for one in call.arrays if one.dtype == np.uint64 and one is not numbers)
        parts = [call.words, *inner, *(one.words for one in call.parts if one.address not in there), numbers]
        begins = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
        self.starts = [begin // 8 for begin in begins[:-1]]  # of the call, its layers, each part, and the numbers
        self.words = np.concatenate(parts)
        kept = [(address_of(part), part.nbytes, 0, begin) for part, begin in zip(parts, begins, strict=False)]
        kept += [(address_of(one), one.nbytes, number, 0) for number, one in enumerate(pieces, 1) if one.size]
        kept += [
            (one.flat.record.address, one.flat.words.nbytes, len(pieces) + number, 0)
            for number, one in enumerate(placed, 1)
        ]
        place, piece, offset = Ranges(kept).places(self.words[: self.starts[-1]])
        self.words[place] = offset
        for number, one in enumerate(placed, 1):
            self.words[place[piece == len(pieces) + number]] += np.uint64(one.address)
        self._places = [place[piece == number] for number in range(1 + len(pieces))]

    @property
    def size(self) -> int:
        """The words of a row."""
        return len(self.words)

    def fill(self, rows: np.ndarray, at: np.ndarray) -> None:
        """Fills ``rows`` (n, size) uint64 for frames whose rows and pieces are ``at`` addresses (n, 1 + pieces)."""
        rows[:] = self.words
        for number, place in enumerate(self._places):
            rows[:, place] += at[:, number, None]


class Group(NamedTuple):
    """Frames of one ``template``: the ``place`` (n,) of each among those of the launch, the addresses of its pieces but
    the last ones (n, p), where it writes these (n, w) in what comes ``back`` or, (w,), else aside, and its ``numbers``
    (n, k), of the ``columns`` (k,) of its row."""

    template: FrameTemplate
    place: np.ndarray
    pieces: np.ndarray
    written: np.ndarray
    back: np.ndarray
    columns: np.ndarray
    numbers: np.ndarray


class FrameLaunch:
    """The frames of a launch: their rows go to the card by one copy, and what they tell comes back by one."""

    def __init__(self, pool: Pool) -> None:
        self._pool, self._groups, self._chains, self._layers = pool, list[Group](), list[int](), list[int]()
        self._row_words = self._back_bytes = self._aside_bytes = 0

    def __len__(self) -> int:
        return len(self._chains)

    def reserve(self, size: int, *, back: bool = True) -> int:
        """Reserves ``size`` bytes of what comes back, or aside from it, and returns where they begin there."""
        begin = self._back_bytes if back else self._aside_bytes
        if back:
            self._back_bytes += piece_bytes(size)
        else:
            self._aside_bytes += piece_bytes(size)
        return begin

    def chains(self, lengths: Sequence[int], layers: int) -> tuple[int, int]:
        """Adds frames of so many ``layers`` in chains of these ``lengths``, of which each goes on from the one before.
        Returns the place of the first one among frames, and among the layers of all."""
        begin = len(self), sum(self._layers)
        for length in lengths:
            self._chains += [length, *[0] * (length - 1)]
        self._layers += [layers] * sum(lengths)
        return begin

    def add(self, group: Group) -> None:
        """Adds the rows of such frames."""
        self._groups.append(group)
        self._row_words += len(group.place) * group.template.size

    @property
    def row_bytes(self) -> int:
        """The bytes that go to the card: a task of each frame, and its row."""
        return 8 * (TASK * len(self) + self._row_words)

    @property
    def out_bytes(self) -> int:
        """The bytes that frames write: what they tell, what comes back, and what does not."""
        return self._told_bytes + self._back_bytes + self._aside_bytes

    def draw(self, at: int, out: int, scratch: int, groups: int, threads: int) -> None:
        """Writes the rows to the address ``at`` and begins the launch, which writes at ``out``.

        ``groups`` of ``threads`` draw the frames, each with ``FRAME_SCRATCH_BYTES`` from ``scratch`` on.
        """
        words = np.empty(self.row_bytes // 8, np.uint64)
        tasks, first = words[: TASK * len(self)].reshape(-1, TASK), TASK * len(self)
        back = out + self._told_bytes
        for template, place, pieces, written, comes_back, columns, numbers in self._groups:
            rows = words[first : first + len(place) * template.size].reshape(len(place), -1)
            begin = at + 8 * (first + template.size * np.arange(len(place)))
            ends = written + np.where(comes_back, back, back + self._back_bytes)
            template.fill(rows, np.concatenate([begin[:, None], pieces, ends], axis=1).astype(np.uint64))
            rows[:, columns] = numbers
            tasks[place, 0], first = begin, first + rows.size
        tasks[:, 1] = out + 8 * TOLD * (np.cumsum(self._layers) - self._layers)
        tasks[:, 2], tasks[:, 3], tasks[:, 4] = scratch, FRAME_SCRATCH_BYTES, self._chains
        self._pool.card.write(at, words)
        self._pool.card.frames(at, len(self), min(groups, len(self)), threads)

    def told(self, out: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns what the layers of the launch that wrote at ``out`` tell (L, TOLD) int64, and the uint8 that came
        back."""
        found = np.empty(self._told_bytes + self._back_bytes, np.uint8)
        self._pool.card.read(out, found)
        told = found[: 8 * TOLD * sum(self._layers)].view(np.int64).reshape(-1, TOLD)
        return told, found[self._told_bytes :]

    @property
    def _told_bytes(self) -> int:
        return piece_bytes(8 * TOLD * sum(self._layers))
