"""Standard output and error that never wait for their reader: ``free_outputs``.

What is written there (log lines, prints, what libraries and child processes say) goes through pipes to a process that
does the waiting: for a reader that stalls, for room on a disk. It keeps the latest ``KEPT_BYTES``, and tells how many
lines it dropped once they flow again. A thread of the service would not do: ``faulthandler`` writes with the
interpreter lock in its hands, and the last words of a process that crashes would be lost.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import deque

KEPT_BYTES = 128 * 1024  # of each output: some 600 lines
LINE_BYTES = 16 * 1024  # a longer one is cut
LAST_S = 1.0  # for what is kept when the service has ended
TURN_S = 0.05  # for a reader that takes lines, but has waited for a processor
COUNTS = struct.Struct("<2Q")  # lines dropped of standard output and of standard error
_counts: list[int] = []  # the file that has them


def log_time(at_s: float) -> str:
    """The time ``at_s`` [s since 1970] as log lines have it: UTC, to the millisecond."""
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(at_s)) + f".{int(at_s % 1.0 * 1e3):03d}Z"


def free_outputs(form: str) -> None:
    """Sends standard output and error through a process of their own, which says of dropped lines in this ``form``,
    json or text."""
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:  # an output that is closed has no reader
        pass
    counts = os.memfd_create("dropped") if sys.platform == "linux" else os.dup(spare)
    os.close(spare)
    (source, entry), (error_source, error_entry) = os.pipe(), os.pipe()
    ends = counts, source, os.dup(1), error_source, os.dup(2)
    command = [sys.executable, "-I", "-S", __file__, form, *map(str, ends)]
    nothing = subprocess.DEVNULL
    process = subprocess.Popen(
        command, stdin=nothing, stdout=nothing, stderr=nothing, pass_fds=ends, start_new_session=True
    )
    os.dup2(entry, 1)
    os.dup2(error_entry, 2)
    for end in (entry, error_entry, *ends[1:]):
        os.close(end)
    _counts[:] = [counts]
    atexit.register(_end, process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Waits until ``process`` has handed on the last lines; not for long."""
    for file in filter(None, (sys.stdout, sys.stderr)):
        file.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(2.0 * LAST_S)


def dropped_lines() -> int:
    """Lines that were dropped since ``free_outputs``; 0 where the system is not Linux."""
    told = os.pread(_counts[0], COUNTS.size, 0) if _counts else b""
    return sum(COUNTS.unpack(told.ljust(COUNTS.size, b"\0")))


def _note(lines: int, form: str) -> bytes:
    message, now_s = f"{lines} lines were dropped: nobody took them", time.time()
    told = {"time": log_time(now_s), "level": "warning", "logger": "drape.outputs", "message": message}
    text = f"{time.strftime('%H:%M:%S', time.localtime(now_s))} WARNING {message}"
    return (json.dumps(told) if form == "json" else text).encode() + b"\n"


def _hand_on(source: int, target: int, form: str, counts: int, place: int) -> None:
    """Hands lines on from ``source`` to ``target`` until nobody can write any more; then what is kept, for
    ``LAST_S``. Their dropped lines are the number at ``place`` of ``counts``."""
    kept: deque[bytes] = deque()
    news, size, dropped, stalled = threading.Condition(), 0, 0, False

    def drop() -> None:
        nonlocal dropped
        dropped += 1
        with contextlib.suppress(OSError):  # where no file may be written at all
            os.pwrite(counts, struct.pack("<Q", dropped), 8 * place)

    def write() -> None:
        nonlocal size, stalled
        reported, begun = 0, b""  # the latter ends a line that the disk took a part of
        while True:
            with news:
                news.wait_for(lambda: len(kept) > 0)
                line, missing = kept.popleft(), dropped - reported
            left = whole = begun + _note(missing, form) + line if missing else line
            while left:
                try:
                    left = left[os.write(target, left) :]
                except BlockingIOError:  # its other users do not wait
                    select.select([], [target], [])
                except OSError:  # a full disk, a reader that has gone
                    break
            begun = b"\n" if left and left != whole else b""
            with news:
                size, stalled = size - len(line), False
                news.notify_all()
                if left:
                    drop()
                else:
                    reported += missing

    def fits() -> bool:
        return size <= KEPT_BYTES

    threading.Thread(target=write, daemon=True).start()
    with os.fdopen(source, "rb") as lines:
        while line := lines.readline(LINE_BYTES):
            with news:
                kept.append(line)
                size += len(line)
                news.notify_all()
                if not fits() and not stalled and select.select([], [target], [], 0.0)[1]:
                    stalled = not news.wait_for(fits, TURN_S)
                while not fits() and len(kept) > 1:
                    size -= len(kept.popleft())
                    drop()
    until_s = time.monotonic() + LAST_S
    while size and time.monotonic() < until_s:
        time.sleep(0.01)


def main() -> None:
    """Hands on what the service and its children write, until all of them have ended."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):  # who ends the service ends it first
        signal.signal(number, signal.SIG_IGN)
    form, (counts, *ends) = sys.argv[1], map(int, sys.argv[2:])
    ways = [(*ends[:2], form, counts, 0), (*ends[2:], form, counts, 1)]
    outputs = [threading.Thread(target=_hand_on, args=way) for way in ways]
    for output in outputs:
        output.start()
    for output in outputs:
        output.join()
    os._exit(0)  # a thread may still wait


if __name__ == "__main__":
    main()
