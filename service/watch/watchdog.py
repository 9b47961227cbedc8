"""Whether what runs still moves, and the end of a process in which something does not: ``Watchdog``.

A ``WatchedJob`` is a call on the thread of a ``ThreadLane``, or what a process of the service computes. It moves when
it says so (``say_moved``: a step of a chunk, a frame). One that has said nothing yet moves while its thread, or the
process that it waits for, takes processor time.
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

SHARE = 0.01  # of a processor, below which a silent job only waits
MOST_S = 300.0  # that a thread may compute and say nothing
LAST_S = 1.0  # before the end by the kernel: for the log, and for processes of the service
_here, _armed = threading.local(), threading.Event()
log = logging.getLogger("drape.service")


def spent_s(number: int, *, thread: bool = False) -> float:
    """Processor time [s] of a process, or of a thread of this one, by the clock that Linux has for it. Where there is
    none, or what it counted has ended, a time that always moves."""
    try:
        return time.clock_gettime((~number << 3) | (6 if thread else 2))
    except OSError:
        return time.monotonic()


@dataclass(eq=False)
class WatchedJob:
    """A running job of a ``lane``. ``clocks`` return the processor time [s] that it takes; ``thread`` is the one whose
    stack is told.
    """

    lane: str
    clocks: list[Callable[[], float]]
    thread: int = 0
    moved_s: float = field(default_factory=time.monotonic)
    silent: bool = True

    def __post_init__(self) -> None:
        self._spent_s, self._begun_s = sum(clock() for clock in self.clocks), self.moved_s

    def look(self, now_s: float) -> float:
        """Returns for how long [s] the job has not moved."""
        spent = sum(clock() for clock in self.clocks)
        endless = self.thread and now_s - self._begun_s > MOST_S
        if self.silent and not endless and abs(spent - self._spent_s) > SHARE * (now_s - self.moved_s):
            self.moved_s, self._spent_s = now_s, spent
        return now_s - self.moved_s

    def stack(self) -> list[traceback.FrameSummary]:
        """Returns the stack of the job's thread; an empty one for a process."""
        frame = sys._current_frames().get(self.thread)
        return [] if frame is None else traceback.extract_stack(frame)


JOBS: set[WatchedJob] = set()
"""All that runs in this process, and in processes of it."""


def say_moved() -> None:
    """Says that the job of this thread has moved; from then on it moves only where it says so."""
    if (job := getattr(_here, "job", None)) is not None:
        job.moved_s, job.silent = time.monotonic(), False


def waits_for(clock: Callable[[], float]) -> None:
    """Says that the job of this thread moves with this ``clock`` too, that of a process."""
    if (job := getattr(_here, "job", None)) is not None:
        job.clocks.append(clock)


class ThreadLane(ThreadPoolExecutor):
    """A pool of threads, each of whose calls is a job of the lane ``name`` that the watchdog looks at.

    In a ``brief`` lane a call is expected to end soon: taking processor time does not count as moving.
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
    """A thread that looks at all jobs. Those that have not moved for ``stuck_s`` are told in the log with their stack,
    their lane to ``life`` and ``metrics``. ``kill`` ends the processes of the service. Made on the loop's thread."""

    def __init__(self, life: Lifecycle, metrics: Metrics, *, stuck_s: float, kill: Callable[[], None]) -> None:
        self._life, self._metrics, self._stuck_s, self._kill = life, metrics, stuck_s, kill
        self._loop = WatchedJob("event loop", [], threading.get_ident())
        self._stopped, self._told = threading.Event(), set[WatchedJob]()
        threading.Thread(target=self._watch, name="drape-watchdog", daemon=True).start()

    def stop(self) -> None:
        """Looks at no job any more; a process that was told to end is still ended."""
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
        self._life.still = still  # who sees it there finds it in the metrics
        before, self._told = self._told, {job for job in jobs if now_s - job.moved_s > self._stuck_s}
        for job in self._told - before:  # last: a log may keep who writes it waiting
            stack = "".join(traceback.format_list(job.stack())) or "It is a process of its own.\n"
            log.error("%s: a job has not moved for %.1f s\n%s", job.lane, now_s - job.moved_s, stack)


def end_when_told() -> None:
    """Lets SIGTERM end this process within 15 s, 5 after its drain, whatever hangs; ``told_to_end`` sees it.

    A handler of Python waits for the main thread and for the interpreter lock. These are functions of C, which get the
    signal's number: ``alarm(15)`` of SIGTERM and, after all stacks, ``_exit(14)`` of the alarm, as nothing else ends a
    process with the number 1, that of a container.
    """
    libc = ctypes.CDLL(None)
    libc.signal.argtypes, libc.signal.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    libc.signal(signal.SIGALRM, ctypes.cast(libc._exit, ctypes.c_void_p))
    libc.signal(signal.SIGTERM, ctypes.cast(libc.alarm, ctypes.c_void_p))
    with contextlib.suppress(OSError):  # of a socket; a pipe that nobody reads must not hold the end
        errors = os.open("/proc/self/fd/2", os.O_WRONLY | os.O_NONBLOCK | os.O_APPEND)
        faulthandler.register(signal.SIGALRM, file=errors, chain=True)
    _armed.set()


def told_to_end() -> bool:
    """Whether this process has been told to end, since ``end_when_told``."""
    return _armed.is_set() and signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
