"""Functions of the engine as Python calls them: how long each call takes, and how many bytes it is given.

Beside them stands what this processor does at best, in multiply-adds of matrices and bytes of copies in a second.

A function is a name that is given to ``drape.engine.calls``. While those are ``replaced``, calls go through what stands
in their place.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

import numpy as np
import torch

from benchmarks.stopwatch import timed
from drape.engine import calls
from drape.engine.packer import Record, Recorded

PACKAGES = ("drape", "service")
PYTHON = "Python"
Calls = list[tuple[str, float, float]]  # names, processor [s], wall [s]
Spent = dict[tuple[str, str], np.ndarray]  # by stage and function: calls, processor [ms], wall [ms]


@contextmanager
def replaced(make: Callable[[str, Any], Callable[..., Any]]) -> Iterator[int]:
    """A context in which what ``make(name, function)`` returns is called in place of each function of the engine; gives
    how many names in loaded modules were replaced."""

    def stands_for(calling: Callable[..., int], name: str, dtype: Any, *arguments: Any) -> Any:
        return make(name, partial(calling, name, dtype))(*arguments)

    names = [
        (module, name, value)
        for key, module in list(sys.modules.items())
        if key.split(".")[0] in PACKAGES and module is not calls
        for name, value in list(vars(module).items())
        if value is calls.call or value is calls.call_with_scratch
    ]
    for module, name, value in names:
        setattr(module, name, partial(stands_for, value))
    try:
        yield len(names)
    finally:
        for module, name, value in names:
            setattr(module, name, value)


class Trace:
    """A record of where the time of this thread's frames goes.

    ``begin`` is called before a frame and ``took`` after each of its stages; between these run functions that ``timed``
    wrapped.
    """

    def __init__(self) -> None:
        self._frames: list[list[tuple[str, float, float, Calls]]] = []
        self._calls: Calls = []
        self._mark = _now()

    def begin(self) -> None:
        """Begins a frame: all that follows counts for it."""
        self._frames.append([])
        self._calls, self._mark = [], _now()

    def took(self, stage: str, _: float) -> None:
        """Ends ``stage``: the time and the calls since ``begin`` or the last ``took`` count for it."""
        now = _now()
        self._frames[-1].append((stage, now[0] - self._mark[0], now[1] - self._mark[1], self._calls))
        self._calls, self._mark = [], now

    def frames(self) -> list[Spent]:
        """Returns for each frame arrays (3,) by (stage, function): the number of calls, the processor time [ms] and the
        wall time [ms]. What a stage spends outside of the engine's functions is under (stage, ``PYTHON``)."""
        frames: list[Spent] = []
        for frame in self._frames:
            spent: Spent = {}
            for stage, cpu_s, wall_s, called in frame:
                rest = np.array([1.0, 1e3 * cpu_s, 1e3 * wall_s])
                for name, cpu, wall in called:
                    call = np.array([1.0, 1e3 * cpu, 1e3 * wall])
                    spent[stage, name] = spent.get((stage, name), 0.0) + call
                    rest[1:] -= call[1:]
                spent[stage, PYTHON] = rest
            frames.append(spent)
        return frames

    def timed(self, name: str, function: Any) -> Callable[..., Any]:
        """Returns ``function`` wrapped so that the time of each call is recorded under ``name``."""

        def call(*arguments: Any) -> Any:
            cpu, wall = _now()
            result = function(*arguments)
            cpu_after, wall_after = _now()
            self._calls.append((name, cpu_after - cpu, wall_after - wall))
            return result

        return call


def _now() -> tuple[float, float]:
    return time.thread_time(), time.perf_counter()


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    """Yields the arrays in ``value``: itself, those of a record of the engine, or those in a tuple at any depth."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Record):
        yield from value.arrays
    elif isinstance(value, Recorded):
        yield from value.record.arrays
    elif isinstance(value, tuple):
        for item in value:
            yield from arrays_of(item)


def moved_bytes(*values: Any) -> int:
    """Returns the bytes of all arrays in ``values`` (``arrays_of``), each counted once."""
    return sum({(array.ctypes.data, array.nbytes): array.nbytes for array in arrays_of(values)}.values())


def multiply_adds(name: str, arguments: tuple[Any, ...]) -> int:
    """Returns how many multiply-adds the engine's function ``name`` does in products of matrices when it is called with
    ``arguments``: in layers of the network, whose rows are the patches, and in products with the columns of tiles; 0
    for a function that has none."""
    if name == "jets":
        weights, rows, _, passes, *_ = arguments
        once = sum(layer.weight.size for layer in (weights.surroundings, *weights.trunk, *weights.heads))
        per_pass = weights.first[0].weight.size + weights.second[0].weight.size
        return len(rows.scale) * (once + passes * per_pass)
    return 3 * arguments[1].columns.size if name == "vertices" else 0


WIDTH = 1024  # rows and columns of the matrices that are multiplied
SECONDS = 0.05  # how long copies are measured


@cache
def multiply_adds_per_s() -> float:
    """Returns how many multiply-adds a second one thread does in a product of two large float32 matrices."""
    torch.set_num_threads(1)
    a, b = torch.rand(WIDTH, WIDTH), torch.rand(WIDTH, WIDTH)
    return WIDTH**3 / (1e-3 * timed(lambda: a @ b, seconds=1.0))


def copied_per_s(moved: int) -> float:
    """Returns how many bytes a second one thread moves in copies; a copied byte counts twice, as read and as written.
    One copy moves ``moved`` bytes, rounded up to a power of two, always from and to the same memory."""
    return _copied_per_s(max(1 << 12, 1 << (moved - 1).bit_length()))


@cache
def _copied_per_s(moved: int) -> float:
    torch.set_num_threads(1)
    source = torch.rand(moved // 8)
    target = torch.empty_like(source)
    return moved / (1e-3 * timed(lambda: target.copy_(source), seconds=SECONDS))
