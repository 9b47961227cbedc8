"""What the service counts, and whether it says that it lives and takes work."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect

from drape.body.model import BodyModel
from drape.wire import messages as wire
from service.server import bind_listener
from service.stream.session import StreamSession
from service.watch import prometheus as service_metrics
from service.watch.probes import MOST_CLIENTS, Lifecycle, Probes
from service.watch.prometheus import Metrics
from tests.architecture.repository import ROOT
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.streams import PROTOCOLS, stream_address

REST = np.zeros((1, 24, 3)).tolist()


def series(url: str) -> dict[str, float]:
    """Every sample by name and labels."""
    found = {}
    for family in text_string_to_metric_families(httpx.get(url + "/metrics").text):
        for sample in family.samples:
            labels = ",".join(f"{key}={value}" for key, value in sorted(sample.labels.items()))
            found[f"{sample.name}{{{labels}}}"] = sample.value
    return found


def gained(before: dict[str, float], after: dict[str, float], name: str) -> float:
    return after.get(name, 0.0) - before.get(name, 0.0)


def test_a_stream_and_a_clip_are_counted(live: str):
    async def stream() -> None:
        async with connect(stream_address(live), subprotocols=PROTOCOLS) as socket:
            await socket.send(json.dumps({"type": "open", "garment": "tube"}))
            await socket.recv()
            assert series(live)["drape_streams{}"] >= 1.0
            for sequence in range(3):
                await socket.send(wire.pack_pose(wire.Pose(sequence, 0.0, np.zeros(3), np.zeros((24, 3)))))
                frame = await socket.recv()
                assert isinstance(frame, bytes)
                await socket.send(wire.pack_ack(wire.unpack_frame(frame).sequence))
            # What was refused is answered after the acknowledgements were read.
            await socket.send(json.dumps({"type": "open", "garment": "cape"}))
            await socket.recv()

    before = series(live)
    asyncio.run(stream())
    assert httpx.post(live + "/drape", json={"garment": "tube", "poses": REST * 2}).status_code == 200
    assert httpx.get(live + "/garments/cape").status_code == 404
    after = series(live)
    expected = {
        "drape_poses_total{}": 3,
        "drape_poses_dropped_total{}": 0,
        "drape_frames_sent_total{}": 3,
        "drape_frame_age_seconds_count{}": 3,
        "drape_frame_acknowledged_seconds_count{}": 3,
        "drape_batch_frames_sum{}": 3,
        "drape_frames_total{}": 5,
        "drape_pushed_share_count{}": 5,
        "drape_push_max_meters_count{}": 5,
        "drape_jets_left_meters_count{}": 5,
        "drape_stage_seconds_count{stage=encode}": 3,
        "drape_folds_resets_total{}": 0,
        "drape_evictions_total{kind=NotFound}": 1,
        "drape_requests_total{method=POST,path=/drape,status=200}": 1,
        "drape_requests_total{method=GET,path=/garments/{garment_id},status=404}": 1,
        "drape_request_seconds_count{path=/drape}": 1,
    }
    assert {name: gained(before, after, name) for name in expected} == expected
    assert gained(before, after, "drape_frames_on_time_total{}") <= 3
    assert after["drape_garments{}"] == 1.0
    assert (after["drape_clips{}"], after["drape_uploads_waiting{}"], after["drape_poses_waiting{}"]) == (0.0, 0.0, 0.0)
    assert after["process_resident_memory_bytes{}"] > 1e7


def test_a_stream_that_ends_by_a_fault_of_ours_is_counted(live: str, monkeypatch: pytest.MonkeyPatch):
    async def fail(*_: Any) -> None:
        raise RuntimeError

    async def stream() -> None:
        async with connect(stream_address(live), subprotocols=PROTOCOLS) as socket:
            await socket.send(json.dumps({"type": "open", "garment": "tube"}))
            assert json.loads(await socket.recv())["kind"] == "InternalError"

    monkeypatch.setattr("service.stream.routes.read_opening", fail)
    before = series(live)
    asyncio.run(stream())
    assert gained(before, series(live), "drape_evictions_total{kind=InternalError}") == 1


def test_frames_on_time_are_those_within_the_deadline():
    metrics = Metrics()
    for age_s in (0.01, 0.05, 0.2):
        metrics.count_sent(age_s, deadline_s=0.05)
    text = metrics.text().decode()
    assert "drape_frames_sent_total 3.0" in text and "drape_frames_on_time_total 2.0" in text


def test_series_come_a_family_at_a_time_and_are_those_of_the_registry():
    metrics = Metrics()
    metrics.requests.labels("GET", "/garments", "200").inc()
    metrics.request_seconds.labels("/garments").observe(0.01)
    pieces = list(metrics.pieces())
    assert len(pieces) == len(list(metrics.registry.collect())) and max(map(len, pieces)) < 0.2 * sum(map(len, pieces))
    whole = generate_latest(metrics.registry)
    assert ours(b"".join(pieces)) == ours(whole) == ours(metrics.text())


def test_neither_series_nor_the_meshes_of_previews_are_made_on_the_loop(live: str, monkeypatch: pytest.MonkeyPatch):
    on_the_loop: list[bool] = []

    def noting(function: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*asked: Any, **named: Any) -> Any:
            on_the_loop.append(asyncio._get_running_loop() is not None)
            return function(*asked, **named)

        return noted

    for home, name in ((service_metrics, "generate_latest"), (BodyModel, "rest_vertices")):
        monkeypatch.setattr(home, name, noting(getattr(home, name)))
        path = "/metrics" if home is service_metrics else "/garments/tube/preview.png?size=77"
        on_the_loop.clear()
        assert httpx.get(live + path, timeout=300.0).status_code == 200
        assert on_the_loop and not any(on_the_loop)


def ours(text: bytes) -> list[bytes]:
    """The lines without those of the process, which change."""
    return [line for line in text.splitlines() if b"process_" not in line]


FRAME = wire.pack_frame(wire.Frame(7, 0.0, 0.0, np.zeros(3), np.zeros((1, 3), np.float32)))


def test_the_way_of_a_frame_is_known_when_it_is_taken():
    session = StreamSession(plan=None, betas=np.zeros(1), credit=1)  # pyright: ignore[reportArgumentType]
    session.put(wire.Pose(7, 0.0, np.zeros(3), np.zeros((24, 3))))
    session.take()
    session.deliver(0, FRAME, {}, since_s=1.0)
    assert session.outbox_since_s == 1.0
    way_s = session.acknowledge(7)
    assert way_s is not None and 0.0 <= way_s < 10.0


def test_no_series_is_of_one_garment_or_client(live: str):
    labels = {label for name in series(live) for label in re.findall(r"(\w+)=", name)}
    assert labels <= {"method", "path", "status", "stage", "kind", "lane", "cause", "state", "le"}
    for unknown in range(5):
        httpx.get(f"{live}/nothing/{unknown}")
    assert not any("nothing" in name for name in series(live))


def test_the_dashboard_asks_for_series_that_there_are():
    board = json.loads((ROOT / "deploy/grafana.json").read_text(encoding="utf-8"))
    asked = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    names = {name for expression in asked for name in re.findall(r"\b(?:drape|process)_[a-z_]+", expression)}
    metrics = Metrics()
    there = {sample.name for family in metrics.registry.collect() for sample in family.samples}
    there |= {
        f"{family.name}{end}"
        for family in metrics.registry.collect()
        for end in ("_total", "_bucket", "_sum", "_count")
    }
    assert len(names) > 15 and names - there == set()
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])


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
    life, metrics, lags = Lifecycle(stuck_s=PATIENT_S), Metrics(), []
    life.ready()
    with Probes(bind_listener("127.0.0.1", 0), life, metrics) as probes:
        url = f"http://127.0.0.1:{probes.server_address[1]}"

        async def turn_then_stop() -> httpx.Response:
            ticking = asyncio.create_task(life.tick(lags.append))
            while not lags:
                await asyncio.sleep(0.02)
            turning = await asyncio.to_thread(httpx.get, url + "/livez")
            assert turning.status_code == 200
            life._stuck_s = 0.1
            time.sleep(0.2)
            stuck = httpx.get(url + "/livez")
            assert httpx.get(url + "/readyz").status_code == 503
            ticking.cancel()
            return stuck

        stuck = asyncio.run(turn_then_stop())
        assert stuck.status_code == 503
        assert stuck.headers["content-type"] == "application/problem+json"
        assert "event loop: expected a turn within 0.1 s, got none for " in stuck.json()["detail"]
        life.ended()
        assert httpx.get(url + "/livez").status_code == 200
        assert "drape_frames_total" in httpx.get(url + "/metrics").text
        assert httpx.get(url + "/other").status_code == 404
    assert lags and min(lags) >= 0.0


def test_clients_that_say_nothing_do_not_fill_the_probes_port():
    with Probes(bind_listener("127.0.0.1", 0), Lifecycle(stuck_s=60.0), Metrics()) as probes:
        address = ("127.0.0.1", probes.server_address[1])
        silent = [socket.create_connection(address) for _ in range(MOST_CLIENTS)]
        # until those that say nothing are hung up on
        assert wait_until(lambda: answered(f"http://127.0.0.1:{address[1]}/livez")) == 200
        for one in silent:
            one.close()


def answered(url: str) -> int:
    """The status of the answer; 0 where none comes."""
    with contextlib.suppress(httpx.TransportError):
        return httpx.get(url).status_code
    return 0


def test_a_start_answers_its_probes_while_it_loads(tiny_folder: Path):
    with bind_listener("127.0.0.1", 0) as free:
        port = free.getsockname()[1]
    environment = {"DRAPE_MODEL": str(tiny_folder / "models/tiny"), "DRAPE_PROBE_PORT": str(port)}
    environment["DRAPE_SHIPPED_GARMENTS_DIR"] = str(tiny_folder / "shipped")
    environment["DRAPE_GARMENTS_DIR"] = str(tiny_folder / "none")
    command = [sys.executable, "-m", "service", "--port", "0"]
    with subprocess.Popen(
        command, cwd=ROOT, env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as service:
        seen = []
        try:
            while 200 not in seen:
                seen.append(wait_until(lambda: answered(f"http://127.0.0.1:{port}/readyz")))
                assert answered(f"http://127.0.0.1:{port}/livez") == 200
                time.sleep(0.02)
        finally:
            service.terminate()
            _, said = service.communicate(timeout=PATIENT_S)
    assert seen[0] == 503
    lines = [json.loads(line) for line in said.splitlines()]
    assert all(line["time"].endswith("Z") and line["level"] == "info" for line in lines)
