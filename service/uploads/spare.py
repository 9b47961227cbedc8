"""A process of the intake that waits for the next upload (``service.uploads.spare_sandbox``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from service.compute.processes import Process, kill, start_process

AFTER_S = 5.0  # so long nothing is taken in before one begins, that what starts or works is left alone


class Spare:
    """At most one process that waits, of some 60 MB; it begins ``AFTER_S`` after a look that found nothing taken in."""

    def __init__(self, idle: Callable[[], bool]) -> None:
        self._idle, self._process = idle, None
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Looks from now on whether one is missing."""
        self._task = asyncio.create_task(self._keep(), name="spare intake")

    def take(self) -> Process | None:
        """The process that waits, which is the caller's from here on; None where none does."""
        process, self._process = self._process, None
        return process if process is not None and process.poll() is None else None

    def stop(self) -> None:
        """Ends what waits."""
        if self._task is not None:
            self._task.cancel()
        if (process := self.take()) is not None:
            kill(process)

    async def _keep(self) -> None:
        while True:
            await asyncio.sleep(AFTER_S)
            if (self._process is None or self._process.poll() is not None) and self._idle():
                self._process = start_process("service.uploads.spare_sandbox", quiet=True)
