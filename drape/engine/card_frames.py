"""Records in a card's memory: flat, in one pool.

A record and its arrays lie in one piece, so that it comes and goes by one copy. This file needs NumPy alone.
"""

from __future__ import annotations

import threading
from bisect import bisect
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from drape.engine.packer import Record, Recorded, address_of

if TYPE_CHECKING:
    from drape.engine.card import Card

ALIGNED = 256  # pieces of memory begin at multiples of it
BEHIND = 16  # bytes behind each array, since points are read four numbers at a time


class Pool:
    """A stretch of ``size`` bytes of a card's memory, which hands out pieces of itself and takes them back;
    ``free_bytes`` are not handed out."""

    def __init__(self, card: Card, size: int) -> None:
        self.card, self.size, self.free_bytes = card, size, size
        self._begin, self._lock = card.take(size), threading.Lock()
        self._free, self._taken = [(0, size)], dict[int, int]()

    def take(self, size: int) -> int:
        """Hands out a piece of ``size`` bytes and returns its address on the card.

        Raises ``MemoryError`` where no free piece is long enough.
        """
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
        """Takes back the piece that was handed out at ``address``."""
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
    """Where arrays of this machine have their copies in a card's memory.

    ``ranges`` are stretches of this machine's memory, and each has a copy in one piece of the card's memory. A piece is
    a block of bytes; its number is an index that the caller gives, from 0 on. A range is its first address here, its
    length [bytes], the number of the piece with its copy, and the offset [bytes] in the piece at which the copy begins.
    """

    def __init__(self, ranges: Iterable[tuple[int, int, int, int]]) -> None:
        self.begin, self.size, self.piece, self.offset = np.array(sorted(ranges), np.uint64).reshape(-1, 4).T

    def places(self, words: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns which of the ``words`` (n,) uint64 are addresses within the ranges, as three arrays: the indices (k,)
        of these words; the number (k,) of the piece that holds the copy of what each points to; and the offset (k,)
        [bytes] at which this copy begins in the piece."""
        # An array may be a row of another one, so a word is an address within the last that begins before it.
        before = np.searchsorted(self.begin, words, side="right") - 1
        place = np.flatnonzero(before >= 0)
        before = before[place]
        inside = words[place] - self.begin[before]
        own = inside < self.size[before]
        return place[own], self.piece[before[own]], (self.offset[before] + inside)[own]


class Flat:
    """The layout of a ``record`` in one piece of a card's memory: its words first, then its arrays, then the words and
    arrays of its parts. ``size`` is the length of the piece [bytes].

    Arrays that are also in one of the records ``beside`` lie on the card already. They are left out, and the words
    point to them there.
    """

    def __init__(self, record: Record | Recorded, beside: Sequence[CardRecord] = ()) -> None:
        self.record = record.record if isinstance(record, Recorded) else record
        self.words = self.record.words.copy()
        there = {address for other in beside for address in other.flat._at}
        self._at, end = dict[int, tuple[int, np.ndarray]](), _rounded(self.words.nbytes)
        for array in _arrays(self.record):
            address = address_of(array)
            if array.size and address not in self._at and address not in there:
                self._at[address] = end, array
                end += _rounded(array.nbytes + BEHIND)
        self.size = end
        self._bases = [0, *(other.address for other in beside)]
        self.ranges = Ranges(
            (address, array.nbytes, number, offset)
            for number, flat in enumerate((self, *(other.flat for other in beside)))
            for address, (offset, array) in flat._at.items()
        )

    def at(self, address: int) -> np.ndarray:
        """Returns the bytes (``size``,) uint8 to be copied to the card's ``address``; the words among them point into
        the piece that begins there."""
        piece = np.zeros(self.size, np.uint8)
        for offset, array in [(0, self.words), *self._at.values()]:
            numbers = self._relocated(address, array.reshape(-1).copy()) if array.dtype == np.uint64 else array
            piece[offset : offset + array.nbytes] = numbers.reshape(-1).view(np.uint8)
        return piece

    def _relocated(self, address: int, words: np.ndarray) -> np.ndarray:
        """``words`` of the record, changed in place to point into the piece at ``address``."""
        place, piece, offset = self.ranges.places(words)
        words[place] = np.array([address, *self._bases[1:]], np.uint64)[piece.astype(np.int64)] + offset
        return words


class CardRecord:
    """A copy of ``record`` on a card, in a piece of ``pool`` that begins at ``address``. Arrays that are also in one of
    the records ``beside`` are not copied again: both copies point to the same ones."""

    def __init__(self, pool: Pool, record: Record | Recorded, *, beside: Sequence[CardRecord] = ()) -> None:
        self.pool, self.flat = pool, Flat(record, beside)
        self.address = pool.take(self.flat.size)
        pool.card.write(self.address, self.flat.at(self.address))

    def give(self) -> None:
        """Gives the record's piece of memory back to the pool."""
        self.pool.give(self.address)


def piece_bytes(size: int) -> int:
    """Returns how many bytes of a pool a piece of ``size`` bytes takes: the next multiple of ``ALIGNED``."""
    return -(-max(size, 1) // ALIGNED) * ALIGNED


def _arrays(record: Record) -> Iterator[np.ndarray]:
    """The arrays of ``record`` and those of its parts, whose words, uint64, are among them."""
    yield from record.arrays
    for part in record.parts:
        yield part.words
        yield from _arrays(part)


def _rounded(size: int) -> int:
    return -(-size // 16) * 16
