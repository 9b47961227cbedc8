"""Arrays and numbers of Python as the words that the engine reads; ``drape.engine.records`` has their layout."""

from __future__ import annotations

import ctypes
import dataclasses
import struct
from array import array
from functools import cached_property
from typing import Any

import numpy as np

from drape.engine.records import ARRAYS, RECORDS

_TYPES = {
    "float32s": np.dtype(np.float32),
    "float64s": np.dtype(np.float64),
    "int32s": np.dtype(np.int32),
    "uint32s": np.dtype(np.uint32),
    "uint16s": np.dtype(np.uint16),
    "bytes": np.dtype(np.uint8),
}
_WORD, _WORDS = struct.Struct("<Q"), {"number": struct.Struct("<d"), "count": struct.Struct("<q")}


class Record:
    """The words of a record, and the ``arrays`` that they point to.

    ``address`` [bytes] is where the words are.
    """

    __slots__ = ("_words", "address", "arrays")

    def __init__(self, name: str, value: Any, dtype: Any = None) -> None:
        """The record ``name`` of ``value``, which has its fields as attributes. Numbers in arrays are of ``dtype``, or
        else of the first such array's.

        Raises ``TypeError`` where an array has another type or is not contiguous: that is our own mistake.
        """
        self.arrays: list[np.ndarray] = []
        dtype = np.dtype(dtype or _numbers_type(name, value) or np.float32)
        self._words = array("Q", self._filled(name, value, dtype))
        self.address = self._words.buffer_info()[0]

    def _filled(self, name: str, value: Any, dtype: np.dtype) -> list[int]:
        words: list[int] = []
        for field, kind in RECORDS[name].items():
            own = getattr(value, field)
            if kind in ARRAYS:
                wanted = _TYPES.get(kind, dtype)
                if own.dtype != wanted or not own.flags.c_contiguous:
                    raise TypeError(f"{name}.{field}: expected contiguous {wanted}, got {own.dtype}, {own.strides}")
                self.arrays.append(own)
                words += (address_of(own), own.size)
            elif kind in RECORDS:
                words += self._filled(kind, own, dtype)
            elif kind in _WORDS:
                words += _WORD.unpack(_WORDS[kind].pack(own))
            else:
                parts = np.array([word for one in own for word in self._filled(kind[:-2], one, dtype)], np.uint64)
                self.arrays.append(parts)
                words += (address_of(parts), len(own))
        return words


def address_of(numbers: np.ndarray) -> int:
    """Where contiguous ``numbers`` begin, 0 if there are none; by a buffer, which takes a third of the time that
    ``ctypes`` of the array does. Raises ``TypeError`` for an array that is not contiguous."""
    if numbers.size == 0:
        return 0
    if not numbers.flags.writeable and numbers.flags.c_contiguous:
        return numbers.ctypes.data
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers))  # pyright: ignore[reportArgumentType]


class Recorded:
    """Constants that the engine reads as the record of their class's name; such a class has its fields."""

    @cached_property
    def record(self) -> Record:
        """Themselves as the engine reads them."""
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
