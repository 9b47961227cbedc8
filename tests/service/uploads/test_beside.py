"""The process beside an intake: it makes what it is given, hands its errors on, and ends with the block."""

from __future__ import annotations

import math
import os

import pytest

from drape.errors import TooLarge
from service.uploads.beside import beside


def test_two_processes_make_what_one_would_in_its_order():
    with beside() as each:
        assert each(math.sqrt, [4.0, 9.0, 16.0]) == [2.0, 3.0, 4.0]
    with beside() as each:
        here, there = each(os.path.realpath, ["/proc/self", "/proc/self"])
        assert here != there == os.path.join("/proc", os.path.basename(there))


def test_an_error_over_there_is_one_here():
    with beside() as each, pytest.raises(ValueError, match="math domain error"):
        each(math.sqrt, [4.0, -1.0])


def test_a_process_that_is_killed_is_a_refusal():
    with (
        beside() as each,
        pytest.raises(TooLarge, match=r"limits of an intake, got a process that ended: 3\. Simplify"),
    ):
        each(ended_there, [0, 3])


def ended_there(status: int) -> None:
    if status:
        os._exit(status)


@pytest.mark.parametrize("ones", [[], [4.0]])
def test_nothing_is_asked_of_it_where_there_is_nothing_for_it(ones: list[float]):
    with beside() as each:
        assert each(math.sqrt, ones) == [2.0 for _ in ones]
