"""Processes and threads that leave processors to streams, and the number of processors."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from pathlib import Path

LARGE_BYTES = 1 << 20
TURN_S = 0.0005
NICE = 5  # a third of the time of others that want it: a client waits for what is made


def step_back() -> None:
    """Makes this process nice, and its session too if it is alone in it: Linux shares processors out by session first
    (``autogroup``)."""
    os.nice(NICE)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(NICE))


def processor_count() -> int:
    """Processors that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def thread_steps_back() -> None:
    """Makes this thread a little nice, where the system has niceness of threads.

    Not very: a thread that waits for a processor with the interpreter lock in its hands makes all others wait.
    """
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), min(19, os.nice(0) + NICE))


def give_back_memory() -> None:
    """Has the C library give arrays of ``LARGE_BYTES`` and more back to the system as soon as they are freed.

    glibc raises that size to 32 MB by itself. What is made once in a while, as an avatar's garments, is then cut out of
    one piece with what stays, and the holes that it leaves grow from one to the next.
    """
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(-3, LARGE_BYTES)  # M_MMAP_THRESHOLD


def take_turns() -> None:
    """Has a thread that computes in Python give the interpreter lock to another after ``TURN_S``, and not after five
    milliseconds: a frame asks for it again after each call of the engine, a dozen times."""
    sys.setswitchinterval(TURN_S)
