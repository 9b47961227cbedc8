"""Finds jobs that make no progress, and ends a process that does not end: ``Watchdog``.

A ``WatchedJob`` is a call on a thread of a ``ThreadLane``, or the work of a process of the service. A job moves, that
is makes progress, when it calls ``say_moved`` (at a step of a chunk, a frame). One that has not called it yet moves
while its thread, or the process that it waits for, takes processor time.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import logging
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from service.watch.probes import TICK_S, Lifecycle
from service.watch.prometheus import Metrics

SHARE = 0.01  # the share of a processor below which a silent job counts as waiting
MOST_S = 300.0  # the longest that a thread may compute without ``say_moved``
LAST_S = 1.0  # the time before the kernel ends the process, for the log and to kill its processes
_here, _armed = threading.local(), threading.Event()
log = logging.getLogger("drape.service")


def spent_s(number: int, *, thread: bool = False) -> float:
    """Returns the processor time [s] of the process ``number``, or of the ``thread`` of this process with that number,
    by Linux's clock of it. Where there is no such clock, returns the monotonic time [s], as if it always computed."""
    try:
        return time.clock_gettime((~number << 3) | (6 if thread else 2))
    except OSError:
        return time.monotonic()


@dataclass(eq=False)
class WatchedJob:
    """A running job. ``lane`` is the name that all jobs of its kind share. ``clocks`` return the processor time [s]
    that it has taken; ``thread`` is its thread's id, 0 for a process. ``moved_s`` [s, monotonic] is when it last made
    progress (moved); ``silent``: it has not called ``say_moved``, so processor time counts as progress."""

    lane: str
    clocks: list[Callable[[], float]]
    thread: int = 0
    moved_s: float = field(default_factory=time.monotonic)
    silent: bool = True

    def __post_init__(self) -> None:
        self._spent_s, self._begun_s = sum(clock() for clock in self.clocks), self.moved_s

    def look(self, now_s: float) -> float:
        """Notes whether the job has moved since the last look. Returns how long [s] before ``now_s`` it last moved."""
        spent = sum(clock() for clock in self.clocks)
        endless = self.thread and now_s - self._begun_s > MOST_S
        if self.silent and not endless and abs(spent - self._spent_s) > SHARE * (now_s - self.moved_s):
            self.moved_s, self._spent_s = now_s, spent
        return now_s - self.moved_s

    def stack(self) -> list[traceback.FrameSummary]:
        """Returns the stack of the job's thread, the innermost call last; empty for a process."""
        frame = sys._current_frames().get(self.thread)
        return [] if frame is None else traceback.extract_stack(frame)


JOBS: set[WatchedJob] = set()
"""All jobs that run in this process and in processes that it has started."""


def say_moved() -> None:
    """Notes that the job of this thread has moved. From then on only calls of this function count as progress, and
    processor time no longer does."""
    if (job := getattr(_here, "job", None)) is not None:
        job.moved_s, job.silent = time.monotonic(), False


def waits_for(clock: Callable[[], float]) -> None:
    """Adds ``clock``, which returns the processor time [s] of a process, to those by which the job of this thread
    moves."""
    if (job := getattr(_here, "job", None)) is not None:
        job.clocks.append(clock)


class ThreadLane(ThreadPoolExecutor):
    """A pool of ``threads`` threads. Each of its calls is a job of the lane ``name``, at which the watchdog looks.

    Calls of a ``brief`` lane are expected to end soon, so processor time does not count as progress.
    """

    def __init__(self, name: str, threads: int | None = None, *, brief: bool = False, **more: Any) -> None:
        super().__init__(threads, thread_name_prefix=f"drape-{name}", **more)
        self._name, self._brief = name, brief

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Any:
        return super().submit(self._run, function, *arguments, **named)

    def _run(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Any:
        clock = partial(spent_s, threading.get_native_id(), thread=True)
        job = _here.job = WatchedJob(self._name, [clock], threading.get_ident(), silent=not self._brief)
        JOBS.add(job)
        try:
            return function(*arguments, **named)
        finally:
            JOBS.discard(job)


class Watchdog:
    """A thread that looks at all jobs, and notes in ``life`` and ``metrics`` how long the oldest of each lane has not
    moved. A job that has not moved for ``stuck_s`` [s] is logged with its stack. ``kill`` ends the processes of the
    service.

    It is made on the thread of the event loop.
    """

    def __init__(self, life: Lifecycle, metrics: Metrics, *, stuck_s: float, kill: Callable[[], None]) -> None:
        self._life, self._metrics, self._stuck_s, self._kill = life, metrics, stuck_s, kill
        self._loop = WatchedJob("event loop", [], threading.get_ident())
        self._stopped, self._reported = threading.Event(), set[WatchedJob]()
        threading.Thread(target=self._watch, name="drape-watchdog", daemon=True).start()

    def stop(self) -> None:
        """Ends the looks at jobs. A process that was told to end is ended by it nevertheless."""
        self._stopped.set()

    def _watch(self) -> None:
        while not self._stopped.is_set() or told_to_end():
            time.sleep(min(TICK_S, 0.25 * self._stuck_s))
            if not self._stopped.is_set():
                self._look(time.monotonic())
            if told_to_end() and signal.getitimer(signal.ITIMER_REAL)[0] < LAST_S:
                self._kill()
                stacks = ["".join(traceback.format_stack(frame)) for frame in sys._current_frames().values()]
                log.critical("told to end, and ended while this ran:\n%s", "\n".join(stacks))
                os._exit(1)

    def _look(self, now_s: float) -> None:
        self._loop.moved_s = now_s - self._life.loop_still_s
        jobs, still = (self._loop, *JOBS), dict.fromkeys(self._life.still, 0.0)
        for job in jobs:
            job.look(now_s)
            still[job.lane] = max(still.get(job.lane, 0.0), now_s - job.moved_s)
        for lane, waited_s in still.items():
            self._metrics.lane_still.labels(lane).set(waited_s)
        self._life.still = still  # after the metrics, so that a probe that fails finds the reason there
        before, self._reported = self._reported, {job for job in jobs if now_s - job.moved_s > self._stuck_s}
        for job in self._reported - before:  # at last, because writing a log may have to wait
            stack = "".join(traceback.format_list(job.stack())) or "It is a process of its own.\n"
            log.error("%s: a job has not moved for %.1f s\n%s", job.lane, now_s - job.moved_s, stack)


def end_when_told() -> None:
    """Makes SIGTERM end this process within 15 s, that is 5 s after its drain, whatever hangs. ``told_to_end`` is true
    from the signal on.

    A handler in Python would wait for the main thread and for the interpreter lock. So the handlers are C functions,
    which get the signal's number: SIGTERM (15) calls ``alarm(15)``, and the alarm (14) calls ``_exit(14)`` after all
    stacks are written. Nothing else ends a process with the number 1, as that of a container.
    """
    libc = ctypes.CDLL(None)
    libc.signal.argtypes, libc.signal.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    libc.signal(signal.SIGALRM, ctypes.cast(libc._exit, ctypes.c_void_p))
    libc.signal(signal.SIGTERM, ctypes.cast(libc.alarm, ctypes.c_void_p))
    with contextlib.suppress(OSError):  # a socket cannot be opened; a pipe without a reader must not delay the end
        errors = os.open("/proc/self/fd/2", os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND)
        faulthandler.register(signal.SIGALRM, file=errors, chain=True)
    _armed.set()


def told_to_end() -> bool:
    """Returns whether this process got SIGTERM, or Ctrl-C, since ``end_when_told`` was called."""
    return _armed.is_set() and signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
