"""Clocks of benchmarks: of parts of a run one by one, and of one call again and again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

WARM_CALLS = 5


@dataclass
class Clock:
    """The wall time and the processor time of this thread [ms] of every block that ran ``with`` the clock, in order."""

    wall_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)

    def __enter__(self) -> None:
        self._began = time.perf_counter(), time.thread_time()

    def __exit__(self, *_: object) -> None:
        wall, cpu = self._began
        self.cpu_ms.append(1e3 * (time.thread_time() - cpu))
        self.wall_ms.append(1e3 * (time.perf_counter() - wall))


def timed(call: Callable[[], object], *, seconds: float, calls: int = 500) -> float:
    """Returns the median wall time [ms] of ``call``, which is called ten times at least, and then until ``calls`` or
    ``seconds`` are reached."""
    for _ in range(WARM_CALLS):
        call()
    clock, end = Clock(), time.perf_counter() + seconds
    while len(clock.wall_ms) < 10 or (len(clock.wall_ms) < calls and time.perf_counter() < end):
        with clock:
            call()
    return float(np.median(clock.wall_ms))
