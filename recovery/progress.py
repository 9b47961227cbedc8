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
    """A clock with a stage and its detail; ``limit_s`` None is no limit. ``write`` takes a line."""

    def __init__(self, write: Say, *, limit_s: float | None = None, every_s: float = EVERY_S) -> None:
        self.write, self.limit_s, self.every_s = write, limit_s, every_s
        self.started = self.spoken = time.monotonic()
        self.stage, self.detail = "recovery", ""
        self.stopped_in = ""  # the first stage that asked after the end
        self._lock = threading.Lock()

    @property
    def elapsed_s(self) -> float:
        """Seconds [s] since the start."""
        return time.monotonic() - self.started

    @property
    def over(self) -> bool:
        """Whether the limit has passed."""
        ended = self.limit_s is not None and self.elapsed_s >= self.limit_s
        if ended and not self.stopped_in:
            self.stopped_in = self.stage
        return ended

    def tick(self, detail: str = "") -> None:
        """Notes how far the stage is; writes a line if the last one is ``every_s`` old."""
        self.detail = detail
        self.speak_if_due()

    def enter(self, stage: str) -> None:
        """Says that ``stage`` begins, in a line if one is due."""
        self.stage, self.detail = stage, ""
        self.speak_if_due()

    def speak_if_due(self) -> None:
        """Writes where the work is, unless a line came within ``every_s``."""
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
    """Watches the work inside: at most about ``every_s`` [s] pass without a line, and ``over`` is true at the limit."""
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
    """Calls the work inside ``name``; the stage around it goes on after it."""
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
    """Inside, the limit ends after ``share`` of the whole time, so that the rest is left for what follows."""
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
    """Tells the watch around, if there is one, how far its stage is."""
    if _watches:
        _watches[-1].tick(detail)


def over() -> bool:
    """Whether the time of the work is up: a loop then ends with the best it has."""
    return bool(_watches) and _watches[-1].over
