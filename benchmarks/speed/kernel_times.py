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
    """A context in which modules call ``make(name, function)`` in place of each function of the engine; gives the
    number of names that call one."""

    def stands_for(calling: Callable[..., int], name: str, dtype: Any, *given: Any) -> Any:
        return make(name, partial(calling, name, dtype))(*given)

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
    """Where the time of this thread's frames goes.

    ``begin`` comes before a frame and ``took`` after each of its stages; between them ``timed`` functions run.
    """

    def __init__(self) -> None:
        self._frames: list[list[tuple[str, float, float, Calls]]] = []
        self._calls: Calls = []
        self._mark = _now()

    def begin(self) -> None:
        """Says that a frame begins: the calls that follow are of this frame."""
        self._frames.append([])
        self._calls, self._mark = [], _now()

    def took(self, stage: str, _: float) -> None:
        """Ends ``stage``: the calls since the last mark were its own."""
        now = _now()
        self._frames[-1].append((stage, now[0] - self._mark[0], now[1] - self._mark[1], self._calls))
        self._calls, self._mark = [], now

    def frames(self) -> list[Spent]:
        """Returns for each frame the calls, the processor time [ms] and the wall time [ms], by stage and function.

        What a stage spends outside of the engine's functions is listed under ``PYTHON``.
        """
        found: list[Spent] = []
        for frame in self._frames:
            found.append({})
            for stage, cpu_s, wall_s, called in frame:
                rest = np.array([1.0, 1e3 * cpu_s, 1e3 * wall_s])
                for name, cpu, wall in called:
                    one = np.array([1.0, 1e3 * cpu, 1e3 * wall])
                    found[-1][stage, name] = found[-1].get((stage, name), 0.0) + one
                    rest[1:] -= one[1:]
                found[-1][stage, PYTHON] = rest
        return found

    def timed(self, name: str, function: Any) -> Callable[..., Any]:
        """Returns ``function`` wrapped, so that the trace hears of each call."""

        def call(*arguments: Any) -> Any:
            cpu, wall = _now()
            found = function(*arguments)
            cpu_after, wall_after = _now()
            self._calls.append((name, cpu_after - cpu, wall_after - wall))
            return found

        return call


def _now() -> tuple[float, float]:
    return time.thread_time(), time.perf_counter()


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    """The arrays in ``value``: itself, those of a record, or those of a tuple of any depth."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Record):
        yield from value.arrays
    elif isinstance(value, Recorded):
        yield from value.record.arrays
    elif isinstance(value, tuple):
        for one in value:
            yield from arrays_of(one)


def moved_bytes(*values: Any) -> int:
    """Bytes of all different arrays in ``values``."""
    return sum({(array.ctypes.data, array.nbytes): array.nbytes for array in arrays_of(values)}.values())


def multiply_adds(name: str, given: tuple[Any, ...]) -> int:
    """Multiply-adds of the matrices of the function ``name``, 0 where it has none: layers of the network, whose rows
    are the patches, and products with the columns of tiles."""
    if name == "jets":
        weights, rows, _, passes, *_ = given
        once = sum(layer.weight.size for layer in (weights.surroundings, *weights.trunk, *weights.heads))
        each = weights.first[0].weight.size + weights.second[0].weight.size
        return len(rows.scale) * (once + passes * each)
    return 3 * given[1].columns.size if name == "vertices" else 0


WIDTH = 1024  # of the matrices
SECONDS = 0.05  # of a copy's measurement


@cache
def multiply_adds_per_s(threads: int) -> float:
    """Multiply-adds a second of a product of two large float32 matrices."""
    torch.set_num_threads(threads)
    a, b = torch.rand(WIDTH, WIDTH), torch.rand(WIDTH, WIDTH)
    return WIDTH**3 / (1e-3 * timed(lambda: a @ b, seconds=1.0))


def copied_per_s(moved: int, threads: int) -> float:
    """Returns how many bytes a second copies read and write that move about ``moved`` bytes each, from and to the same
    memory.
    """
    return _copied_per_s(max(1 << 12, 1 << (moved - 1).bit_length()), threads)


@cache
def _copied_per_s(moved: int, threads: int) -> float:
    torch.set_num_threads(threads)
    source = torch.rand(moved // 8)
    target = torch.empty_like(source)
    return moved / (1e-3 * timed(lambda: target.copy_(source), seconds=SECONDS))
