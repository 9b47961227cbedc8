"""Measures what keeps the event loop busy, by cause: ``LoopWatch``.

While the loop runs one step of one task, every stream waits. The cause of a step of a request is its path, that of
another step the function of its task. Python's collector stops all threads, whichever one it begins in.
"""

from __future__ import annotations

import asyncio
import gc
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from typing import Any, cast

from service.watch.logs import ASKER, logged_path
from service.watch.prometheus import Metrics

BRIEF_S = 1e-3  # shorter steps are not counted
COLLECTOR = "collector"


class LoopWatch:
    """Counts in ``Metrics.loop_held`` what keeps the event loop busy for ``BRIEF_S`` or longer: steps of tasks, and
    runs of Python's collector.

    The histogram has two states: ``ran`` is time on a processor, ``waited`` the rest of a step, in which it waits for
    the interpreter lock, a processor or a disk.
    """

    def __init__(self, metrics: Metrics) -> None:
        self._metrics, self._begun_s = metrics, 0.0
        self._pauses_s: deque[float] = deque()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Measures the steps of the running event loop, and the collector, while the block runs."""
        loop = asyncio.get_running_loop()
        make: Any = lambda loop, work, **named: asyncio.Task(cast(Any, _Steps(work, self)), loop=loop, **named)  # noqa: E731
        loop.set_task_factory(make)
        gc.callbacks.append(self._collected)
        try:
            yield
        finally:
            gc.callbacks.remove(self._collected)
            loop.set_task_factory(None)

    def _collected(self, phase: str, _: dict[str, int]) -> None:
        # A collection may begin while a series is locked, so it must not be counted here.
        if phase == "start":
            self._begun_s = time.perf_counter()
        elif (took_s := time.perf_counter() - self._begun_s) >= BRIEF_S:
            self._pauses_s.append(took_s)

    def late(self, lag_s: float) -> None:
        """Notes that the last tick of the loop was ``lag_s`` [s] late, and counts the collections since the last
        call."""
        self._metrics.loop_lag.set(lag_s)
        while self._pauses_s:
            self._metrics.loop_held.labels(COLLECTOR, "ran").observe(self._pauses_s.popleft())

    def count_step(self, function: str, took_s: float, ran_s: float) -> None:
        """Counts a step of a task that runs ``function``: it took ``took_s`` [s], of which ``ran_s`` [s] on a
        processor."""
        asker = ASKER.get()
        cause = function if asker is None else logged_path(asker.scope)
        for state, time_s in (("ran", ran_s), ("waited", took_s - ran_s)):
            if time_s >= BRIEF_S:
                self._metrics.loop_held.labels(cause, state).observe(time_s)


class _Steps:
    """The coroutine ``work`` of a task, each step of which is timed. All else is that of ``work``."""

    def __init__(self, work: Any, watch: LoopWatch) -> None:
        self._work, self._watch = work, watch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._work, name)

    def send(self, value: Any) -> Any:
        return self._step(self._work.send, value)

    def throw(self, *error: Any) -> Any:
        return self._step(self._work.throw, *error)

    def _step(self, step: Callable[..., Any], *given: Any) -> Any:
        begun_s, ran_s = time.perf_counter(), time.thread_time()
        try:
            return step(*given)
        finally:
            if (took_s := time.perf_counter() - begun_s) >= BRIEF_S:
                self._watch.count_step(getattr(self._work, "__qualname__", "task"), took_s, time.thread_time() - ran_s)


Coroutine.register(_Steps)  # pyright: ignore[reportAttributeAccessIssue]  # a task takes only coroutines
