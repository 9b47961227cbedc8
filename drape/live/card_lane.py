"""The lane of a graphics card: frames of many streams, gathered for two milliseconds and drawn by one launch.

A card may fail at any time: the frames of whoever waits for it, and all after, are the processor's.
"""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from drape.engine.card import Card
from drape.engine.card_frames import CardRecord, Pool
from drape.engine.card_jobs import FRAME_SCRATCH_BYTES, FrameLaunch
from drape.engine.packer import Record, Recorded
from drape.errors import DrapeError
from drape.live.card import for_card

GATHERED_S, MOST, THREADS = 0.002, 256, 512  # of a launch: how long it is waited for, frames, threads of each
LOST_S = 0.75  # without an answer: the card counts as failed

Found = TypeVar("Found")


@dataclass(frozen=True)
class LaneReport:
    """The state of a lane, for health and metrics.

    ``card`` is the card's name, and ``fault`` says why there is none. ``occupied`` is the share of its memory that is
    taken, and ``busy`` the share of the time since the start in which it computed. ``queue_s`` is the age of the oldest
    frame that waits. ``frames`` and ``launches`` count those so far.
    """

    card: str
    fault: str
    occupied: float
    busy: float
    queue_s: float
    frames: int
    launches: int

    @property
    def frames_a_launch(self) -> float:
        """Frames that a launch drew in the mean."""
        return self.frames / max(self.launches, 1)


class Slot:
    """A piece of ``size`` bytes of a lane's card, at an ``address``, as long as somebody has it."""

    def __init__(self, lane: Lane, size: int) -> None:
        self.lane, self.size, self.address = lane, size, lane.take(size)

    def read(self) -> np.ndarray | None:
        """Returns what is in it (size,) uint8; None if the card is gone."""
        piece = np.empty(self.size, np.uint8)
        return piece if self.lane.read(self.address, piece) else None

    def __del__(self) -> None:
        if hasattr(self, "address"):
            self.lane.give(self.size, self.address)


class Asked(Protocol):
    """Frames from their poses on that a lane is asked for; ``done`` once they are drawn or the card has failed."""

    done: threading.Event
    since_s: float

    def __len__(self) -> int: ...

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``."""
        ...

    def read(self, told: np.ndarray, back: np.ndarray) -> None:
        """Takes the frames from what those of the launch have ``told`` (F, TOLD), and from what came ``back``."""
        ...


class Lane:
    """The thread that gives frames to a card, which ``open_card`` opens. Its pool takes ``share`` of the free memory.

    Where there is no card, ``fault`` says why in a sentence, and the processor computes the frames.
    """

    def __init__(self, open_card: Callable[[], Card], *, share: float = 0.8) -> None:
        self._open, self._share, self._queue = open_card, share, queue.SimpleQueue[Asked | None]()
        self._ready, self._lock = threading.Event(), threading.Lock()
        self._busy_s, self._begun_s = 0.0, time.monotonic()
        self._gone = deque[CardRecord]()  # of cloths that nobody has any more
        self._kept = weakref.WeakKeyDictionary[Any, dict[str, Any]]()  # what is made of something for the card
        self._given = deque[tuple[int, int]]()  # sizes and addresses of slots that nobody has any more
        self._free: dict[int, list[int]] = {}  # slots by their size
        self._rows = self._out = (0, 0)  # addresses and sizes of what goes and comes
        self._scratch = 0
        self._waiting: list[Asked] = []
        self.card, self.fault, self.frames, self.launches = "", "", 0, 0
        self._pool: Pool | None = None
        self._card: Card | None = None
        self._thread = threading.Thread(target=self._work, name="card", daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Ends the thread once what waits is drawn."""
        self._queue.put(None)
        self._thread.join(LOST_S)

    @property
    def works(self) -> bool:
        """Whether frames are the card's."""
        return not self.fault

    @property
    def free_bytes(self) -> int:
        """The memory of the card that nobody has taken."""
        return 0 if self._pool is None else self._pool.free_bytes

    def report(self) -> LaneReport:
        """How the lane does."""
        pool, now_s = self._pool, time.monotonic()
        occupied = 0.0 if pool is None else 1.0 - pool.free_bytes / pool.size
        since_s = [job.since_s for job in list(self._waiting)]
        queue_s = max((now_s - one for one in since_s), default=0.0)
        busy = self._busy_s / max(now_s - self._begun_s, 1e-9)
        return LaneReport(self.card, self.fault, occupied, busy, queue_s, self.frames, self.launches)

    def ask(self, job: Asked) -> None:
        """Puts a ``job`` into the queue, for which ``wait_for`` waits."""
        job.since_s = time.monotonic()
        with self._lock:
            self._waiting.append(job)
            if self.fault:
                job.done.set()
        self._queue.put(job)

    def wait_for(self, job: Asked) -> None:
        """Waits until the frames of ``job`` are drawn, or the card has failed."""
        if not job.done.wait(job.since_s + LOST_S - time.monotonic()):
            self._fail(f"{self.card}: expected a frame within {LOST_S} s, got none")
        with self._lock:
            if job in self._waiting:
                self._waiting.remove(job)

    def read(self, address: int, numbers: np.ndarray) -> bool:
        """Fills the array ``numbers`` with what is at ``address``, from any thread. Returns whether the card works."""
        if self._card is None or self.fault:
            return False
        try:
            self._card.enter()
            self._card.read(address, numbers)
        except OSError as error:
            self._fail(f"{self.card}: {error}")
        return self.works

    def give(self, size: int, address: int) -> None:
        """Takes a slot of so many bytes back, from any thread."""
        self._given.append((size, address))

    # --- the card's thread ---

    def take(self, size: int) -> int:
        """Hands out a slot of so many bytes: its address. Raises ``MemoryError`` where there is no room."""
        assert self._pool is not None
        while self._given:
            given, address = self._given.popleft()
            self._free.setdefault(given, []).append(address)
        free = self._free.get(size)
        if free:
            return free.pop()
        try:
            return self._pool.take(size)
        except MemoryError:
            for address in (one for all_ in self._free.values() for one in all_):
                self._pool.give(address)
            self._free.clear()
            return self._pool.take(size)

    def write(self, address: int, numbers: np.ndarray) -> None:
        """Writes the array ``numbers`` to ``address``."""
        assert self._pool is not None
        self._pool.card.write(address, numbers)

    def kept(self, of: Any, name: str, make: Callable[[], Found]) -> Found:
        """What ``make`` makes of something for the card under a ``name``, as long as that lives."""
        known = self._kept.setdefault(of, {})
        if name not in known:
            known[name] = make()
        return known[name]

    def placed(self, of: Recorded) -> CardRecord:
        """The record of constants on the card, as long as they live."""
        return self.kept(of, "", lambda: self.place(of, of.record))

    def place(self, owner: Any, record: Record | Recorded, *beside: CardRecord) -> CardRecord:
        """Places ``record`` on the card, beside what is there already, until ``owner`` is gone."""
        assert self._pool is not None
        made = CardRecord(self._pool, record, beside=beside)
        weakref.finalize(owner, self._gone.append, made)
        return made

    def _launch(self, jobs: list[Asked]) -> None:
        """Draws the frames of ``jobs``, from their poses on."""
        assert self._pool is not None and self._card is not None
        if not self._scratch:
            self._groups = max(min(self._card.groups, self._pool.size // 4 // FRAME_SCRATCH_BYTES), 1)
            self._scratch = self._pool.take(self._groups * FRAME_SCRATCH_BYTES)
        launch = FrameLaunch(self._pool)
        for job in jobs:
            job.place(self, launch)
        self._rows, self._out = self._grown(self._rows, launch.row_bytes), self._grown(self._out, launch.out_bytes)
        launch.draw(self._rows[0], self._out[0], self._scratch, self._groups, THREADS)
        told, back = launch.outcomes(self._out[0])
        for job in jobs:
            job.read(told, back)
        self.frames, self.launches = self.frames + len(launch), self.launches + 1

    def _grown(self, piece: tuple[int, int], size: int) -> tuple[int, int]:
        """A ``piece`` of memory of at least so many bytes."""
        assert self._pool is not None
        if piece[1] >= size:
            return piece
        made = self._pool.take(2 * size), 2 * size  # where there is no room the old one stays
        if piece[1]:
            self._pool.give(piece[0])
        return made

    def _work(self) -> None:
        try:
            card = self._card = self._open()
            self._pool = Pool(card, int(self._share * card.free_bytes))
            self.card = card.name
        except (DrapeError, OSError) as error:
            self.fault = str(error)
        self._ready.set()
        while not self.fault and (jobs := self._gathered()):
            begun_s = time.monotonic()
            while self._gone:
                self._gone.popleft().give()
            try:
                self._launch(jobs)
            except OSError as error:
                self._fail(f"{self.card}: {error}")
            except MemoryError:  # these frames are the processor's
                pass
            self._busy_s += time.monotonic() - begun_s
            for job in jobs:
                job.done.set()

    def _gathered(self) -> list[Asked]:
        """The frames of the next launch; none at the end."""
        jobs: list[Asked] = []
        until_s = time.monotonic() + GATHERED_S
        while sum(map(len, jobs)) < MOST:
            try:
                left_s = until_s - time.monotonic()
                job = self._queue.get() if not jobs else self._queue.get(timeout=max(left_s, 0.0))
            except queue.Empty:
                break
            if job is None:
                if jobs:
                    self._queue.put(None)  # for the next time
                return jobs
            if not jobs:
                until_s = max(until_s, job.since_s + GATHERED_S)
            jobs.append(job)
        return jobs

    def cloth(self, cloth: Any) -> CardRecord:
        """The constants of folds on the card, as long as they live."""
        return self.kept(cloth, "folds", lambda: self.place(cloth, for_card(cloth)))

    def _fail(self, fault: str) -> None:
        """Gives the card up, with a sentence; all that wait go on by the processor."""
        with self._lock:
            self.fault = self.fault or fault
            for job in self._waiting:
                job.done.set()
