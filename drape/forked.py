"""Work that a process shares with copies of itself, while other processors are idle: ``each``.

A copy (``fork``) has all that its process has, so nothing is sent to it, and only its results come back. Whoever is
free takes the next item. A copy that ends makes room for another, also for a call of ``each`` inside the work. Only a
process of one thread is copied, since locks that other threads hold would stay shut in a copy for ever, and only once
``may_fork`` allows it.
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

MOST = 4096  # entries of a queue: it is a pipe, which holds 64 KiB
THREADS = "/proc/self/task"
NUMBER = struct.Struct("i")
Given = TypeVar("Given")
Made = TypeVar("Made")


class _Pipe(NamedTuple):
    """The two ends of a pipe: ``out`` is read, and ``into`` is written."""

    out: int
    into: int


class _Copy(NamedTuple):
    """A copy of this process, and the end of a pipe at which its results are read."""

    pid: int
    results: int


_ROOM: list[_Pipe] = []  # a pipe that holds a byte for every copy that may be made yet


def may_fork(copies: int) -> None:
    """Lets ``each`` make copies of this process, at most so many ``copies`` at a time, those of copies included; 0 lets
    it make none."""
    while _ROOM:
        for end in _ROOM.pop():
            os.close(end)
    if copies:
        _ROOM.append(_Pipe(*os.pipe()))
        os.set_blocking(_ROOM[0].out, False)
        os.write(_ROOM[0].into, bytes(copies))


def end_with_parent() -> None:
    """Makes Linux kill this process when the thread that has started it ends; does nothing on other systems."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def each(make: Callable[[Given], Made], ones: Sequence[Given]) -> list[Made]:
    """Returns ``[make(one) for one in ones]``. Copies of this process share the work, as many as ``may_fork`` allows.

    Raises the first error of ``make``, and ``TooLarge`` where a copy ends before its results are read, as at a limit of
    memory.
    """
    if not _ROOM or len(ones) < 2:
        return [make(one) for one in ones]
    count = min(len(ones), MOST)
    queue = _Pipe(*os.pipe())
    os.write(queue.into, b"".join(map(NUMBER.pack, range(count))))
    os.close(queue.into)
    copies: list[_Copy] = []
    try:
        parts = _results(make, ones, queue.out, count, copies)
        for copy in copies:
            parts |= _read(copy)
    finally:
        os.close(queue.out)
        for copy in copies:
            with suppress(ProcessLookupError):
                os.kill(copy.pid, signal.SIGKILL)
            os.waitpid(copy.pid, 0)
            os.close(copy.results)
    results: list[list[Made]] = []
    for _, part in sorted(parts.items(), key=lambda item: item[0]):
        if isinstance(part, Exception):
            raise part
        results.append(part)
    return [results[number % count][number // count] for number in range(len(ones))]


def _results(
    make: Callable[[Given], Made], ones: Sequence[Given], queue: int, count: int, copies: list[_Copy] | None
) -> dict[int, list[Made] | Exception]:
    """The results of the items that this process takes from the ``queue``, by their numbers, up to an error. Copies
    that it makes to help are added to ``copies``; None makes none."""
    results: dict[int, list[Made] | Exception] = {}
    for number in _numbers(queue):
        if copies is not None and number < count - 1 and _room():
            copies.append(_copy(lambda: _results(make, ones, queue, count, None)))
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
    """Whether another copy may be made; if so, it is counted."""
    try:
        return len(os.listdir(THREADS)) == 1 and bool(os.read(_ROOM[0].out, 1))
    except (BlockingIOError, FileNotFoundError):  # the latter on a system that does not list threads
        return False


def _copy(work: Callable[[], object]) -> _Copy:
    """A copy of this process that writes what ``work`` returns there into its pipe."""
    pipe, parent = _Pipe(*os.pipe()), os.getpid()
    pid = os.fork()  # noqa: TID251  the process has one thread, and none of BLAS
    if pid:
        os.close(pipe.into)
        return _Copy(pid, pipe.out)
    status = 1
    try:
        end_with_parent()
        if os.getppid() == parent:
            results = pickle.dumps(work(), protocol=5)
            os.write(_ROOM[0].into, bytes(1))
            with os.fdopen(pipe.into, "wb") as into:
                into.write(results)
            status = 0
    finally:
        os._exit(status)  # a copy does not run the handlers that end this process


def _read(copy: _Copy) -> dict[int, list | Exception]:
    """The results of ``copy``; refuses (``TooLarge``) where it ended before them."""
    try:
        with os.fdopen(os.dup(copy.results), "rb") as results:
            return pickle.load(results)
    except (EOFError, pickle.UnpicklingError) as error:  # by a limit, or by the system
        expected, got = "work that fits into the limits of an intake", "a process that ended before its work"
        raise TooLarge("file", expected=expected, got=got, cure="Simplify the mesh.") from error
