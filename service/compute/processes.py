"""Processes of the service: the one place that starts them, without a handler of forks, and ends them.

``fork`` calls the handlers of ``pthread_atfork``. That of OpenBLAS waits for its threads, for ever where a thread of
ours has them at work. ``subprocess`` on Linux takes ``vfork`` or ``posix_spawn``, which call none, unless it gets a
``preexec_fn``, a ``user`` or a ``group``. asyncio under uvloop takes ``fork``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

from service.settings import ROOT
from service.watch.watchdog import JOBS, WatchedJob, spent_s

# One thread each: their stacks and buffers count against a memory limit.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
POLL_S = 0.01
Process = subprocess.Popen[bytes]
_started: weakref.WeakSet[Process] = weakref.WeakSet()


def start_process(module: str, *arguments: str, stdin: Any = subprocess.PIPE, quiet: bool = False) -> Process:
    """Starts ``python -m module`` in a session of its own, with a pipe as standard output, and returns the process. If
    it is ``quiet``, its errors are thrown away.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        cwd=ROOT,
        env=os.environ | ONE_THREAD,
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL if quiet else None,
        start_new_session=True,
    )
    _started.add(process)
    return process


def kill(process: Process) -> None:
    """Kills ``process`` and what it has started."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def kill_all() -> None:
    """Kills every process that ``start_process`` has started."""
    for process in tuple(_started):
        kill(process)


@asynccontextmanager
async def running(
    lane: str,
    module: str,
    *arguments: str,
    write: Callable[[IO[bytes]], Any],
    folder: Path,
    quiet: bool = False,
    waiting: Process | None = None,
) -> AsyncIterator[tuple[Process, asyncio.StreamReader]]:
    """Runs ``python -m module`` as a job of ``lane``; yields the process and its standard output. It is killed when the
    block ends.

    ``write`` writes its standard input into a file without a name in ``folder``, so that nobody waits until the process
    reads. ``waiting`` is a process that has been started ahead; it reads its arguments as a line of JSON before that.
    """
    if waiting is not None and await _handed(waiting, arguments, write):
        process = waiting
    else:
        with tempfile.TemporaryFile(dir=folder) as file:
            await asyncio.to_thread(write, file)
            file.flush()
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            process = start_process(module, *arguments, stdin=file, quiet=quiet)
    job, reader = WatchedJob(lane, [partial(spent_s, process.pid)]), asyncio.StreamReader()
    JOBS.add(job)
    pipe: asyncio.BaseTransport | None = None
    try:
        loop = asyncio.get_running_loop()
        pipe, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), process.stdout)
        yield process, reader
    finally:
        JOBS.discard(job)
        kill(process)
        if pipe is not None:
            pipe.close()
        await ended(process)


async def _handed(process: Process, arguments: Sequence[str], write: Callable[[IO[bytes]], Any]) -> bool:
    """Whether ``process`` took its ``arguments`` and what ``write`` writes; it is killed where it did not."""

    def hand() -> None:
        with process.stdin as stdin:  # pyright: ignore[reportOptionalContextManager]
            stdin.write(json.dumps(arguments).encode() + b"\n")
            write(stdin)

    handed = False
    try:
        await asyncio.to_thread(hand)
        handed = True
    except BrokenPipeError:
        pass
    finally:
        if not handed:
            kill(process)
    return handed


async def ended(process: Process) -> None:
    """Waits for the end of ``process``, without a thread."""
    while process.poll() is None:
        await asyncio.sleep(POLL_S)
