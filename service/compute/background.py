"""How processes and threads leave processors, memory and the interpreter lock to streams."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from pathlib import Path

LARGE_BYTES = 1 << 20
TURN_S = 0.0005
NICE = 5  # a third of the processor time that others get: not less, since clients wait for such work too


def step_back() -> None:
    """Raises the niceness of this process by ``NICE``. If the process leads its session the session gets the same,
    because Linux shares processors out by session first (``autogroup``)."""
    os.nice(NICE)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(NICE))


def processor_count() -> int:
    """Returns the number of processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def thread_steps_back() -> None:
    """Raises the niceness of this thread by ``NICE`` on Linux; other systems have no niceness of threads.

    It stays small: a thread that waits for a processor while it holds the interpreter lock makes all others wait.
    """
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), min(19, os.nice(0) + NICE))


def give_back_memory() -> None:
    """Makes the C library return arrays of ``LARGE_BYTES`` and more to the system as soon as they are freed.

    glibc raises that limit to 32 MB by itself. Short-lived arrays then share memory with long-lived ones and leave
    holes in it, which grow.
    """
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(-3, LARGE_BYTES)  # M_MMAP_THRESHOLD


def take_turns() -> None:
    """Makes a thread that runs Python code give the interpreter lock to another after ``TURN_S`` [s] in place of
    Python's 5 ms: a frame asks for the lock after each call of the engine, a dozen times."""
    sys.setswitchinterval(TURN_S)
