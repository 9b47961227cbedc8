"""A plugin of pytest that records calls of the engine: ``DRAPE_TAPE=FILE pytest -p tests.drape.engine.tape ...``.

Of every function the first ``MOST`` calls are written, with all memory that they read before and after. ``replay.cpp``
makes them again on another processor. Whole numbers are of 64 bits, little-endian:

| | |
|---|---|
| a call | its name (64 bytes), what it returned, whether it takes scratch; arrays; pointers; arguments |
| arrays | how many; of each the bytes of a number, negative for whole ones, its bytes, and these before and after |
| pointers | how many; of each the array that holds it, where, and the array that it points to |
| arguments | how many; of each a kind, 0 whole, 1 double, 2 array, and the number in eight bytes |
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from drape.engine import calls
from drape.engine.packer import Record, Recorded, address_of

MOST = 4


def pytest_configure() -> None:
    tape, argument, function = Tape(Path(os.environ["DRAPE_TAPE"])), calls._argument, calls._function

    def noted(one: Any, dtype: np.dtype) -> Any:
        tape.given.append(one)
        return argument(one, dtype)

    def taped(name: str, dtype: np.dtype) -> Any:
        real = function(name, dtype)
        return lambda *given: tape.call(f"drape_{name}_{calls.SUFFIX[dtype]}", real, given)

    calls._argument, calls._function = noted, taped


class Tape:
    """The file, and what the call that comes next is given."""

    def __init__(self, path: Path) -> None:
        self.given: list[Any] = []
        self._path, self._seen = path, Counter[str]()
        path.write_bytes(b"")

    def call(self, name: str, real: Any, arguments: tuple[Any, ...]) -> int:
        given, has_scratch = self.given, len(arguments) > len(self.given)
        arrays = _arrays(given)
        before = [array.tobytes() for array in arrays.values()]
        found = real(*arguments)
        if has_scratch and arguments[-1]._obj.overflowed:
            return found  # it is called again
        self.given = []
        self._seen[name] += 1
        if self._seen[name] <= MOST:
            with self._path.open("ab") as file:
                file.write(_written(name, found, has_scratch, given, arrays, before))
        return found


def _arrays(given: list[Any]) -> dict[int, np.ndarray]:
    """The arrays that a call is given, directly or by a record, by their addresses."""
    found: dict[int, np.ndarray] = {}
    for one in given:
        record = one.record if isinstance(one, Recorded) else one
        if isinstance(record, Record):
            one_record: tuple[Any, ...] = (np.frombuffer(record._words, np.uint64), *record.arrays)
        else:
            one_record = (record,)
        for array in one_record:
            if isinstance(array, np.ndarray) and array.size:  # an empty one is at 0
                known = found.get(address_of(array))
                found[address_of(array)] = array if known is None or array.nbytes > known.nbytes else known
    return found


def _written(
    name: str, found: int, has_scratch: bool, given: list[Any], arrays: dict[int, np.ndarray], before: list[bytes]
) -> bytes:
    number = {address: place for place, address in enumerate(arrays)}
    parts = [name.encode().ljust(64, b"\0"), struct.pack("<3q", found, has_scratch, len(arrays))]
    pointers = []
    for place, (array, old) in enumerate(zip(arrays.values(), before, strict=True)):
        size = array.itemsize if array.dtype.kind == "f" else -array.itemsize
        parts += [struct.pack("<2q", size, len(old)), old, array.tobytes()]
        if array.dtype == np.uint64:  # of records: no number in them looks like an address
            words = np.frombuffer(old, np.uint64).tolist()
            pointers += [(place, 8 * at, number[word]) for at, word in enumerate(words) if word in number]
    parts += [struct.pack("<q", len(pointers)), *(struct.pack("<3q", *pointer) for pointer in pointers)]
    parts.append(struct.pack("<q", len(given)))
    for one in given:
        one = one.record if isinstance(one, Recorded) else one
        if isinstance(one, Record | np.ndarray):
            address = one.address if isinstance(one, Record) else address_of(one)
            parts.append(struct.pack("<2q", 2, number[address]) if address else struct.pack("<2q", 0, 0))
        elif isinstance(one, bool | int | np.integer):
            parts.append(struct.pack("<2q", 0, int(one)))
        else:
            parts.append(struct.pack("<qd", 1, one))
    return b"".join(parts)
