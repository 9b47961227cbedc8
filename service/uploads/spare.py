"""Keeps a process of the intake (``service.uploads.spare_sandbox``) ready for the next upload."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from service.compute.processes import Process, kill, start_process

AFTER_S = 5.0  # between two looks, so that the start of a process does not slow the service's own start or an intake


class Spare:
    """Keeps at most one process of the intake ready, of some 60 MB, so that an upload need not wait for its start.
    Every ``AFTER_S`` it starts one if there is none and ``idle()`` says that no upload waits or runs."""

    def __init__(self, idle: Callable[[], bool]) -> None:
        self._idle, self._process = idle, None
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Starts the task that keeps a process ready."""
        self._task = asyncio.create_task(self._keep(), name="spare intake")

    def take(self) -> Process | None:
        """Returns the process that is ready, which then belongs to the caller; None if there is none."""
        process, self._process = self._process, None
        return process if process is not None and process.poll() is None else None

    def stop(self) -> None:
        """Ends the task and the process that is ready."""
        if self._task is not None:
            self._task.cancel()
        if (process := self.take()) is not None:
            kill(process)

    async def _keep(self) -> None:
        while True:
            await asyncio.sleep(AFTER_S)
            if (self._process is None or self._process.poll() is not None) and self._idle():
                self._process = start_process("service.uploads.spare_sandbox", quiet=True)
