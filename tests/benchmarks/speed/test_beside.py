"""Waits of a stream beside others: of every pose, until a frame that shows it or a newer one."""

from __future__ import annotations

import httpx
import pytest

from benchmarks.speed.beside import NEIGHBOURS, Watched, _asked


def test_a_pose_waits_for_the_first_frame_of_it_or_of_a_newer_one():
    watched = Watched(sent_s=[0.0, 0.1, 0.2, 0.3, 0.4], came_s=[0.02, 0.25, 0.33], number=[0, 2, 3])
    found = watched.window(0.0, 0.35)
    assert found["p50"] == pytest.approx(40.0)  # waits of 20, 150, 50 and 30 ms
    assert found["p99"] == pytest.approx(147.0)
    assert found["gap"] == pytest.approx(230.0)
    assert watched.window(0.3, 1.0)["p99"] == pytest.approx(30.0), "the last pose has no frame yet"


def test_every_neighbour_can_be_asked_for():
    with httpx.Client() as http:
        assert tuple(_asked(http, ["tshirt", "dress"])) == NEIGHBOURS
