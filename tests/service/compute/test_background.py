"""A process that steps back is nicer, and so is its session where it has one to itself."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from service.compute.background import NICE, thread_steps_back

# The file is empty where a process is in no group: the system's first session.
SAY = """
import os
from pathlib import Path
from service.compute.background import step_back
step_back()
group = Path("/proc/self/autogroup")
print(os.nice(0), *(group.read_text() if group.is_file() else "").split()[-1:])
"""


def said(*, own_session: bool) -> list[str]:
    command = [sys.executable, "-c", SAY]
    return subprocess.run(
        command, capture_output=True, check=True, text=True, start_new_session=own_session
    ).stdout.split()


def test_a_process_is_nicer():
    assert said(own_session=True)[0] == str(min(19, os.nice(0) + NICE))


@pytest.mark.skipif(not Path("/proc/self/autogroup").is_file(), reason="this system has no niceness of sessions")
def test_a_session_is_nicer_where_it_has_no_other_process():
    ours = Path("/proc/self/autogroup").read_text()
    assert said(own_session=True)[1] == str(NICE)
    said(own_session=False)
    assert Path("/proc/self/autogroup").read_text() == ours


@pytest.mark.skipif(sys.platform != "linux", reason="niceness of threads")
def test_a_thread_is_nicer_and_the_others_are_not():
    before = os.nice(0)

    def nicer() -> int:
        thread_steps_back()
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(nicer).result() == min(19, before + NICE)
    assert os.nice(0) == before
