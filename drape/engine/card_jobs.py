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

FRAME_SCRATCH_BYTES = 32 << 20  # each group of threads has its own
TASK = 5  # words of a task: addresses of the row, the outcome and scratch, the size of scratch, frames of the chain
TOLD = 17  # words of the outcome of a frame's layer; the last one is what the engine's function returns


class FrameTemplate:
    """What the rows of many frames have in common. A row is the 64-bit words by which a card is asked for one frame: a
    ``FrameCall``, records that it points to, and numbers of that frame.

    An address in the template counts from the start of what it points into, the row or a piece of the card's memory;
    ``fill`` adds where these lie. ``call`` is the ``FrameCall``. The records that it points to lie in the row, but for
    those that are ``placed`` on the card. ``pieces`` are uint8 arrays of this machine; each stands for a piece of the
    card's memory that every frame has for itself. ``numbers`` (n,) uint64 end the row, and every frame has its own.
    ``starts`` are the indices of the words at which the call, its layers, each part and the numbers begin in the row.
    """

    def __init__(
        self, call: Record, numbers: np.ndarray, pieces: Sequence[np.ndarray], placed: Sequence[CardRecord]
    ) -> None:
        there = {record.flat.record.address for record in placed}
        inner = (array for array in call.arrays if array.dtype == np.uint64 and array is not numbers)
        parts = [call.words, *inner, *(part.words for part in call.parts if part.address not in there), numbers]
        begins = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
        self.starts = [begin // 8 for begin in begins[:-1]]
        self.words = np.concatenate(parts)
        ranges = [(address_of(part), part.nbytes, 0, begin) for part, begin in zip(parts, begins, strict=False)]
        ranges += [(address_of(own), own.nbytes, number, 0) for number, own in enumerate(pieces, 1) if own.size]
        ranges += [
            (record.flat.record.address, record.flat.words.nbytes, number, 0)
            for number, record in enumerate(placed, 1 + len(pieces))
        ]
        place, piece, offset = Ranges(ranges).places(self.words[: self.starts[-1]])
        self.words[place] = offset
        for number, record in enumerate(placed, 1 + len(pieces)):
            self.words[place[piece == number]] += np.uint64(record.address)
        self._places = [place[piece == number] for number in range(1 + len(pieces))]

    @property
    def size(self) -> int:
        """Returns the number of 64-bit words in the row of a frame."""
        return len(self.words)

    def fill(self, rows: np.ndarray, at: np.ndarray) -> None:
        """Writes the rows of n frames into ``rows`` (n, size) uint64. ``at`` (n, 1 + pieces) uint64 are the addresses
        on the card of each frame's row and of its pieces."""
        rows[:] = self.words
        for number, place in enumerate(self._places):
            rows[:, place] += at[:, number, None]


class Group(NamedTuple):
    """n frames of a launch whose rows have one ``template``.

    ``place`` (n,) is the index of each frame in the launch. Each frame has p + w of the template's ``pieces``.
    ``pieces`` (n, p) are the addresses of the first p on the card. The launch writes the last w: ``written`` (n, w) is
    where they begin, as offsets [bytes] that ``FrameLaunch.reserve`` returned, and ``back`` (w,) bool says which of
    them come back to this machine. ``numbers`` (n, k) uint64 are put into the ``columns`` (k,) of each frame's row.
    """

    template: FrameTemplate
    place: np.ndarray
    pieces: np.ndarray
    written: np.ndarray
    back: np.ndarray
    columns: np.ndarray
    numbers: np.ndarray


class FrameLaunch:
    """The frames that a card computes in one launch of its kernel, ``len()`` of them. Their rows (``FrameTemplate``) go
    to the card in one copy, and the results come back in one."""

    def __init__(self, pool: Pool) -> None:
        self._pool, self._groups, self._chains, self._layers = pool, list[Group](), list[int](), list[int]()
        self._row_words = self._back_bytes = self._aside_bytes = 0

    def __len__(self) -> int:
        return len(self._chains)

    def reserve(self, size: int, *, back: bool = True) -> int:
        """Reserves ``size`` bytes for results and returns their offset [bytes]: among those that come ``back`` to this
        machine, or else among those that stay on the card."""
        begin = self._back_bytes if back else self._aside_bytes
        if back:
            self._back_bytes += piece_bytes(size)
        else:
            self._aside_bytes += piece_bytes(size)
        return begin

    def chains(self, lengths: Sequence[int], layers: int) -> tuple[int, int]:
        """Adds a chain of frames for each of ``lengths``, all with ``layers`` layers. Within a chain each frame goes on
        from the one before. Returns the index of the first added frame, and the row of its first layer in ``outcomes``.
        """
        begin = len(self), sum(self._layers)
        for length in lengths:
            self._chains += [length, *[0] * (length - 1)]
        self._layers += [layers] * sum(lengths)
        return begin

    def add(self, group: Group) -> None:
        """Adds the rows of the frames of ``group``."""
        self._groups.append(group)
        self._row_words += len(group.place) * group.template.size

    @property
    def row_bytes(self) -> int:
        """Returns the number of bytes that go to the card: the task and the row of each frame."""
        return 8 * (TASK * len(self) + self._row_words)

    @property
    def out_bytes(self) -> int:
        """Returns the number of bytes that the launch writes: the outcomes of all layers, then the results that come
        back, then those that stay on the card."""
        return self._told_bytes + self._back_bytes + self._aside_bytes

    def draw(self, at: int, out: int, scratch: int, groups: int, threads: int) -> None:
        """Copies tasks and rows to the card's address ``at``, and begins a launch that writes from ``out`` on.

        At most ``groups`` groups of ``threads`` threads compute the frames. The scratch of all groups begins at
        ``scratch``, ``FRAME_SCRATCH_BYTES`` for each.
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

    def outcomes(self, out: int) -> tuple[np.ndarray, np.ndarray]:
        """Waits for the end of the launch, which wrote from the card's address ``out`` on. Returns the outcomes (L,
        ``TOLD``) int64 of the L layers of all frames, the words of ``FrameOutcome`` in ``source/frame_steps.hpp``; and
        the results (n,) uint8 that come back, in which the offsets of ``reserve`` count."""
        written = np.empty(self._told_bytes + self._back_bytes, np.uint8)
        self._pool.card.read(out, written)
        outcomes = written[: 8 * TOLD * sum(self._layers)].view(np.int64).reshape(-1, TOLD)
        return outcomes, written[self._told_bytes :]

    @property
    def _told_bytes(self) -> int:
        return piece_bytes(8 * TOLD * sum(self._layers))
