"""The threads of a service, and which work comes first: streams.

``ComputeThreads`` drape frames of streams, and beside these one chunk of a clip at a time. A ``SlicedThread`` reads and
writes JSON.
"""

from __future__ import annotations

import asyncio
import contextvars
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import TypeVar

from service.compute.background import processor_count, thread_steps_back
from service.errors import Busy, Draining
from service.watch.watchdog import ThreadLane, say_moved

STREAM_WAIT_S = 0.02
"""The most that a chunk of a clip takes while there are streams, as they share processors. A chunk has a frame at
least."""
STREAM_PAUSE_S = 1.0
"""How long other work gives way to streams: after the last frame of a stream was begun, and while one is computed."""

APART = 2  # threads for pictures, reports and files, which hold the interpreter lock most of their time

CLIP_WAIT_S = 15.0  # a clip is never refused before it has waited so long for streams and other clips
CLIP_FPS = 1.0
"""The frames that a clip must get for every second that it waits beyond ``CLIP_WAIT_S``. Otherwise it is refused,
before its client gives up."""

BRIEF_TEXT, BRIEF_BYTES = 1 << 12, 1 << 18
"""The bytes of text that is parsed, and of numbers that are copied, on the event loop: so few take less time than
handing them to a thread."""

Result = TypeVar("Result")


class ComputeThreads:
    """The threads that compute: ``stream_threads`` for frames of streams (None: one for each processor), one for clips
    and constants of garments, which streams need not wait for, and ``APART`` for work that takes seconds for one
    client.

    A clip is computed in chunks of ``chunk_frames`` frames, or of as many as take ``STREAM_WAIT_S`` while there are
    streams. No step of a chunk begins while a stream's frame is computed.
    """

    def __init__(self, *, stream_threads: int | None, chunk_frames: int, clip_wait_s: float = CLIP_WAIT_S) -> None:
        self._chunk_most, self._clip_wait_s = chunk_frames, clip_wait_s
        self.hurried = False  # true when clips must be refused, as the service ends
        self.stream_threads = stream_threads or processor_count()
        self._for_streams = ThreadLane("streams", self.stream_threads)
        self._apart = ThreadLane("apart", APART)
        self._aside = ThreadLane("aside", 1, initializer=thread_steps_back)
        self.streamed_s = -math.inf  # when a frame of a stream was last begun
        self._frame_done = asyncio.Event()  # set once the latest frame of streams is computed
        self._frame_done.set()
        self.clip_turn = asyncio.Lock()  # one chunk waits for the thread at a time, however many clips there are

    def close(self) -> None:
        """Waits for the calls that run and ends the threads."""
        for executor in (self._for_streams, self._aside, self._apart):
            executor.shutdown(wait=True, cancel_futures=True)

    @property
    def streaming(self) -> bool:
        """Whether a frame of a stream was begun within the last ``STREAM_PAUSE_S``."""
        return time.monotonic() - self.streamed_s <= STREAM_PAUSE_S

    async def for_streams(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, which computes frames of streams, run on one of their threads."""
        done = self._frame_done = asyncio.Event()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._for_streams, _here(function, *arguments))
        finally:
            done.set()

    async def aside(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, run on the thread of clips and constants. It begins once the latest frame
        of streams is computed, or after ``STREAM_PAUSE_S``."""
        await _give_way(self._frame_done)
        return await asyncio.get_running_loop().run_in_executor(self._aside, _here(function, *arguments))

    async def apart(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, which takes seconds for one client, run on one of ``APART`` threads. A call
        that is cancelled while it waits for a thread is not made."""
        return await asyncio.get_running_loop().run_in_executor(self._apart, _here(function, *arguments))

    async def in_chunks(self, frames: int, compute: Callable[[slice], Iterator[Result]]) -> AsyncIterator[Result]:
        """Yields one result for each chunk of a clip of ``frames`` frames: the last item of ``compute(rows)``, where
        ``rows`` are the frames of the chunk. Items are computed by calls of ``aside``.

        Refuses (``Busy``) a clip that has waited too long for streams and other clips: ``clip_wait_s``, and a second
        more for every ``CLIP_FPS`` of its frames that are computed. Refuses (``Draining``) any clip once the service
        ends.
        """
        frame_s, start = math.inf, 0  # how long a frame takes is known after the first chunk
        waited_s = 0.0  # without the time in which the caller does not ask for a chunk
        while start < frames:
            if self.hurried:
                raise Draining
            begun_s = time.monotonic()
            async with self.clip_turn:
                self._check_wait(start, waited_s + time.monotonic() - begun_s)
                rows = slice(start, min(frames, start + self._chunk_frames(frame_s)))
                alone = rows.stop - rows.start == 1 and not self.streaming
                result, took_s = await self._last(compute(rows), whole=alone)
            waited_s += time.monotonic() - begun_s - took_s
            yield result
            frame_s, start = took_s / (rows.stop - rows.start), rows.stop

    def _check_wait(self, frames: int, waited_s: float) -> None:
        """Refuses a clip that has waited for ``waited_s`` while ``frames`` of it were computed."""
        most_s = self._clip_wait_s + frames / CLIP_FPS
        if waited_s > most_s:
            raise Busy(
                "processors",
                expected=f"{frames} frames of a clip after waiting {most_s:.0f} s for streams and other clips",
                got=f"{waited_s:.0f} s",
                cure="Ask again when there are fewer, or for fewer frames or a lower tier.",
            )

    async def _last(self, steps: Iterator[Result], *, whole: bool) -> tuple[Result, float]:
        """Returns the last of ``steps``, and how long they took [s]. Each runs ``aside`` in a turn of its own, or all
        in one turn if ``whole``."""
        took_s = 0.0

        def step() -> Result | None:
            nonlocal took_s
            say_moved()
            begun_s = time.perf_counter()
            result = next(steps, None)
            took_s += time.perf_counter() - begun_s
            return result

        def all_steps() -> Result | None:
            last = after = step()
            while after is not None:
                last, after = after, step()
            return last

        last = await self.aside(all_steps if whole else step)
        while not whole and (after := await self.aside(step)) is not None:
            last = after
        assert last is not None
        return last, took_s

    def _chunk_frames(self, frame_s: float) -> int:
        """Returns the number of frames of the next chunk, where one frame takes ``frame_s`` [s]."""
        if not self.streaming:
            return self._chunk_most
        return min(self._chunk_most, max(1, int(STREAM_WAIT_S / frame_s)))


class SlicedThread:
    """One thread for work that holds the interpreter lock, in pieces of about a millisecond.

    The event loop and the threads that drape need the lock for every frame of every stream. Parsers and encoders of
    JSON hold it until they end. So only one runs at a time, and long work is cut into pieces.
    """

    def __init__(self) -> None:
        self._executor = ThreadLane("pieces", 1, brief=True)
        self._free = asyncio.Event()
        self._free.set()

    async def run(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, run on this thread in one piece."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, partial(function, *arguments))

    async def brief(self, text: bytes, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, which works on ``text``: called here if that has at most ``BRIEF_TEXT``
        bytes, else on this thread."""
        return function(*arguments) if len(text) <= BRIEF_TEXT else await self.run(function, *arguments)

    async def run_pieces(self, pieces: Iterator[Result]) -> AsyncIterator[Result]:
        """Yields the items of ``pieces``, each computed on this thread in a turn of its own: other work may come
        between two, and frames of streams come first."""
        end, gives_way = object(), True
        while True:
            gives_way = gives_way and await _give_way(self._free)
            if (piece := await self.run(next, pieces, end)) is end:
                return
            yield piece  # pyright: ignore[reportReturnType]

    @contextmanager
    def hold_back(self) -> Iterator[None]:
        """Lets no piece of ``run_pieces`` begin while the block runs: a stream's frame is computed there, which asks
        for the interpreter lock some fifty times. After ``STREAM_PAUSE_S`` pieces begin nevertheless."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def close(self) -> None:
        """Waits for the piece that runs and ends the thread."""
        self._executor.shutdown(wait=True, cancel_futures=True)


async def _give_way(free: asyncio.Event) -> bool:
    """Waits until ``free`` is set, ``STREAM_PAUSE_S`` at most. Returns whether it is."""
    if not free.is_set():
        with suppress(TimeoutError):
            await asyncio.wait_for(free.wait(), STREAM_PAUSE_S)
    return free.is_set()


def _here(function: Callable[..., Result], *arguments: object) -> Callable[[], Result]:
    """Returns a call of ``function(*arguments)`` in a copy of the caller's context, which says whose request it is
    for."""
    return partial(contextvars.copy_context().run, partial(function, *arguments))
