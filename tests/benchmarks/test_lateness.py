"""The lateness of streams: what a delay is made of, and what is no part of it."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from types import SimpleNamespace

import httpx
import numpy as np
import pytest

from benchmarks.lateness import SO_TIMESTAMPNS, LightStream, Queued, flow, medians, neighbour
from benchmarks.serving import Server
from tests.fixtures.serving import live, live_settings, make_settings, settings, tiny_folder

__all__ = ["live", "live_settings", "make_settings", "settings", "tiny_folder"]  # fixtures
OPENING: dict[str, object] = {"garment": "tube", "tier": "fast"}


def test_a_client_that_reads_late_adds_nothing(live: str):
    stream = LightStream(live, OPENING)
    with contextlib.closing(stream.socket):
        queued = Queued(os.getpid())
        stream.send(1, np.zeros((24, 3)), 0.0, queued)
        sent_ns = stream.sent[1][0]
        header = stream.socket.recv(10, socket.MSG_PEEK | socket.MSG_WAITALL)  # of the WebSocket's frame
        size = int.from_bytes(header[2:4]) + 4 if header[1] == 126 else int.from_bytes(header[2:10]) + 10
        stream.socket.recv(size, socket.MSG_PEEK | socket.MSG_WAITALL)
        came_ns = time.time_ns()
        time.sleep(0.05)  # in which nobody reads
        while not stream.frames:
            stream.take(queued)
    delay_s, coming_s, inside_s, going_s, own_s, _ = stream.frames[0]
    assert 0.0 < delay_s <= 1e-9 * (came_ns - sent_ns)
    assert inside_s > 0.0 and 0.0 <= own_s <= delay_s
    assert delay_s == pytest.approx(coming_s + inside_s + going_s, abs=1e-6)


def test_figures_are_of_all_streams_and_the_poses_without_frame_are_lost(live: str):
    row = flow(Server(live, os.getpid()), OPENING, 2, 0.4, seed=1)
    assert row["frames"] + row["lost"] == 2 * 12 and row["frames"] > 0
    assert row["delay_p50_ms"] <= row["delay_p99_ms"] <= row["delay_p999_ms"] <= row["delay_max_ms"]
    assert row["delay_max_ms"] >= row["inside_max_ms"]


def test_medians_are_of_the_runs():
    rows = [{"streams": 2, "run": str(i), "frames": 9, "delay_max_ms": ms} for i, ms in enumerate((9.0, 1.0, 2.0))]
    assert medians(rows) == {"streams": 2, "run": "median", "frames": None, "lost": None, "delay_max_ms": 2.0}


@pytest.mark.parametrize("name", [pytest.param("previews", marks=pytest.mark.long), "metrics", "clips"])
def test_neighbours_ask_until_they_are_told_to_end(live: str, name: str):
    done = SimpleNamespace(value=0)
    neighbour(name, live, "tube", SimpleNamespace(is_set=lambda: done.value > 1), done)
    assert done.value == 2
    with pytest.raises(httpx.HTTPStatusError, match="404"):
        neighbour(name, live, "nobody", SimpleNamespace(is_set=lambda: True), done)


def test_a_stream_that_is_refused_says_why(live: str):
    with pytest.raises(RuntimeError, match="nobody"):
        LightStream(live, {"garment": "nobody"})


def test_bytes_whose_time_the_system_did_not_note_came_when_they_are_read(live: str):
    stream = LightStream(live, OPENING)
    with contextlib.closing(stream.socket):
        stream.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 0)
        before_ns = time.time_ns()
        stream.send(1, np.zeros((24, 3)), 0.0, Queued(os.getpid()))
        assert before_ns < stream._read()[1] <= time.time_ns()
