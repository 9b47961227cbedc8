"""Changes that other services make in a shared folder of uploads: ``SharedFolder``."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from drape.errors import NotFound
from service.compute import garment_files
from service.compute.garments import set_aside

if TYPE_CHECKING:
    from drape.stages.scene import Entry
    from service.compute.drape_runtime import DrapeRuntime
    from service.stream.workers import Streams
    from service.uploads.jobs import Uploads

LEAST_S = 0.25  # between two looks, however many ask for what nobody knows

Found = TypeVar("Found")
log = logging.getLogger("drape.service")


class SharedFolder:
    """Takes over what other services change in the shared folder of uploads.

    It looks every ``DRAPE_GARMENTS_LOOK_S``, and when a request names a garment or an avatar that this service does not
    know. At 0 it never looks: the service has its folder alone.
    """

    def __init__(self, runtime: DrapeRuntime, streams: Streams, uploads: Uploads) -> None:
        self._runtime, self._streams, self._uploads = runtime, streams, uploads
        self._every_s = runtime.settings.garments_look_s
        self._turn = asyncio.Lock()
        self._begun_s = -LEAST_S  # the latest look
        self._known: dict[Path, tuple[int, int]] = {}  # when each file was written, as of the latest look
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begins to look."""
        if self._every_s:
            self._task = asyncio.create_task(self._go_on(), name="shared folder")

    async def stop(self) -> None:
        """Looks no more."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    @property
    def runs(self) -> bool:
        """Whether it looks; true as well where it need not."""
        return self._task is None or not self._task.done()

    async def found(self, asked: Callable[[], Found]) -> Found:
        """Returns ``asked()``. If that refuses a garment or an avatar as unknown, it is called again after a look."""
        try:
            return asked()
        except NotFound:
            if not self._every_s:
                raise
        await asyncio.shield(self.look())  # which others need whole
        return asked()

    async def look(self) -> None:
        """Takes over what changed. A call waits for the look of another where that began after the call."""
        asked_s = time.monotonic()
        async with self._turn:
            if self._begun_s >= asked_s:
                return
            await asyncio.sleep(self._begun_s + LEAST_S - time.monotonic())
            self._begun_s = time.monotonic()
            there = await asyncio.to_thread(garment_files.list_caches, self._runtime.settings.garments_dir)
            before, self._known = self._known, there
            entries = {entry.path: entry for entry in self._runtime.garments.entries() if entry.source == "user"}
            for path, entry in entries.items():
                if path is not None and path not in there and not path.exists():
                    self._runtime.garments.withdraw(entry)  # who is told that it is gone finds it gone
                    self._streams.end_wearing(entry)
                    await self._runtime.threads.aside(self._runtime.garments.forget, entry)
            for path, written in there.items():
                if before.get(path) != written:
                    await self._read_change(path, entries.get(path), written[0] != before.get(path, (0, 0))[0])
            await asyncio.to_thread(self._runtime.avatars.follow)

    async def _read_change(self, path: Path, entry: Entry | None, fresh: bool) -> None:
        """Lets the registry read ``path``, or, of a cache that is not ``fresh``, what is said of it."""
        registry = self._runtime.garments
        try:
            if entry is not None:
                registry.read_again(entry)
            elif fresh:
                registry.add(await self._runtime.threads.aside(registry.prepare, path), "user", path)
        except FileNotFoundError:  # removed meanwhile: the next look sees it
            return
        except Exception as error:  # whatever lies there, the look goes on
            set_aside(path, error)

    async def _go_on(self) -> None:
        while True:
            await asyncio.sleep(self._every_s)
            with contextlib.suppress(OSError):  # a folder on a network that is away for a moment
                await self.look()
                await self._uploads.follow()
