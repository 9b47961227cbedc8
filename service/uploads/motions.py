"""Reads motion files of strangers in a process with limits (``service.uploads.sandbox``), and keeps nothing of them."""

from __future__ import annotations

import asyncio
import math
import shutil
import uuid
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

from drape.errors import MotionError
from service.errors import Busy
from service.uploads.intake_process import run_sandbox

if TYPE_CHECKING:
    from service.settings import Settings
    from service.uploads.jobs import Uploads

READ_S = 60.0  # the most for one file; a minute's motion takes a second
MEMORY_MB = 1024  # the most for one file, as an intake and a clip of tier exact may run beside it


class MotionFiles:
    """Reads motion files, one at a time; ``intake_queue`` may wait. A file lies in the staging folder of ``uploads``
    until it is read."""

    def __init__(self, uploads: Uploads, settings: Settings) -> None:
        limits = {"intake_wall_s": READ_S, "intake_cpu_s": math.ceil(READ_S)}
        limits["intake_memory_mb"] = min(settings.intake_memory_mb, MEMORY_MB)
        self._uploads, self._settings = uploads, settings.model_copy(update=limits)
        self._turn = asyncio.Semaphore()
        self._waiting = 0

    async def read(self, name: str, pieces: AsyncIterator[bytes], clip: str | None) -> bytes:
        """Returns the bytes of an npz file (``MotionClip.save``) with the clip called ``clip``, None for the longest,
        of the file ``name`` whose bytes are ``pieces``.

        The suffix of ``name`` is one that ``drape.motion.readers`` reads. Raises what the reader refuses, ``Busy``
        where too many files wait, and ``TooLarge`` at the limits of memory and time.
        """
        if self._waiting >= self._settings.intake_queue:
            expected = f"fewer than {self._settings.intake_queue} waiting"
            raise Busy("motions", expected=expected, got=str(self._waiting), cure="Try again in a few seconds.")
        self._waiting += 1
        folder = self._uploads.staging / f"motion-{uuid.uuid4().hex[:12]}"
        try:
            if not await self._uploads.store(folder / name, pieces):
                cure = "Send the file as the body."
                raise MotionError("request body", expected="the bytes of a motion file", got="nothing", cure=cure)
            async with self._turn:
                report = await run_sandbox(folder / name, clip, folder / "out", self._settings, kind="motion")
            return await asyncio.to_thread((folder / "out" / report["files"][0]).read_bytes)
        finally:
            self._waiting -= 1
            await asyncio.shield(asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True))
