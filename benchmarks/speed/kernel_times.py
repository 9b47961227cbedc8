"""Compiled kernels as Python calls them: how long each call takes, and how many bytes it is given and gives.

A kernel is a name in a module. While names are ``replaced``, calls from Python go through what stands in their place;
kernels that kernels call are compiled into these and seen as part of them. All kernels must have been called before:
one that is compiled meanwhile would read the names.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

PACKAGES = ("drape", "service")
PYTHON = "Python"
Calls = list[tuple[str, float, float]]  # names, processor [s], wall [s]
Spent = dict[tuple[str, str], np.ndarray]  # by stage and kernel: calls, processor [ms], wall [ms]


@contextmanager
def replaced(make: Callable[[str, Any], Callable[..., Any]]) -> Iterator[int]:
    """A context in which modules call ``make(name, kernel)`` in place of each kernel; gives the number of names."""
    names = [
        (module, name, value)
        for key, module in list(sys.modules.items())
        if key.split(".")[0] in PACKAGES
        for name, value in list(vars(module).items())
        if isinstance(value, CPUDispatcher)
    ]
    for module, name, value in names:
        home = value.py_func.__module__.split(".")[-1]
        setattr(module, name, make(f"{home}.{value.py_func.__name__}", value))
    try:
        yield len(names)
    finally:
        for module, name, value in names:
            setattr(module, name, value)


class Trace:
    """Where the time of this thread's frames goes.

    ``begin`` comes before a frame and ``took`` after each of its stages; between them ``timed`` kernels run.
    """

    def __init__(self) -> None:
        self._frames: list[list[tuple[str, float, float, Calls]]] = []
        self._calls: Calls = []
        self._mark = _now()

    def begin(self) -> None:
        """A frame begins."""
        self._frames.append([])
        self._calls, self._mark = [], _now()

    def took(self, stage: str, _: float) -> None:
        """The calls since the last mark were those of ``stage``, which ends."""
        now = _now()
        self._frames[-1].append((stage, now[0] - self._mark[0], now[1] - self._mark[1], self._calls))
        self._calls, self._mark = [], now

    def frames(self) -> list[Spent]:
        """What each frame spent; of what a stage spends, that outside of kernels is ``PYTHON``."""
        found: list[Spent] = []
        for frame in self._frames:
            found.append({})
            for stage, cpu_s, wall_s, calls in frame:
                rest = np.array([1.0, 1e3 * cpu_s, 1e3 * wall_s])
                for name, cpu, wall in calls:
                    one = np.array([1.0, 1e3 * cpu, 1e3 * wall])
                    found[-1][stage, name] = found[-1].get((stage, name), 0.0) + one
                    rest[1:] -= one[1:]
                found[-1][stage, PYTHON] = rest
        return found

    def timed(self, name: str, kernel: Any) -> Callable[..., Any]:
        """``kernel``, whose calls are told to the trace."""

        def call(*arguments: Any) -> Any:
            cpu, wall = _now()
            found = kernel(*arguments)
            cpu_after, wall_after = _now()
            self._calls.append((name, cpu_after - cpu, wall_after - wall))
            return found

        return call


def _now() -> tuple[float, float]:
    return time.thread_time(), time.perf_counter()


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    """The arrays in ``value``: itself, or those of a tuple of any depth."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for one in value:
            yield from arrays_of(one)


def moved_bytes(*values: Any) -> int:
    """Bytes of all different arrays in ``values``."""
    return sum({(array.ctypes.data, array.nbytes): array.nbytes for array in arrays_of(values)}.values())


def multiply_adds(name: str, arguments: tuple[Any, ...]) -> int:
    """Multiply-adds of the matrices of the kernel ``name``, 0 where it has none: layers of the network, whose rows are
    the patches, and products with the columns of tiles."""
    if name == "drape.checked_jets":
        weights, rows, _, passes, _ = arguments
        layers = (weights.surroundings, *weights.trunk, *weights.heads)
        once = sum(layer.weight.size for layer in layers)
        each = sum(layer.weight[0].size for layer in weights.corrections)
        return len(rows.scale) * (once + passes * each)
    return 3 * arguments[1].columns.size if name == "blend.blend" else 0
