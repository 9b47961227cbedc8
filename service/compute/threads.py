"""The threads of a service, and whose turn it is: streams come first.

``ComputeThreads`` drape, and beside streams one chunk of a clip at a time. The ``SlicedThread`` reads and writes JSON.
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
"""What a chunk of a clip may take while there are streams, which share processors with it; one frame is the least."""
STREAM_PAUSE_S = 1.0
"""Longer after the last frame of a stream nothing gives way to streams any more, nor to a frame that takes longer."""

APART = 2  # threads for pictures, reports and files, which hold the interpreter lock most of their time

CLIP_WAIT_S = 15.0  # that a clip waits for streams and other clips before it is refused, at least
CLIP_FPS = 1.0
"""Frames that a clip gets for every second of waiting, after ``CLIP_WAIT_S``; otherwise it is refused, before its
client gives up."""

BRIEF_TEXT, BRIEF_BYTES = 1 << 12, 1 << 18
"""Of text to parse, and of numbers to copy: what so few cost the event loop is less than a turn of another thread."""

Result = TypeVar("Result")


class ComputeThreads:
    """``stream_threads`` have the frames of streams and nothing else, one for each processor unless the settings say
    how many. Another has all that streams need not wait for: clips, measurements of frames, constants of garments.

    Clips are computed in chunks of ``chunk_frames``; while there are streams, of as many as take ``STREAM_WAIT_S``. No
    step of a chunk begins while a stream's frame is computed.
    """

    def __init__(self, *, stream_threads: int | None, chunk_frames: int, clip_wait_s: float = CLIP_WAIT_S) -> None:
        self._chunk_most, self._clip_wait_s = chunk_frames, clip_wait_s
        self.hurried = False  # clips end now: the service is being restarted
        self.stream_threads = stream_threads or processor_count()
        self._for_streams = ThreadLane("streams", self.stream_threads)
        self._apart = ThreadLane("apart", APART)
        self._aside = ThreadLane("aside", 1, initializer=thread_steps_back)
        self.streamed_s = -math.inf  # when a frame of a stream was last begun
        self._frame_done = asyncio.Event()  # of the streams' latest frame
        self._frame_done.set()
        self.clip_turn = asyncio.Lock()  # one chunk waits for the thread at a time, however many clips there are

    def close(self) -> None:
        """Waits for the running chunk and ends the threads."""
        for executor in (self._for_streams, self._aside, self._apart):
            executor.shutdown(wait=True, cancel_futures=True)

    @property
    def streaming(self) -> bool:
        """Whether the computing of a stream's frame has begun within the last ``STREAM_PAUSE_S``."""
        return time.monotonic() - self.streamed_s <= STREAM_PAUSE_S

    async def for_streams(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Runs ``function(*arguments)``, which computes frames of streams, on one of their threads, and returns its
        result.
        """
        done = self._frame_done = asyncio.Event()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._for_streams, _here(function, *arguments))
        finally:
            done.set()

    async def aside(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, computed on the thread of what streams need not wait for. It begins only
        when no frame of a stream is being computed."""
        await _given_way(self._frame_done)
        return await asyncio.get_running_loop().run_in_executor(self._aside, _here(function, *arguments))

    async def apart(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, which takes seconds for one client, computed on one of ``APART`` threads:
        others need not wait for it. A client that leaves the queue is passed over."""
        return await asyncio.get_running_loop().run_in_executor(self._apart, _here(function, *arguments))

    async def in_chunks(self, frames: int, compute: Callable[[slice], Iterator[Result]]) -> AsyncIterator[Result]:
        """Yields for each chunk of ``frames`` the last result that ``compute`` yields of it; every step has its turn on
        the thread of clips.

        Refuses (``Busy``) a clip that has waited for streams and other clips for ``clip_wait_s``, and a second more for
        every ``CLIP_FPS`` frames that it has got.
        """
        frame_s, start = math.inf, 0  # until the first has told how long one takes
        waited_s = 0.0  # for a turn; not for whoever asks to read
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
        """The last of ``steps``, each ``aside`` in its turn, or all in one, and how long they took there [s]."""
        took_s = 0.0

        def step() -> Result | None:
            nonlocal took_s
            say_moved()
            begun_s = time.perf_counter()
            result = next(steps, None)
            took_s += time.perf_counter() - begun_s
            return result

        def through() -> Result | None:
            last = found = step()
            while found is not None:
                last, found = found, step()
            return last

        last = await self.aside(through if whole else step)
        while not whole and (after := await self.aside(step)) is not None:
            last = after
        assert last is not None
        return last, took_s

    def _chunk_frames(self, frame_s: float) -> int:
        """Frames of the next chunk, where one takes ``frame_s`` [s]."""
        if not self.streaming:
            return self._chunk_most
        return min(self._chunk_most, max(1, int(STREAM_WAIT_S / frame_s)))


class SlicedThread:
    """Work that holds the interpreter lock, done by one thread in pieces of about a millisecond; ``close`` ends it.

    The event loop and the threads that drape need the lock for every frame of every stream. Parsers and encoders of
    JSON hold it until they are through, so they get one thread together, never two at a time, and what is long is cut.
    """

    def __init__(self) -> None:
        self._executor = ThreadLane("pieces", 1, brief=True)
        self._free = asyncio.Event()
        self._free.set()

    async def run(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns the result of ``function(*arguments)``, computed on this thread in one piece."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, partial(function, *arguments))

    async def brief(self, text: bytes, function: Callable[..., Result], *arguments: object) -> Result:
        """Returns ``function(*arguments)``, which works on ``text``: computed at once where the text is short, else as
        one piece of the thread's work.
        """
        return function(*arguments) if len(text) <= BRIEF_TEXT else await self.run(function, *arguments)

    async def each(self, pieces: Iterator[Result]) -> AsyncIterator[Result]:
        """Yields the results of ``pieces``, each computed in a turn of its own: other work comes between them, and
        frames come first."""
        end, gives_way = object(), True
        while True:
            gives_way = gives_way and await _given_way(self._free)
            if (piece := await self.run(next, pieces, end)) is end:
                return
            yield piece  # pyright: ignore[reportReturnType]

    @contextmanager
    def held(self) -> Iterator[None]:
        """Holds the thread back while a stream's frame is computed, which asks for the lock some fifty times. No piece
        of ``each`` begins before the last such block has ended."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def close(self) -> None:
        """Ends the thread after the piece at hand."""
        self._executor.shutdown(wait=True, cancel_futures=True)


async def _given_way(free: asyncio.Event) -> bool:
    """Waits until ``free`` is set, and for no longer than ``STREAM_PAUSE_S``: whether it is."""
    if not free.is_set():
        with suppress(TimeoutError):
            await asyncio.wait_for(free.wait(), STREAM_PAUSE_S)
    return free.is_set()


def _here(function: Callable[..., Result], *arguments: object) -> Callable[[], Result]:
    """``function(*arguments)`` in a copy of the caller's context, for another thread: whose request it is for."""
    return partial(contextvars.copy_context().run, partial(function, *arguments))
