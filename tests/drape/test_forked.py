"""Work that a process shares with copies of itself, each test in a process of one thread."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

BEGIN = """
import math, os, threading, time
from drape.errors import TooLarge
from drape.forked import each, may_fork

def slow(one):
    time.sleep(0.05)
    return one, os.getpid()
"""


def said(program: str) -> str:
    """What ``program`` prints, after ``BEGIN``."""
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-c", BEGIN + program]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, timeout=60
    ).stdout.strip()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing tells how many threads there are")
def test_copies_make_what_one_process_would_in_its_order():
    program = """
may_fork({copies})
made = each(slow, list(range(12)))
print([one for one, _ in made] == list(range(12)), len({{pid for _, pid in made}}))
"""
    assert said(program.format(copies=1)) == "True 2"
    assert said(program.format(copies=2)) == "True 3"
    assert said(program.format(copies=0)) == "True 1"


def test_without_leave_and_for_one_thing_there_is_no_copy():
    assert said("print({pid for _, pid in each(slow, [1, 2, 3])} == {os.getpid()})") == "True"
    assert said("may_fork(1); print({pid for _, pid in each(slow, [1])} == {os.getpid()}, each(slow, []))") == "True []"


def test_a_process_of_several_threads_is_not_copied():
    program = """
threading.Thread(target=time.sleep, args=(5.0,), daemon=True).start()
may_fork(1)
print({pid for _, pid in each(slow, [1, 2, 3])} == {os.getpid()}, flush=True)
os._exit(0)
"""
    assert said(program) == "True"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing tells how many threads there are")
def test_a_copy_that_ends_makes_room_for_one_deeper_inside():
    program = """
may_fork(1)
def deep(one):
    if one:
        return {os.getpid()}
    time.sleep(0.5)
    return {pid for _, pid in each(slow, list(range(8)))}
print(sorted(map(len, each(deep, [0, 1]))))
"""
    assert said(program) == "[1, 2]"


def test_more_things_than_a_queue_has_entries():
    assert said("may_fork(1); print(each(math.sqrt, range(10_000)) == [math.sqrt(n) for n in range(10_000)])") == "True"


@pytest.mark.parametrize("copies", [0, 1])
def test_the_first_error_is_raised(copies: int):
    program = f"""
may_fork({copies})
def made(one):
    slow(one)
    return math.sqrt(3.5 - one)
try:
    each(made, list(range(9)))
except ValueError as error:
    print(error)
print(each(slow, [1, 2])[1][0])
"""
    assert said(program) == "math domain error\n2"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing tells how many threads there are")
def test_a_copy_that_is_killed_is_a_refusal():
    program = """
may_fork(1)
own = os.getpid()
def made(one):
    slow(one)
    if os.getpid() != own:
        os._exit(3)
try:
    each(made, list(range(9)))
except TooLarge as error:
    print(error)
"""
    assert "limits of an intake, got a process that ended before its work. Simplify" in said(program)
