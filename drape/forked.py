"""Work that a process shares with copies of itself, while other processors are idle: ``each``.

A copy (``fork``) has all that its process has, so nothing is sent to it, and only what it made comes back. Which of
them makes what is found as they go: whoever is free takes the next. A copy that ends makes room for another, also for
work that is deeper inside. Only a process of one thread is copied, since locks of others would stay shut in a copy for
ever, and none until ``may_fork`` allows it.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple, TypeVar

from drape.errors import TooLarge

MOST = 4096  # entries of a queue, a pipe, which holds 64 KiB
THREADS = "/proc/self/task"
NUMBER = struct.Struct("i")
Given = TypeVar("Given")
Made = TypeVar("Made")


class _Pipe(NamedTuple):
    """Where one reads, and where one writes."""

    out: int
    into: int


class _Copy(NamedTuple):
    """A copy of this process, and where it tells what it made."""

    pid: int
    told: int


_ROOM: list[_Pipe] = []  # a pipe that holds a byte for every copy that may be made yet


def may_fork(copies: int) -> None:
    """Allows this process and its copies to have so many ``copies`` at a time, all together; 0 ends that."""
    while _ROOM:
        for end in _ROOM.pop():
            os.close(end)
    if copies:
        _ROOM.append(_Pipe(*os.pipe()))
        os.set_blocking(_ROOM[0].out, False)
        os.write(_ROOM[0].into, bytes(copies))


def end_with_parent() -> None:
    """Has Linux kill this process when the thread that has started it ends, however it ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def each(make: Callable[[Given], Made], ones: Sequence[Given]) -> list[Made]:
    """Returns ``[make(one) for one in ones]``. Copies of this process share the work, where ``may_fork`` leaves room
    for them.

    Raises the first error of ``make``, and ``TooLarge`` where a copy ends before it has told what it made, as at a
    limit of memory.
    """
    if not _ROOM or len(ones) < 2:
        return [make(one) for one in ones]
    count = min(len(ones), MOST)
    queue = _Pipe(*os.pipe())
    os.write(queue.into, b"".join(map(NUMBER.pack, range(count))))
    os.close(queue.into)
    copies: list[_Copy] = []
    try:
        parts = _taken(make, ones, queue.out, count, copies)
        for copy in copies:
            parts |= _told(copy)
    finally:
        os.close(queue.out)
        for copy in copies:
            with suppress(ProcessLookupError):
                os.kill(copy.pid, signal.SIGKILL)
            os.waitpid(copy.pid, 0)
            os.close(copy.told)
    made: list[list[Made]] = []
    for _, part in sorted(parts.items(), key=lambda item: item[0]):
        if isinstance(part, Exception):
            raise part
        made.append(part)
    return [made[number % count][number // count] for number in range(len(ones))]


def _taken(
    make: Callable[[Given], Made], ones: Sequence[Given], queue: int, count: int, copies: list[_Copy] | None
) -> dict[int, list[Made] | Exception]:
    """What this process makes of the ``queue``, by its numbers, up to an error; ``copies`` that it makes to help."""
    results: dict[int, list[Made] | Exception] = {}
    for number in _numbers(queue):
        if copies is not None and number < count - 1 and _room():
            copies.append(_copy(lambda: _taken(make, ones, queue, count, None)))
        try:
            results[number] = [make(one) for one in ones[number::count]]
        except Exception as error:
            results[number] = error
            for _ in _numbers(queue):  # nobody takes more
                pass
    return results


def _numbers(queue: int) -> Iterator[int]:
    while entry := os.read(queue, NUMBER.size):
        yield NUMBER.unpack(entry)[0]


def _room() -> bool:
    """Whether another copy may be made; it is counted then."""
    try:
        return len(os.listdir(THREADS)) == 1 and bool(os.read(_ROOM[0].out, 1))
    except (BlockingIOError, FileNotFoundError):  # or a system that does not tell its threads
        return False


def _copy(made: Callable[[], object]) -> _Copy:
    """A copy of this process that tells what ``made`` returns there."""
    pipe, parent = _Pipe(*os.pipe()), os.getpid()
    pid = os.fork()  # noqa: TID251  of one thread: none of BLAS' is waited for
    if pid:
        os.close(pipe.into)
        return _Copy(pid, pipe.out)
    status = 1
    try:
        end_with_parent()
        if os.getppid() == parent:
            told = pickle.dumps(made(), protocol=5)
            os.write(_ROOM[0].into, bytes(1))
            with os.fdopen(pipe.into, "wb") as into:
                into.write(told)
            status = 0
    finally:
        os._exit(status)  # nothing of this process's end is the copy's


def _told(copy: _Copy) -> dict[int, list | Exception]:
    try:
        with os.fdopen(os.dup(copy.told), "rb") as told:
            return pickle.load(told)
    except (EOFError, pickle.UnpicklingError) as error:  # by a limit, or by the system
        expected, got = "work that fits into the limits of an intake", "a process that ended before its work"
        raise TooLarge("file", expected=expected, got=got, cure="Simplify the mesh.") from error
