"""Liveness, readiness and metrics, and that a stuck loop keeps nobody from hearing of it."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx

from service.http.server import bind
from service.watch.lifecycle import Lifecycle
from service.watch.metrics import Metrics
from service.watch.probes import MOST_CLIENTS, Probes
from tests.architecture.repository import ROOT


def test_both_are_well_on_the_port_of_the_service(live: str):
    for path in ("/livez", "/readyz"):
        response = httpx.get(live + path)
        assert (response.status_code, response.json()) == (200, {"status": "ok"})
    assert httpx.get(live + "/metrics").headers["content-type"].startswith("text/plain; version=")


def test_readiness_follows_the_life_of_the_service_and_liveness_does_not():
    life = Lifecycle(stuck_s=60.0)
    assert "one that still loads" in str(life.unready()) and life.unhealthy() is None
    life.ready()
    assert life.unready() is None
    life.works["streams"] = lambda: False
    assert "expected running streams, got one that has stopped" in str(life.unready())
    life.works.clear()
    life.draining = True
    assert "one that drains" in str(life.unready()) and life.unhealthy() is None


def test_a_loop_that_has_stopped_turning_is_told_by_the_probes_own_port():
    life, metrics, lags = Lifecycle(stuck_s=0.4), Metrics(), []
    life.ready()
    with Probes(bind("127.0.0.1", 0), life, metrics) as probes:
        url = f"http://127.0.0.1:{probes.server_address[1]}"

        async def turn_then_stop() -> httpx.Response:
            ticking = asyncio.create_task(life.tick(lags.append))
            await asyncio.sleep(0.3)
            turning = await asyncio.to_thread(httpx.get, url + "/livez")
            assert turning.status_code == 200
            time.sleep(0.5)
            stuck = httpx.get(url + "/livez")
            assert httpx.get(url + "/readyz").status_code == 503
            ticking.cancel()
            return stuck

        stuck = asyncio.run(turn_then_stop())
        assert stuck.status_code == 503
        assert stuck.headers["content-type"] == "application/problem+json"
        assert "event loop: expected a turn within 0.4 s, got none for " in stuck.json()["detail"]
        life.ended()
        assert httpx.get(url + "/livez").status_code == 200
        assert "drape_frames_total" in httpx.get(url + "/metrics").text
        assert httpx.get(url + "/other").status_code == 404
    assert lags and min(lags) >= 0.0


def test_clients_that_say_nothing_do_not_fill_the_probes_port():
    with Probes(bind("127.0.0.1", 0), Lifecycle(stuck_s=60.0), Metrics()) as probes:
        address = ("127.0.0.1", probes.server_address[1])
        silent = [socket.create_connection(address) for _ in range(MOST_CLIENTS)]
        deadline = time.monotonic() + 10.0
        while True:  # until those that say nothing are hung up on
            try:
                assert httpx.get(f"http://127.0.0.1:{address[1]}/livez").status_code == 200
                break
            except httpx.TransportError:
                assert time.monotonic() < deadline
                time.sleep(0.1)
        for one in silent:
            one.close()


def test_a_start_answers_its_probes_while_it_loads(tiny_folder: Path):
    with bind("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    environment = {
        "DRAPE_MODEL": "tiny",
        "DRAPE_MODELS_DIR": str(tiny_folder / "models"),
        "DRAPE_PROBE_PORT": str(port),
    }
    environment["DRAPE_SHIPPED_GARMENTS_DIR"] = str(tiny_folder / "shipped")
    environment["DRAPE_GARMENTS_DIR"] = str(tiny_folder / "none")
    command = [sys.executable, "-m", "service", "--port", "0"]
    with subprocess.Popen(
        command, cwd=ROOT, env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as service:
        seen = []
        try:
            deadline = time.monotonic() + 60.0
            while 200 not in seen:
                assert time.monotonic() < deadline
                try:
                    seen.append(httpx.get(f"http://127.0.0.1:{port}/readyz").status_code)
                    assert httpx.get(f"http://127.0.0.1:{port}/livez").status_code == 200
                except httpx.ConnectError:
                    pass
                time.sleep(0.02)
        finally:
            service.terminate()
            _, said = service.communicate(timeout=30)
    assert seen[0] == 503
    lines = [json.loads(line) for line in said.splitlines()]
    assert all(line["time"].endswith("Z") and line["level"] == "info" for line in lines)
