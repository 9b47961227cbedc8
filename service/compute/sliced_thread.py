"""Work that holds the interpreter lock, done by one thread in pieces of about a millisecond.

The event loop and the thread that drapes need the lock for every frame of every stream. Parsers and encoders of JSON
hold it until they are through, so they get one thread together, never two at a time, and what is long is cut.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

Result = TypeVar("Result")
# Of text to parse, and of numbers to copy: what so few cost the event loop is less than a turn of another thread.
BRIEF_TEXT, BRIEF_BYTES = 1 << 12, 1 << 18


class SlicedThread:
    """The thread; ``close`` ends it."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="drape-pieces")
        self._free = asyncio.Event()
        self._free.set()

    async def run(self, function: Callable[..., Result], *arguments: object) -> Result:
        """``function(*arguments)`` as one piece."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, partial(function, *arguments))

    async def brief(self, text: bytes, function: Callable[..., Result], *arguments: object) -> Result:
        """``function(*arguments)`` of a ``text``: at once where it is short, else as one piece."""
        return function(*arguments) if len(text) <= BRIEF_TEXT else await self.run(function, *arguments)

    async def each(self, pieces: Iterator[Result]) -> AsyncIterator[Result]:
        """All of ``pieces``, one turn of the thread for each: other work comes between them, and frames come first."""
        end = object()
        while True:
            await self._free.wait()
            if (piece := await self.run(next, pieces, end)) is end:
                return
            yield piece  # pyright: ignore[reportReturnType]

    @contextmanager
    def held(self) -> Iterator[None]:
        """While a stream's frame is computed, which asks for the lock some fifty times: no piece of ``each`` begins
        until this one, or another beside it, is through."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def close(self) -> None:
        """Ends the thread after the piece at hand."""
        self._executor.shutdown(wait=True, cancel_futures=True)
