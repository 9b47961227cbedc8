"""A process of its own for tables and constants that are made beside streams: ``ConstantsProcess``.

Making them holds the interpreter lock for tens of milliseconds at a time, and a frame asks for that lock some fifty
times.
``service.compute.constants_calls`` is that process.
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
    """Calls functions of modules in a process of its own while that is ``wanted``, and otherwise in this process. Of
    calls beside each other one is made here then, and the others there if that process runs: two processors work.

    The process is started when it is first wanted, or by ``begin``. It makes one call at a time, for any thread.
    """

    def __init__(self, wanted: Callable[[], bool]) -> None:
        self._wanted = wanted
        self._one, self._here = threading.Lock(), threading.Lock()
        self._process: Process | None = None

    def begin(self) -> None:
        """Starts the process, which takes a second, before it is needed."""
        if self._one.acquire(blocking=False):  # another thread that has it starts the process itself
            try:
                self._started()
            finally:
                self._one.release()

    def call(self, function: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        """Returns ``function(*arguments, **named)`` as the process computes it, or raises what it raised. If the
        process is lost, the call is made here."""
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
        """Returns what ``call`` does, made in the process in any case: what the function keeps is kept there too."""
        try:
            waits_for(self._spent_s)
            with self._one:
                succeeded, result = self._asked((function, arguments, named))
        except (OSError, EOFError):
            log.warning("the process of constants ended; its call is made in the service")
            return function(*arguments, **named)
        if not succeeded:
            raise result
        return result

    def _spent_s(self) -> float:
        process = self._process
        return 0.0 if process is None else spent_s(process.pid)

    def _asked(self, call: Any) -> tuple[bool, Any]:
        process = self._started()
        assert process.stdin is not None and process.stdout is not None
        try:
            send(process.stdin, call)
            return receive(process.stdout)
        except (OSError, EOFError):
            self._end()
            raise

    def _started(self) -> Process:
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
            with contextlib.suppress(OSError):  # what was not sent
                file.close()  # pyright: ignore[reportOptionalMemberAccess]

    def close(self) -> None:
        """Ends the process. A call that it was making is made in the process that asked."""
        if (process := self._process) is not None:
            kill(process)
        with self._one:
            self._end()
