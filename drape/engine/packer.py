"""Arrays and numbers of Python as the words that the engine reads; ``drape.engine.records`` has their layout."""

from __future__ import annotations

import ctypes
import dataclasses
import struct
from array import array
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from drape.engine.records import ARRAYS, RECORDS

TYPES = {
    "float32s": np.dtype(np.float32),
    "float64s": np.dtype(np.float64),
    "int32s": np.dtype(np.int32),
    "uint32s": np.dtype(np.uint32),
    "uint16s": np.dtype(np.uint16),
    "bytes": np.dtype(np.uint8),
}
_WORD, _WORDS = struct.Struct("<Q"), {"number": struct.Struct("<d"), "count": struct.Struct("<q")}


class Record:
    """The 64-bit words of a record as the engine reads them, at ``address``. The words point to ``arrays``, and to the
    records ``parts``; this keeps both alive."""

    __slots__ = ("_words", "address", "arrays", "parts")

    def __init__(self, name: str, value: Any, dtype: Any = None) -> None:
        """The record ``name`` of ``value``, which has its fields as attributes. Numbers in arrays are of ``dtype``, or
        else of the first such array's.

        Raises ``TypeError`` where an array has another type or is not contiguous: that is our own mistake.
        """
        self.arrays: list[np.ndarray] = []
        self.parts: list[Record] = []
        dtype = np.dtype(dtype or _numbers_type(name, value) or np.float32)
        self._set(self._filled(name, value, dtype))

    @classmethod
    def of_rows(cls, blocks: Sequence[np.ndarray], *numbers: float) -> Record:
        """Returns the record whose first fields are arrays, the rows of ``blocks``, one block after the other, and
        whose last fields are ``numbers``.

        The address of a block is asked for once, and not that of each row. Types are not checked.
        """
        record, words = object.__new__(cls), []
        for block in blocks:
            first, size = address_of(block), block[0].size
            step = size * block.itemsize
            words += [word for i in range(len(block)) for word in ((first + i * step) if size else 0, size)]
        record.arrays, record.parts = list(blocks), []
        record._set(words + _number_words(numbers))
        return record

    def ending(self, *numbers: float) -> Record:
        """Returns a record of the same arrays that has ``numbers`` in its last fields."""
        record = object.__new__(Record)
        record.arrays, record.parts = self.arrays, self.parts
        record._set([*self._words[: -len(numbers)], *_number_words(numbers)])
        return record

    @property
    def words(self) -> np.ndarray:
        """Returns the words (n,) uint64, not a copy of them."""
        return np.frombuffer(self._words, np.uint64)

    def _set(self, words: list[int]) -> None:
        self._words = array("Q", words)
        self.address = self._words.buffer_info()[0]

    def _filled(self, name: str, value: Any, dtype: np.dtype) -> list[int]:
        words: list[int] = []
        for field, kind in RECORDS[name].items():
            own = getattr(value, field)
            if kind in ARRAYS:
                wanted = TYPES.get(kind, dtype)
                if own.dtype != wanted or not own.flags.c_contiguous:
                    raise TypeError(f"{name}.{field}: expected contiguous {wanted}, got {own.dtype}, {own.strides}")
                self.arrays.append(own)
                words += (address_of(own), own.size)
            elif kind in RECORDS:
                words += self._filled(kind, own, dtype)
            elif kind in _WORDS:
                words += _WORD.unpack(_WORDS[kind].pack(own))
            elif own is None or isinstance(own, Record | Recorded):
                made = own.record if isinstance(own, Recorded) else own  # whose maker keeps it
                self.parts += [made] if made else []
                words += (made.address, 1) if made else (0, 0)
            else:
                parts = np.array([word for one in own for word in self._filled(kind[:-2], one, dtype)], np.uint64)
                self.arrays.append(parts)
                words += (address_of(parts), len(own))
        return words


def _number_words(numbers: Sequence[float]) -> list[int]:
    """``numbers`` as words: whole ones as a ``count``, others as a ``number``."""
    kinds = ("count" if isinstance(one, int) else "number" for one in numbers)
    return [_WORD.unpack(_WORDS[kind].pack(one))[0] for kind, one in zip(kinds, numbers, strict=True)]


def address_of(numbers: np.ndarray) -> int:
    """Returns the address [bytes] at which the array ``numbers`` begins; 0 if it is empty.

    The address comes from the array's buffer, which takes a third of the time of its ``ctypes``. Raises ``TypeError``
    for an array that is not contiguous.
    """
    if numbers.size == 0:
        return 0
    if not numbers.flags.writeable and numbers.flags.c_contiguous:
        return numbers.ctypes.data
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers))  # pyright: ignore[reportArgumentType]


class Recorded:
    """Base of a class of constants whose fields are those of the engine's record of the same name."""

    @cached_property
    def record(self) -> Record:
        """Returns the constants as the record that the engine reads; it is made once."""
        return Record(type(self).__name__, self)

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle has of them: not what was made from them, which holds addresses."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]


def _numbers_type(name: str, value: Any) -> np.dtype | None:
    """The type of the first numbers in ``value``, which has the fields of the record ``name``."""
    for field, kind in RECORDS[name].items():
        own, inner = getattr(value, field), kind.removesuffix("[]")
        if kind == "numbers":
            return own.dtype
        for one in (own[:1] if kind.endswith("[]") else [own]) if inner in RECORDS else []:
            if found := _numbers_type(inner, one):
                return found
    return None
