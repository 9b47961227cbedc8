"""Follows the changes that other services make in a shared folder of uploads: ``SharedFolder``."""

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

LEAST_S = 0.25  # the least time between two looks, however many requests name an unknown garment

Found = TypeVar("Found")
log = logging.getLogger("drape.service")


class SharedFolder:
    """Puts garments and avatars in service that other services add to the folder of uploads, and applies their changes.

    It looks at the folder every ``DRAPE_GARMENTS_LOOK_S``, and when a request names a garment or an avatar that this
    service does not know. At 0 it never looks, because no other service uses the folder.
    """

    def __init__(self, runtime: DrapeRuntime, streams: Streams, uploads: Uploads) -> None:
        self._runtime, self._streams, self._uploads = runtime, streams, uploads
        self._every_s = runtime.settings.garments_look_s
        self._turn = asyncio.Lock()
        self._begun_s = -LEAST_S  # when the latest look was begun
        self._known: dict[Path, tuple[int, int]] = {}  # what ``list_caches`` returned at the latest look
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Starts the task that looks at the folder, if there is an interval."""
        if self._every_s:
            self._task = asyncio.create_task(self._go_on(), name="shared folder")

    async def stop(self) -> None:
        """Ends the task that looks at the folder."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    @property
    def runs(self) -> bool:
        """Whether the task that looks at the folder runs, or is not needed."""
        return self._task is None or not self._task.done()

    async def look_up(self, find: Callable[[], Found]) -> Found:
        """Returns ``find()``. If that raises ``NotFound``, calls it again after a look at the folder."""
        try:
            return find()
        except NotFound:
            if not self._every_s:
                raise
        await asyncio.shield(self.look())  # other requests wait for the same look
        return find()

    async def look(self) -> None:
        """Applies the changes of the folder to the garments and avatars in service. A look that another call began
        after this call serves both."""
        called_s = time.monotonic()
        async with self._turn:
            if self._begun_s >= called_s:
                return
            await asyncio.sleep(self._begun_s + LEAST_S - time.monotonic())
            self._begun_s = time.monotonic()
            present = await asyncio.to_thread(garment_files.list_caches, self._runtime.settings.garments_dir)
            before, self._known = self._known, present
            entries = {entry.path: entry for entry in self._runtime.garments.entries() if entry.source == "user"}
            for path, entry in entries.items():
                if path is not None and path not in present and not path.exists():
                    self._runtime.garments.withdraw(entry)  # before streams end, whose clients may ask for it again
                    self._streams.end_wearing(entry)
                    await self._runtime.threads.aside(self._runtime.garments.forget, entry)
            for path, written in present.items():
                if before.get(path) != written:
                    await self._read_change(path, entries.get(path), written[0] != before.get(path, (0, 0))[0])
            await asyncio.to_thread(self._runtime.avatars.follow)

    async def _read_change(self, path: Path, entry: Entry | None, fresh: bool) -> None:
        """Puts the cache ``path`` in service if it is ``fresh``; if it is in service as ``entry``, reads its ``About``
        again."""
        registry = self._runtime.garments
        try:
            if entry is not None:
                registry.read_again(entry)
            elif fresh:
                registry.add(await self._runtime.threads.aside(registry.prepare, path), "user", path)
        except FileNotFoundError:  # removed meanwhile: the next look sees it
            return
        except Exception as error:  # no file of another service may stop the look
            set_aside(path, error)

    async def _go_on(self) -> None:
        while True:
            await asyncio.sleep(self._every_s)
            with contextlib.suppress(OSError):  # a network folder may be away for a moment
                await self.look()
                await self._uploads.follow()
