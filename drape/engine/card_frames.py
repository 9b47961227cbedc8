"""Records in a card's memory: flat, in one pool.

A record and its arrays lie in one piece, so that it comes and goes by one copy. This file needs NumPy alone.
"""

from __future__ import annotations

import threading
from bisect import bisect
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from drape.engine.packer import Record, Recorded, address_of

ALIGNED = 256  # pieces of memory begin at multiples of it
BEHIND = 16  # bytes behind each array: points are read with a number more


class Memory(Protocol):
    """The memory of a card: the calls that a ``Pool`` makes."""

    def take(self, size: int) -> int:
        """Takes ``size`` bytes and returns their address."""
        ...

    def write(self, address: int, numbers: np.ndarray) -> None:
        """Writes the array ``numbers`` to ``address``."""
        ...

    def read(self, address: int, numbers: np.ndarray) -> None:
        """Fills the array ``numbers`` with what is at ``address``."""
        ...

    def frames(self, tasks: int, count: int, groups: int, threads: int) -> None:
        """Begins a launch of so many ``groups`` of threads, which share the frames of ``tasks``."""
        ...


class Pool:
    """``size`` bytes of a card's memory in one piece, which is handed out and taken back in pieces of its own;
    ``free_bytes`` are not handed out."""

    def __init__(self, card: Memory, size: int) -> None:
        self.card, self.size, self.free_bytes = card, size, size
        self._begin, self._lock = card.take(size), threading.Lock()
        self._free, self._taken = [(0, size)], dict[int, int]()

    def take(self, size: int) -> int:
        """Hands out ``size`` bytes: their address. Raises ``MemoryError`` where no piece is long enough."""
        size = piece_bytes(size)
        with self._lock:
            for place, (begin, length) in enumerate(self._free):
                if length >= size:
                    self._free[place : place + 1] = [(begin + size, length - size)] if length > size else []
                    self._taken[begin] = size
                    self.free_bytes -= size
                    return self._begin + begin
        raise MemoryError(f"a card's memory: expected {size} bytes in one piece, got {self.free_bytes} in all")

    def give(self, address: int) -> None:
        """Takes back what was handed out at ``address``."""
        with self._lock:
            begin = address - self._begin
            size = self._taken.pop(begin)
            self.free_bytes += size
            place = bisect(self._free, (begin, 0))
            if place < len(self._free) and self._free[place][0] == begin + size:
                size += self._free.pop(place)[1]
            if place and sum(self._free[place - 1]) == begin:
                place -= 1
                begin, before = self._free.pop(place)
                size += before
            self._free.insert(place, (begin, size))


class Ranges:
    """Memory of this machine that has other addresses on a card: ``kept`` are an address here, how many bytes from it
    on, the number of the piece in which they lie there, and where in it."""

    def __init__(self, kept: Iterable[tuple[int, int, int, int]]) -> None:
        self.begin, self.size, self.piece, self.offset = np.array(sorted(kept), np.uint64).reshape(-1, 4).T

    def places(self, words: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of ``words`` are addresses within, and the piece and the offset of each."""
        # An array may be a row of another one, so a word is an address within the last that begins before it.
        before = np.searchsorted(self.begin, words, side="right") - 1
        place = np.flatnonzero(before >= 0)
        before = before[place]
        inside = words[place] - self.begin[before]
        own = inside < self.size[before]
        return place[own], self.piece[before[own]], (self.offset[before] + inside)[own]


class Flat:
    """A ``record``, with the records that it points to, laid out in one piece of memory of ``size`` bytes: its words
    first, and then its arrays. What ``beside`` holds, which lies on the card already, is not in it."""

    def __init__(self, record: Record | Recorded, beside: Sequence[CardRecord] = ()) -> None:
        self.record = record.record if isinstance(record, Recorded) else record
        self.words = self.record.words.copy()
        there = {address for one in beside for address in one.flat._at}
        self._at, end = dict[int, tuple[int, np.ndarray]](), _rounded(self.words.nbytes)
        for array in _arrays(self.record):
            address = address_of(array)
            if array.size and address not in self._at and address not in there:
                self._at[address] = end, array
                end += _rounded(array.nbytes + BEHIND)
        self.size = end
        self._bases = [0, *(one.address for one in beside)]
        self.ranges = Ranges(
            (address, array.nbytes, number, offset)
            for number, flat in enumerate((self, *(one.flat for one in beside)))
            for address, (offset, array) in flat._at.items()
        )

    def at(self, address: int) -> np.ndarray:
        """The piece (``size``,) uint8 as it is at the ``address`` of a card."""
        piece = np.zeros(self.size, np.uint8)
        for offset, array in [(0, self.words), *self._at.values()]:
            numbers = self.relocated(address, array.reshape(-1).copy()) if array.dtype == np.uint64 else array
            piece[offset : offset + array.nbytes] = numbers.reshape(-1).view(np.uint8)
        return piece

    def relocated(self, address: int, words: np.ndarray) -> np.ndarray:
        """``words`` of the record, changed to point into the piece at ``address``."""
        place, piece, offset = self.ranges.places(words)
        words[place] = np.array([address, *self._bases[1:]], np.uint64)[piece.astype(np.int64)] + offset
        return words

    def arrays(self, piece: np.ndarray) -> list[np.ndarray]:
        """The record's arrays, in its order, as they are in a ``piece`` that came back."""
        found = []
        for array in self.record.arrays:
            offset = self._at[address_of(array)][0] if array.size else 0
            found.append(piece[offset : offset + array.nbytes].view(array.dtype).reshape(array.shape))
        return found


class CardRecord:
    """A ``record`` in a piece of ``pool``; ``address`` is where it is. ``blank``: its arrays are only written there.
    What it shares with records ``beside`` it is theirs."""

    def __init__(
        self, pool: Pool, record: Record | Recorded, *, blank: bool = False, beside: Sequence[CardRecord] = ()
    ) -> None:
        self.pool, self.flat = pool, Flat(record, beside)
        self.address = pool.take(self.flat.size)
        if blank:
            self.end(self.flat.record)
        else:
            pool.card.write(self.address, self.flat.at(self.address))

    def arrays(self) -> list[np.ndarray]:
        """Returns the arrays as they are in the card's memory now, in the record's order."""
        piece = np.empty(self.flat.size, np.uint8)
        self.pool.card.read(self.address, piece)
        return self.flat.arrays(piece)

    def end(self, record: Record) -> None:
        """Sets the numbers behind the arrays to those of ``record``, which has the same arrays."""
        assert len(record.words) == len(self.flat.words)
        words = self.flat.relocated(self.address, record.words.copy())
        self.pool.card.write(self.address, words)

    def give(self) -> None:
        """Gives its memory back."""
        self.pool.give(self.address)


def piece_bytes(size: int) -> int:
    """Returns the bytes of a pool that a piece of ``size`` bytes takes."""
    return -(-max(size, 1) // ALIGNED) * ALIGNED


def _arrays(record: Record) -> Iterator[np.ndarray]:
    """The arrays of ``record`` and those of its parts, whose words, uint64, are among them."""
    yield from record.arrays
    for part in record.parts:
        yield part.words
        yield from _arrays(part)


def _rounded(size: int) -> int:
    return -(-size // 16) * 16
