"""Frames from their poses on, as a card is asked for them: a row of words a frame, and one copy in and out a launch.

A row is a ``FrameCall`` with the records that it points to, which lie behind it, and the numbers of the frame. It is
copied from a ``FrameTemplate``, whose addresses are relative to the pieces in which they lie, so that the rows of a
launch are made by a few sums over all of them. This file needs NumPy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drape.engine.card_frames import CardRecord, Pool, Ranges, piece_bytes
from drape.engine.packer import Record, address_of

FRAME_SCRATCH_BYTES = 32 << 20  # of a group of threads
TASK = 4  # words of a task: the row, where the frame tells, scratch and its size
TOLD = 17  # numbers of 64 bits that a frame tells, the last of which is what the engine's function returns


class FrameTemplate:
    """The row of a frame before it has a place and numbers.

    ``call`` is a ``FrameCall``, whose parts lie in the row but for those that are ``placed`` on the card. ``pieces`` are
    arrays uint8 of this machine that stand for memory which each frame has for itself. ``numbers`` (n,) uint64 are the
    frame's own, at the end of the row.
    """

    def __init__(
        self, call: Record, numbers: np.ndarray, pieces: Sequence[np.ndarray], placed: Sequence[CardRecord]
    ) -> None:
        there = {one.flat.record.address for one in placed}
        parts = [call.words, *(one.words for one in call.parts if one.address not in there), numbers]
        begins = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
        self.starts = [begin // 8 for begin in begins[:-1]]  # of the call, of each part, and of the numbers
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


class _Group(NamedTuple):
    """Frames of one ``template``: where each tells (n,) and where its last pieces are (n, w), both in what comes back,
    the addresses of the pieces before these (n, p), and its ``numbers`` (n, k), of the ``columns`` (k,) of its row."""

    template: FrameTemplate
    told: np.ndarray
    written: np.ndarray
    pieces: np.ndarray
    columns: np.ndarray
    numbers: np.ndarray


class FrameLaunch:
    """The frames of a launch: their rows go to the card by one copy, and what they tell comes back by one."""

    def __init__(self, pool: Pool) -> None:
        self._pool, self._groups = pool, list[_Group]()
        self._row_words = self.out_bytes = self.count = 0

    def reserve(self, size: int) -> int:
        """Reserves ``size`` bytes of what comes back, and returns where they begin there."""
        begin = self.out_bytes
        self.out_bytes += piece_bytes(size)
        return begin

    def add(self, *group: Any) -> None:
        """Adds frames, by the fields of ``_Group``."""
        made = _Group(*group)
        self._groups.append(made)
        self.count += len(made.told)
        self._row_words += len(made.told) * made.template.size

    @property
    def row_bytes(self) -> int:
        """The bytes that go to the card: a task of each frame, and its row."""
        return 8 * (TASK * self.count + self._row_words)

    def draw(self, at: int, out: int, scratch: int, groups: int, threads: int) -> None:
        """Writes the rows to the address ``at`` and begins the launch, which fills what comes back at ``out``.

        ``groups`` of ``threads`` draw the frames, each with ``FRAME_SCRATCH_BYTES`` from ``scratch`` on.
        """
        words = np.empty(TASK * self.count + self._row_words, np.uint64)
        tasks, place, first = words[: TASK * self.count].reshape(-1, TASK), TASK * self.count, 0
        for template, told, written, pieces, columns, numbers in self._groups:
            count = len(told)
            rows = words[place : place + count * template.size].reshape(count, -1)
            begin = at + 8 * (place + template.size * np.arange(count))
            template.fill(rows, np.concatenate([begin[:, None], pieces, written + out], axis=1).astype(np.uint64))
            rows[:, columns] = numbers
            tasks[first : first + count, 0], tasks[first : first + count, 1] = begin, told + out
            place, first = place + rows.size, first + count
        tasks[:, 2], tasks[:, 3] = scratch, FRAME_SCRATCH_BYTES
        self._pool.card.write(at, words)
        self._pool.card.frames(at, self.count, min(groups, self.count), threads)

    def told(self, out: int) -> np.ndarray:
        """Returns what came back (``out_bytes``,) uint8 of the launch that wrote at ``out``."""
        found = np.empty(self.out_bytes, np.uint8)
        self._pool.card.read(out, found)
        return found
