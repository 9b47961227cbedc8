"""A process of its own for tables and constants that are made beside streams: ``ConstantsProcess``.

Making them holds the interpreter lock for tens of milliseconds at a time, and a frame asks for that lock some fifty
times. The process runs ``service.compute.constants_calls``.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from service.compute.constants_calls import receive, send
from service.compute.processes import Process, kill, start_process
from service.watch.watchdog import spent_s, waits_for

P = ParamSpec("P")
Result = TypeVar("Result")
log = logging.getLogger("drape.service")


class ConstantsProcess:
    """Calls functions of modules in another process while ``wanted()`` is true, and otherwise in this process.

    The other process is started by ``begin``, or when it is first wanted. It makes one call at a time. Once it runs,
    this process makes one call at a time too. A second call that comes meanwhile goes to the other process, so that two
    processors work. Any thread may call.
    """

    def __init__(self, wanted: Callable[[], bool]) -> None:
        self._wanted = wanted
        self._there, self._here = threading.Lock(), threading.Lock()
        self._process: Process | None = None

    def begin(self) -> None:
        """Starts the process, which takes a second, so that a later call need not wait for it."""
        if self._there.acquire(blocking=False):  # a thread that holds the lock starts the process itself
            try:
                self._running()
            finally:
                self._there.release()

    def call(self, function: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        """Returns ``function(*arguments, **named)``, computed in either process, or raises what the function raised. If
        the other process is lost, the call is made in this one."""
        if not self._wanted():
            if self._process is None:
                return function(*arguments, **named)
            if self._here.acquire(blocking=False):
                try:
                    return function(*arguments, **named)
                finally:
                    self._here.release()
        return self.call_there(function, *arguments, **named)

    def call_there(self, function: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        """Returns what ``call`` does, computed in the other process even if that is not wanted: so caches that the
        function fills are filled there."""
        try:
            waits_for(self._spent_s)
            with self._there:
                succeeded, result = self._answer((function, arguments, named))
        except (OSError, EOFError):
            log.warning("the process of constants ended; its call is made in the service")
            return function(*arguments, **named)
        if not succeeded:
            raise result
        return result

    def _spent_s(self) -> float:
        process = self._process
        return 0.0 if process is None else spent_s(process.pid)

    def _answer(self, call: Any) -> tuple[bool, Any]:
        process = self._running()
        assert process.stdin is not None and process.stdout is not None
        try:
            send(process.stdin, call)
            return receive(process.stdout)
        except (OSError, EOFError):
            self._end()
            raise

    def _running(self) -> Process:
        if self._process is None:
            self._process = start_process("service.compute.constants_calls")
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        kill(process)
        process.wait()
        for file in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):  # closing writes what is still buffered, which nobody reads
                file.close()  # pyright: ignore[reportOptionalMemberAccess]

    def close(self) -> None:
        """Ends the other process. A call that it was making is made in this process."""
        if (process := self._process) is not None:
            kill(process)
        with self._there:
            self._end()
