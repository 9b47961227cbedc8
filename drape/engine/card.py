"""Frames of folds on a graphics card: records in its memory, and a launch for the frames of many streams.

``python -m drape.engine.card`` compiles the library for the cards of ``ARCHITECTURES`` with CUDA's ``nvcc``, and needs
no card for it. This file needs NumPy alone.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drape.engine.build import write_header
from drape.engine.packer import Record, Recorded, address_of

SOURCE = Path(__file__).parent / "source" / "card.cu"
LIBRARY = Path(__file__).parent / "libraries" / "card.so"
ARCHITECTURES = (80, 90, 100)  # A100, H100 and H200, B200
STEPS = {"fold": 0, "fold_two_levels": 1, "lift_alone": 2}
OUTCOME = 7  # numbers of 64 bits that a frame tells
SCRATCH_BYTES = 16 << 20  # of a frame, most of it for cloth that crosses itself everywhere


class Memory(Protocol):
    """The memory of a card and its launches; tests put another one in its place."""

    def take(self, size: int) -> int:
        """Takes ``size`` bytes and returns their address."""
        ...

    def write(self, address: int, numbers: np.ndarray) -> None:
        """Writes the array ``numbers`` to ``address``."""
        ...

    def read(self, address: int, numbers: np.ndarray) -> None:
        """Fills the array ``numbers`` with what is at ``address``."""
        ...

    def folds(self, tasks: int, count: int, threads: int, rounds: int = 1) -> float:
        """Draws the frames of the ``count`` tasks at the address ``tasks``, ``rounds`` times. Returns the time that it
        took [ms]."""
        ...


class Card:
    """The first NVIDIA card of this machine, by the compiled ``library``. Raises ``OSError`` where there is none, and
    where the card tells a fault."""

    def __init__(self, library: Path = LIBRARY) -> None:
        self._calls, self._taken = ctypes.CDLL(str(library)), list[int]()
        self._calls.card_fault.restype = ctypes.c_char_p
        name = ctypes.create_string_buffer(128)
        self._do("card_name", name, ctypes.c_int64(127))
        self.name = name.value.decode()

    def take(self, size: int) -> int:
        address = ctypes.c_uint64()
        self._do("card_take", ctypes.byref(address), ctypes.c_int64(max(size, 1)))
        self._taken.append(address.value)
        return address.value

    def return_all_but(self, kept: int) -> None:
        """Gives back all pieces of memory but the first ``kept`` that were taken."""
        while len(self._taken) > kept:
            self._do("card_return", ctypes.c_uint64(self._taken.pop()))

    @property
    def pieces(self) -> int:
        """The number of pieces of memory that are taken."""
        return len(self._taken)

    def write(self, address: int, numbers: np.ndarray) -> None:
        self._do("card_write", ctypes.c_uint64(address), ctypes.c_void_p(address_of(numbers)), _bytes(numbers))

    def read(self, address: int, numbers: np.ndarray) -> None:
        self._do("card_read", ctypes.c_void_p(address_of(numbers)), ctypes.c_uint64(address), _bytes(numbers))

    def folds(self, tasks: int, count: int, threads: int, rounds: int = 1) -> float:
        took_ms = ctypes.c_float()
        given = ctypes.c_uint64(tasks), *map(ctypes.c_int64, (count, threads, rounds)), ctypes.byref(took_ms)
        self._do("card_folds", *given)
        return took_ms.value

    def _do(self, name: str, *given: Any) -> None:
        if fault := getattr(self._calls, name)(*given):
            raise OSError(f"{name}: {self._calls.card_fault(fault).decode()}")


def _bytes(numbers: np.ndarray) -> ctypes.c_int64:
    return ctypes.c_int64(numbers.nbytes)


class CardRecord:
    """A ``record`` and its arrays, copied into the ``memory`` of a card; ``address`` is where the record is."""

    def __init__(self, memory: Memory, record: Record | Recorded) -> None:
        record = record.record if isinstance(record, Recorded) else record
        self._memory, self._record, self._at = memory, record, dict[int, int]()
        words = np.array(record._words, np.uint64)
        for array in record.arrays:
            if array.size:
                self._at[address_of(array)] = memory.take(array.nbytes + 16)  # points are read with a number more
                memory.write(self._at[address_of(array)], array)
        # An array may be a row of another one, so a word is an address within the last that begins before it.
        begins = np.array(sorted(self._at), np.uint64)
        for place, word in enumerate(words.tolist()):
            before = int(np.searchsorted(begins, np.uint64(word), side="right")) - 1
            if before >= 0 and word - int(begins[before]) < self._size(int(begins[before])):
                words[place] = self._at[int(begins[before])] + word - int(begins[before])
        self.address = memory.take(words.nbytes)
        memory.write(self.address, words)

    def _size(self, begin: int) -> int:
        return next(array.nbytes for array in self._record.arrays if array.size and address_of(array) == begin)

    def arrays(self) -> list[np.ndarray]:
        """Returns the arrays as they are in the card's memory now, in the record's order."""
        arrays = [np.empty_like(array) for array in self._record.arrays]
        for array, own in zip(self._record.arrays, arrays, strict=True):
            if array.size:
                self._memory.read(self._at[address_of(array)], own)
        return arrays


class Frames:
    """Frames of folds that one launch draws."""

    def __init__(self, memory: Memory) -> None:
        self._memory, self._words = memory, list[int]()
        self._outcomes, self._folded, self._scratches = list[int](), list[tuple[int, tuple[int, ...]]](), list[int]()
        self._tasks = 0

    def add(self, name: str, vertices: np.ndarray, *records: CardRecord) -> None:
        """Adds a frame that the engine's function ``name`` computes of ``vertices`` [m] (V, 3) float32.

        ``records`` are those of its past, its surroundings, its cloth, its effort, and what it leaves to the next
        frame.
        """
        take, write = self._memory.take, self._memory.write
        given, folded, outcome, scratch = take(vertices.nbytes), take(vertices.nbytes), take(8 * OUTCOME), take(32)
        write(given, vertices)
        write(scratch, np.array([take(SCRATCH_BYTES), SCRATCH_BYTES, 0, 0], np.uint64))
        self._words += [STEPS[name], given, *(record.address for record in records), folded, outcome, scratch]
        self._outcomes.append(outcome)
        self._scratches.append(scratch)
        self._folded.append((folded, vertices.shape))
        self._tasks = 0

    def draw(self, threads: int, rounds: int = 1) -> float:
        """Draws all of them; the time of the launches [ms]. Raises ``MemoryError`` where scratch was too small."""
        if not self._tasks:
            words = np.array(self._words, np.uint64)
            self._tasks = self._memory.take(words.nbytes)
            self._memory.write(self._tasks, words)
        took_ms = self._memory.folds(self._tasks, len(self._outcomes), threads, rounds)
        for at in self._scratches:
            self._memory.read(at, state := np.empty(4, np.uint64))
            if state[3] & 1:
                raise MemoryError(f"a frame on a card needs more than {SCRATCH_BYTES} bytes of scratch")
        return took_ms

    def drawn(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Returns for each frame the folded vertices [m] (V, 3) and the numbers that the engine writes of it
        (``OUTCOME``,) int64."""
        frames = []
        for (folded, shape), outcome in zip(self._folded, self._outcomes, strict=True):
            vertices, told = np.empty(shape, np.float32), np.empty(OUTCOME, np.int64)
            self._memory.read(folded, vertices)
            self._memory.read(outcome, told)
            frames.append((vertices, told))
        return frames


def build_card(library: Path = LIBRARY, *, architectures: Sequence[int] = ARCHITECTURES) -> str:
    """Compiles the library for cards of these ``architectures``. Returns what the compiler tells of registers and
    memory. Raises ``FileNotFoundError`` without ``nvcc``."""
    nvcc = shutil.which("nvcc")
    if nvcc is None:
        raise FileNotFoundError("nvcc: expected CUDA's compiler on PATH, got none; install CUDA 12.8 or later")
    write_header()
    library.parent.mkdir(parents=True, exist_ok=True)
    codes = [f"-gencode=arch=compute_{one},code=sm_{one}" for one in architectures]
    command = [nvcc, "-std=c++20", "-O3", "-shared", "-Xcompiler=-fPIC", "-Xptxas=-v", *codes]
    done = subprocess.run([*command, str(SOURCE), "-o", str(library)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"nvcc: {done.stderr}")
    return done.stderr


if __name__ == "__main__":
    sys.stdout.write(build_card())
