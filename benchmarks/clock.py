"""Clocks of benchmarks: of parts of a run one by one, and of one call again and again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

WARM_CALLS = 5


@dataclass
class Clock:
    """Wall and processor time [ms] of every block that ran ``with`` it, of this thread."""

    wall_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)

    def __enter__(self) -> None:
        self._began = time.perf_counter(), time.thread_time()

    def __exit__(self, *_: object) -> None:
        wall, cpu = self._began
        self.cpu_ms.append(1e3 * (time.thread_time() - cpu))
        self.wall_ms.append(1e3 * (time.perf_counter() - wall))


@dataclass(frozen=True)
class Timing:
    """Milliseconds per call: percentiles over all calls, and the least, which a busy machine moves little."""

    min_ms: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    calls: int

    @staticmethod
    def of(taken: Sequence[float]) -> Timing:
        """Of calls that took ``taken`` [ms]."""
        p50, p95, p99 = np.percentile(taken, [50, 95, 99])
        return Timing(float(min(taken)), float(p50), float(p95), float(p99), len(taken))

    def row(self) -> dict[str, float]:
        """The numbers as a row of the table has them."""
        return {"min_ms": self.min_ms, "p50_ms": self.p50_ms, "p95_ms": self.p95_ms, "p99_ms": self.p99_ms}


def timed(call: Callable[[], object], *, seconds: float, calls: int = 500) -> Timing:
    """The time of ``call``, again and again after a warm-up: at most ``calls`` and ``seconds``, at least ten times."""
    for _ in range(WARM_CALLS):
        call()
    clock, end = Clock(), time.perf_counter() + seconds
    while len(clock.wall_ms) < 10 or (len(clock.wall_ms) < calls and time.perf_counter() < end):
        with clock:
            call()
    return Timing.of(clock.wall_ms)
