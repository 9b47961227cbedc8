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

# A launch waits so long for frames [s], takes so many at most, and gives each so many threads.
GATHERED_S, MOST, THREADS = 0.002, 256, 512
LOST_S = 0.75  # a card that does not answer for so long counts as failed

Made = TypeVar("Made")


@dataclass(frozen=True)
class LaneReport:
    """The state of a lane, for health and metrics.

    ``card`` is the card's name. ``fault`` says why the card is not used; it is empty if it is. ``occupied`` is the
    share of its memory that is taken, ``busy`` the share of the time since the start in which it computed. ``queue_s``
    [s] is the age of the oldest frame that waits, 0 if none does. ``frames`` and ``launches`` are counts since the
    start.
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
        """The mean number of frames in a launch; 0 before the first."""
        return self.frames / max(self.launches, 1)


class Slot:
    """A piece of ``size`` bytes at an ``address`` in the memory of a lane's card. When the object is deleted the lane
    has the piece again."""

    def __init__(self, lane: Lane, size: int) -> None:
        self.lane, self.size, self.address = lane, size, lane.take(size)

    def read(self) -> np.ndarray | None:
        """Returns a copy of the bytes of the piece (size,) uint8; None if the card is gone."""
        piece = np.empty(self.size, np.uint8)
        return piece if self.lane.read(self.address, piece) else None

    def __del__(self) -> None:
        if hasattr(self, "address"):
            self.lane.give(self.size, self.address)


class LaneJob(Protocol):
    """Frames that a lane is asked to compute; ``len`` gives their number. ``done`` is set once they are computed or the
    card has failed; ``since_s`` [s] is when they were asked for, by the monotonic clock."""

    done: threading.Event
    since_s: float

    def __len__(self) -> int: ...

    def place(self, lane: Lane, launch: FrameLaunch) -> None:
        """Adds the frames to ``launch``, with their memories on the card of ``lane``."""
        ...

    def read(self, results: np.ndarray, back: np.ndarray) -> None:
        """Takes the job's frames from a launch that has ended. ``results`` (L, TOLD) int64 has a row for each garment
        of each frame of the launch (``network.frame.read_results``); ``back`` (n,) uint8 are all bytes that it copied
        from the card."""
        ...


class Lane:
    """A thread that draws frames on the card which ``open_card`` opens. Its pool takes ``share`` of the card's free
    memory.

    ``fault`` is empty while the card works. Otherwise it says in a sentence why not, and the processor computes the
    frames.
    """

    def __init__(self, open_card: Callable[[], Card], *, share: float = 0.8) -> None:
        self._open, self._share, self._queue = open_card, share, queue.SimpleQueue[LaneJob | None]()
        self._ready, self._lock = threading.Event(), threading.Lock()
        self._busy_s, self._begun_s = 0.0, time.monotonic()
        self._gone = deque[CardRecord]()  # records of constants that nobody has any more
        self._kept = weakref.WeakKeyDictionary[Any, dict[str, Any]]()  # what was made for the card, of what
        self._given = deque[tuple[int, int]]()  # sizes and addresses of slots that nobody has any more
        self._free: dict[int, list[int]] = {}  # addresses of free slots by their size
        self._rows = self._out = (0, 0)  # address and size of the rows that go to the card, and of what comes back
        self._scratch = 0
        self._waiting: list[LaneJob] = []
        self.card, self.fault, self.frames, self.launches = "", "", 0, 0
        self._pool: Pool | None = None
        self._card: Card | None = None
        self._thread = threading.Thread(target=self._work, name="card", daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Ends the thread once all that waits is drawn."""
        self._queue.put(None)
        self._thread.join(LOST_S)

    @property
    def works(self) -> bool:
        """Whether the card draws frames."""
        return not self.fault

    @property
    def free_bytes(self) -> int:
        """The free memory of the card's pool, in bytes; 0 without a card."""
        return 0 if self._pool is None else self._pool.free_bytes

    def report(self) -> LaneReport:
        """Returns the state of the lane now."""
        pool, now_s = self._pool, time.monotonic()
        occupied = 0.0 if pool is None else 1.0 - pool.free_bytes / pool.size
        since_s = [job.since_s for job in list(self._waiting)]
        queue_s = max((now_s - begun_s for begun_s in since_s), default=0.0)
        busy = self._busy_s / max(now_s - self._begun_s, 1e-9)
        return LaneReport(self.card, self.fault, occupied, busy, queue_s, self.frames, self.launches)

    def ask(self, job: LaneJob) -> None:
        """Puts ``job`` into the queue and returns at once. After it ``wait_for`` must be called."""
        job.since_s = time.monotonic()
        with self._lock:
            self._waiting.append(job)
            if self.fault:
                job.done.set()
        self._queue.put(job)

    def wait_for(self, job: LaneJob) -> None:
        """Waits until the frames of ``job`` are drawn, or the card has failed. A card that takes ``LOST_S`` has
        failed."""
        if not job.done.wait(job.since_s + LOST_S - time.monotonic()):
            self._fail(f"{self.card}: expected a frame within {LOST_S} s, got none")
        with self._lock:
            if job in self._waiting:
                self._waiting.remove(job)

    def read(self, address: int, numbers: np.ndarray) -> bool:
        """Fills the array ``numbers`` with the card's memory at ``address``. Returns whether the card works. May be
        called from any thread."""
        if self._card is None or self.fault:
            return False
        try:
            self._card.enter()
            self._card.read(address, numbers)
        except OSError as error:
            self._fail(f"{self.card}: {error}")
        return self.works

    def give(self, size: int, address: int) -> None:
        """Takes back the slot of ``size`` bytes at ``address``. May be called from any thread."""
        self._given.append((size, address))

    # --- the card's thread ---

    def take(self, size: int) -> int:
        """Returns the address of a free slot of ``size`` bytes, which is taken then. Raises ``MemoryError`` where there
        is no room."""
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
            for address in (address for own in self._free.values() for address in own):
                self._pool.give(address)
            self._free.clear()
            return self._pool.take(size)

    def write(self, address: int, numbers: np.ndarray) -> None:
        """Writes the array ``numbers`` to the card's memory at ``address``."""
        assert self._pool is not None
        self._pool.card.write(address, numbers)

    def cached(self, of: Any, name: str, make: Callable[[], Made]) -> Made:
        """Returns what ``make`` returns, and the same object under this ``name`` as long as ``of`` lives."""
        known = self._kept.setdefault(of, {})
        if name not in known:
            known[name] = make()
        return known[name]

    def place_constants(self, of: Recorded) -> CardRecord:
        """Returns the record ``of`` on the card, where it stays as long as ``of`` lives."""
        return self.cached(of, "", lambda: self.place(of, of.record))

    def place(self, owner: Any, record: Record | Recorded, *beside: CardRecord) -> CardRecord:
        """Returns ``record`` as written to the card, where it stays until ``owner`` is gone. It may point into the
        records ``beside``, which are there already."""
        assert self._pool is not None
        placed = CardRecord(self._pool, record, beside=beside)
        weakref.finalize(owner, self._gone.append, placed)
        return placed

    def _launch(self, jobs: list[LaneJob]) -> None:
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
        results, back = launch.outcomes(self._out[0])
        for job in jobs:
            job.read(results, back)
        self.frames, self.launches = self.frames + len(launch), self.launches + 1

    def _grown(self, piece: tuple[int, int], size: int) -> tuple[int, int]:
        """A ``piece`` of memory of at least so many bytes."""
        assert self._pool is not None
        if piece[1] >= size:
            return piece
        larger = self._pool.take(2 * size), 2 * size  # where this raises, the old piece stays
        if piece[1]:
            self._pool.give(piece[0])
        return larger

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
            except MemoryError:  # the processor computes these frames
                pass
            self._busy_s += time.monotonic() - begun_s
            for job in jobs:
                job.done.set()

    def _gathered(self) -> list[LaneJob]:
        """The frames of the next launch; none at the end."""
        jobs: list[LaneJob] = []
        until_s = time.monotonic() + GATHERED_S
        while sum(map(len, jobs)) < MOST:
            try:
                left_s = until_s - time.monotonic()
                job = self._queue.get() if not jobs else self._queue.get(timeout=max(left_s, 0.0))
            except queue.Empty:
                break
            if job is None:
                if jobs:
                    self._queue.put(None)  # ends the thread at the next call
                return jobs
            if not jobs:
                until_s = max(until_s, job.since_s + GATHERED_S)
            jobs.append(job)
        return jobs

    def place_cloth(self, cloth: Any) -> CardRecord:
        """Returns the constants of folds ``cloth`` on the card, where they stay as long as ``cloth`` lives."""
        return self.cached(cloth, "folds", lambda: self.place(cloth, for_card(cloth)))

    def _fail(self, fault: str) -> None:
        """Gives the card up, with a sentence; all that wait go on by the processor."""
        with self._lock:
            self.fault = self.fault or fault
            for job in self._waiting:
                job.done.set()
