"""Starts and ends all processes of the service, without ``fork``.

``fork`` calls the handlers of ``pthread_atfork``. OpenBLAS's handler waits for its threads, for ever where one of our
threads uses them. ``subprocess`` on Linux takes ``vfork`` or ``posix_spawn``, which call no handlers, unless it gets a
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

# Each process computes with one thread, because the stacks and buffers of more count against its memory limit.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
POLL_S = 0.01
Process = subprocess.Popen[bytes]
_started: weakref.WeakSet[Process] = weakref.WeakSet()


def start_process(module: str, *arguments: str, stdin: Any = subprocess.PIPE, quiet: bool = False) -> Process:
    """Starts ``python -m module`` with ``arguments`` in a session of its own, with a pipe as standard output, and
    returns the process. With ``quiet`` its standard error is thrown away."""
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
    """Kills ``process`` and the processes of its group, unless it has ended."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def kill_all() -> None:
    """Kills every process that ``start_process`` has started."""
    for process in tuple(_started):
        kill(process)


@asynccontextmanager
async def run_process(
    lane: str,
    module: str,
    *arguments: str,
    write: Callable[[IO[bytes]], Any],
    folder: Path,
    quiet: bool = False,
    waiting: Process | None = None,
) -> AsyncIterator[tuple[Process, asyncio.StreamReader]]:
    """Runs ``python -m module`` with ``arguments`` while the block runs. Yields the process and its standard output.
    The process is a job of ``lane``, which the watchdog looks at, and is killed when the block ends.

    ``write(file)`` writes what the process reads as standard input. The file lies in ``folder`` without a name, so that
    ``write`` need not wait until the process reads. ``waiting`` is a process that was started earlier; it is used in
    place of a new one. Its standard input is a pipe, which gets ``arguments`` as a line of JSON first. If it has ended,
    a new process is started.
    """
    if waiting is not None and await _hand_over(waiting, arguments, write):
        process = waiting
    else:
        with tempfile.TemporaryFile(dir=folder) as file:
            await asyncio.to_thread(write, file)
            file.flush()
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            process = start_process(module, *arguments, stdin=file, quiet=quiet)
    job, reader = WatchedJob(lane, [partial(spent_s, process.pid)]), asyncio.StreamReader()
    JOBS.add(job)
    loop = asyncio.get_running_loop()
    # Cancelled on the way, uvloop closes the descriptor and leaves ``process.stdout`` open, which closes it again:
    # by then it may be that of another file.
    connecting = asyncio.ensure_future(
        loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), process.stdout)
    )
    try:
        await asyncio.shield(connecting)
        yield process, reader
    finally:
        JOBS.discard(job)
        kill(process)
        await asyncio.wait([connecting])
        if not connecting.cancelled() and connecting.exception() is None:
            connecting.result()[0].close()
        await wait_for_end(process)


async def _hand_over(process: Process, arguments: Sequence[str], write: Callable[[IO[bytes]], Any]) -> bool:
    """Sends ``arguments`` and what ``write`` writes to the standard input of ``process``. Returns whether it took them;
    a process that did not is killed."""

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


async def wait_for_end(process: Process) -> None:
    """Returns when ``process`` has ended. It looks every ``POLL_S``, without a thread."""
    while process.poll() is None:
        await asyncio.sleep(POLL_S)
