"""The progress of a long command and its time limit: one place that every loop of recovery tells how far it is.

A command watches its work with ``watched``. Loops call ``tick`` with a few words and ask ``over`` whether to stop.
A line is written after ``EVERY_S`` seconds without one. A thread writes it where a loop takes longer for one round, so
that nothing is silent. Outside ``watched`` both do nothing, and nothing is ever over.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

EVERY_S = 5.0
Say = Callable[[str], None]


class Watch:
    """The progress of a piece of work: the current ``stage``, a ``detail`` of it in words, and the time since the
    start. ``write`` gets lines of progress, mostly one in ``every_s`` [s]. ``limit_s`` [s] is the work's time limit,
    None for none."""

    def __init__(self, write: Say, *, limit_s: float | None = None, every_s: float = EVERY_S) -> None:
        self.write, self.limit_s, self.every_s = write, limit_s, every_s
        self.started = self.spoken = time.monotonic()
        self.stage, self.detail = "recovery", ""
        self.stopped_in = ""  # the first stage that asked after the end
        self._lock = threading.Lock()

    @property
    def elapsed_s(self) -> float:
        """Time [s] since the start."""
        return time.monotonic() - self.started

    @property
    def over(self) -> bool:
        """Whether the time limit has passed. The first time, ``stopped_in`` takes the current stage."""
        ended = self.limit_s is not None and self.elapsed_s >= self.limit_s
        if ended and not self.stopped_in:
            self.stopped_in = self.stage
        return ended

    def tick(self, detail: str = "") -> None:
        """Sets the ``detail`` of the current stage; writes a line if the last one is ``every_s`` old."""
        self.detail = detail
        self.speak_if_due()

    def enter(self, stage: str) -> None:
        """Makes ``stage`` the current one, without a detail; writes a line if the last one is ``every_s`` old."""
        self.stage, self.detail = stage, ""
        self.speak_if_due()

    def speak_if_due(self) -> None:
        """Writes a line with time [s], stage and detail if the last one is ``every_s`` old."""
        with self._lock:
            now = time.monotonic()
            if now - self.spoken < self.every_s:
                return
            self.spoken = now
        detail = f": {self.detail}" if self.detail else ""
        self.write(f"{now - self.started:6.0f} s  {self.stage}{detail}")


_watches: list[Watch] = []  # the innermost last; a command has one


def to_stderr(line: str) -> None:
    """Writes ``line`` on standard error at once."""
    print(line, file=sys.stderr, flush=True)


@contextmanager
def watched(*, write: Say = to_stderr, limit_s: float | None = None, every_s: float = EVERY_S) -> Iterator[Watch]:
    """Yields the ``Watch`` of the work inside.

    A thread makes it write in long loops, so that at most about 1.5 ``every_s`` [s] pass without a line. ``over`` is
    true from ``limit_s`` [s] on.
    """
    watch, done = Watch(write, limit_s=limit_s, every_s=every_s), threading.Event()

    def speak() -> None:
        while not done.wait(0.5 * every_s):
            watch.speak_if_due()

    thread = threading.Thread(target=speak, daemon=True, name="progress")
    _watches.append(watch)
    thread.start()
    try:
        yield watch
    finally:
        done.set()
        thread.join()
        _watches.remove(watch)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Names the stage of the work inside ``name``, in the innermost watch; afterwards stage and detail are those of
    before."""
    if not _watches:
        yield
        return
    watch = _watches[-1]
    before = watch.stage, watch.detail
    watch.enter(name)
    try:
        yield
    finally:
        watch.stage, watch.detail = before


@contextmanager
def limit_share(share: float) -> Iterator[None]:
    """Multiplies the time limit of the innermost watch by ``share`` for the work inside; does nothing where there is no
    limit."""
    watch = _watches[-1] if _watches else None
    limit_s = watch.limit_s if watch is not None else None
    if watch is None or limit_s is None:
        yield
        return
    watch.limit_s = share * limit_s
    try:
        yield
    finally:
        watch.limit_s = limit_s


def tick(detail: str = "") -> None:
    """Sets the ``detail`` of the current stage in the innermost watch, which may write a line; does nothing without a
    watch."""
    if _watches:
        _watches[-1].tick(detail)


def over() -> bool:
    """Whether the time limit of the innermost watch has passed; False without a watch."""
    return bool(_watches) and _watches[-1].over
