"""Makes writing to standard output and error never wait for a reader: ``free_outputs``.

All that this process, its libraries and its child processes write goes through pipes to another process, which waits
for a reader that stalls or a disk that is full. It keeps the latest ``KEPT_BYTES``, and reports how many lines it has
dropped once they flow again. A thread of the service could not do this: ``faulthandler`` writes while it holds the
interpreter lock, and the last lines of a process that crashes would be lost.
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

KEPT_BYTES = 128 * 1024  # the most that waits, for each output: some 600 lines
LINE_BYTES = 16 * 1024  # longer lines are cut
LAST_S = 1.0  # the time for the last lines once the service has ended
TURN_S = 0.05  # the time for a reader that takes lines but waits for a processor
COUNTS = struct.Struct("<2Q")  # the numbers of dropped lines of standard output and of standard error
_counts: list[int] = []  # the file descriptor of the numbers, once ``free_outputs`` has run


def log_time(at_s: float) -> str:
    """Returns the time ``at_s`` [s since 1970] as text for log lines: ISO 8601, UTC, to the millisecond."""
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(at_s)) + f".{int(at_s % 1.0 * 1e3):03d}Z"


def free_outputs(form: str) -> None:
    """Makes writing to standard output and error never wait: starts a process that takes all lines and passes them on.
    It drops lines while nobody reads them, and reports how many in the format ``form``, "json" or "text"."""
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:  # an output that is closed is opened to nothing
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
    """Waits until ``process`` has handed on the last lines, at most ``2 LAST_S``."""
    for file in filter(None, (sys.stdout, sys.stderr)):
        file.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(2.0 * LAST_S)


def dropped_lines() -> int:
    """Returns how many lines of both outputs were dropped since ``free_outputs``; always 0 on other systems than
    Linux."""
    raw = os.pread(_counts[0], COUNTS.size, 0) if _counts else b""
    return sum(COUNTS.unpack(raw.ljust(COUNTS.size, b"\0")))


def _note(lines: int, form: str) -> bytes:
    message, now_s = f"{lines} lines were dropped: nobody took them", time.time()
    record = {"time": log_time(now_s), "level": "warning", "logger": "drape.outputs", "message": message}
    text = f"{time.strftime('%H:%M:%S', time.localtime(now_s))} WARNING {message}"
    return (json.dumps(record) if form == "json" else text).encode() + b"\n"


def _hand_on(source: int, target: int, form: str, counts: int, place: int) -> None:
    """Hands lines on from the file ``source`` to ``target`` until all writers have closed it, and then those that wait,
    for ``LAST_S``. Writes the number of dropped lines as number ``place`` of the file ``counts``."""
    waiting: deque[bytes] = deque()
    news, size, dropped, stalled = threading.Condition(), 0, 0, False

    def drop() -> None:
        nonlocal dropped
        dropped += 1
        with contextlib.suppress(OSError):  # the process may be forbidden to write files
            os.pwrite(counts, struct.pack("<Q", dropped), 8 * place)

    def write() -> None:
        nonlocal size, stalled
        reported, line_end = 0, b""  # the end of a line of which only a part was written
        while True:
            with news:
                news.wait_for(lambda: len(waiting) > 0)
                line, missing = waiting.popleft(), dropped - reported
            rest = whole = line_end + _note(missing, form) + line if missing else line
            while rest:
                try:
                    rest = rest[os.write(target, rest) :]
                except BlockingIOError:  # another program has made the file non-blocking
                    select.select([], [target], [])
                except OSError:  # a full disk, a reader that has gone
                    break
            line_end = b"\n" if rest and rest != whole else b""
            with news:
                size, stalled = size - len(line), False
                news.notify_all()
                if rest:
                    drop()
                else:
                    reported += missing

    def fits() -> bool:
        return size <= KEPT_BYTES

    threading.Thread(target=write, daemon=True).start()
    with os.fdopen(source, "rb") as lines:
        while line := lines.readline(LINE_BYTES):
            with news:
                waiting.append(line)
                size += len(line)
                news.notify_all()
                if not fits() and not stalled and select.select([], [target], [], 0.0)[1]:
                    stalled = not news.wait_for(fits, TURN_S)
                while not fits() and len(waiting) > 1:
                    size -= len(waiting.popleft())
                    drop()
    until_s = time.monotonic() + LAST_S
    while size and time.monotonic() < until_s:
        time.sleep(0.01)


def main() -> None:
    """Runs the process that ``free_outputs`` starts: hands lines on until the service and its child processes have
    ended."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):  # it must outlive the service
        signal.signal(number, signal.SIG_IGN)
    form, (counts, *ends) = sys.argv[1], map(int, sys.argv[2:])
    ways = [(*ends[:2], form, counts, 0), (*ends[2:], form, counts, 1)]
    outputs = [threading.Thread(target=_hand_on, args=way) for way in ways]
    for output in outputs:
        output.start()
    for output in outputs:
        output.join()
    os._exit(0)  # a thread may still wait for a reader


if __name__ == "__main__":
    main()
