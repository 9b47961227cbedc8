"""A request ends with its connection, wherever it waits; what others will use goes on."""

from __future__ import annotations

import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from drape.export.glb import add_garment
from drape.export.glb_file import GlbFile
from drape.export.root_motion import RootMotion
from drape.garment.cache import Garment
from drape.geometry.raster import Surface, render
from drape.stages.stage import KeptConstants
from drape.wanted import WANTED, Unwanted
from drape.wire.clip_message import pack_clip
from service.app import create_app
from service.settings import Settings
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import wait_until
from tests.fixtures.serving import serve

FRAMES = 10_000
DEADLINE_S = 300.0
REST = np.zeros((1, 24, 3)).tolist()
CLIP = pack_clip({"garment": "tube"}, np.zeros((FRAMES, 24, 3)), None)
BINARY, JSON = "application/octet-stream", "application/json"


def request(method: str, path: str, body: bytes | dict = b"", kind: str = JSON, accept: str = "*/*") -> bytes:
    content = json.dumps(body).encode() if isinstance(body, dict) else body
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAccept: {accept}\r\nContent-Type: {kind}\r\n"
    return f"{head}Content-Length: {len(content)}\r\n\r\n".encode() + content


POSE = {"garment": "tube", "poses": REST}
WAITING = {
    "a clip": request("POST", "/drape", CLIP, BINARY),
    "one in JSON": request("POST", "/drape", POSE, accept=JSON),
    "one as a file": request("POST", "/drape", POSE, accept="model/gltf-binary"),
    "a streamed one": request("POST", "/drape", POSE | {"streamed": True}),
    "one before another request": request("POST", "/drape", POSE) + request("GET", "/health"),
    "a body": request("POST", "/bodies/anny_default/posed", {"poses": REST}),
    "a fit": request("POST", "/garments/tube/fit", {"pose": REST[0]}),
    "a shape": request("POST", "/bodies/anny_default/shapes", {"height_m": 1.7}),
    "a picture": request("GET", "/garments/tube/preview.png?size=64"),
    "a picture that nobody reads the body of": request("GET", "/garments/tube/preview.png?size=65", b"x" * 200_000),
    "folds": request("GET", "/garments/tube/folds"),
}


@pytest.fixture(scope="module")
def service(make_settings: Callable[..., Settings]) -> Iterator[tuple[FastAPI, httpx.Client]]:
    settings = make_settings(max_frames=FRAMES, max_clips=2)
    app = create_app(settings)
    with serve(app, settings) as url, httpx.Client(base_url=url, timeout=DEADLINE_S) as client:
        yield app, client


@contextmanager
def busy(*executors: Executor) -> Iterator[None]:
    """Threads that have work which does not end before this does."""
    end = threading.Event()
    for executor in executors:
        assert isinstance(executor, ThreadPoolExecutor)
        for _ in range(executor._max_workers):
            executor.submit(end.wait)
    try:
        yield
    finally:
        end.set()


def left(app: FastAPI) -> int:
    """Requests that were given up so far."""
    answered = app.state.drape.runtime.metrics.requests.collect()[0].samples
    return sum(int(one.value) for one in answered if one.name.endswith("_total") and one.labels["status"] == "499")


def has_left(app: FastAPI, count: int) -> bool:
    return left(app) == count


@contextmanager
def begun(client: httpx.Client, sent: bytes) -> Iterator[socket.socket]:
    with socket.create_connection((client.base_url.host, client.base_url.port or 80)) as one:
        one.sendall(sent)
        yield one


@pytest.mark.parametrize("what", WAITING)
def test_what_waits_for_its_turn_leaves_with_its_client(
    service: tuple[FastAPI, httpx.Client], what: str, caplog: pytest.LogCaptureFixture
):
    app, client = service
    state, before = app.state.drape, left(app)
    threads = state.runtime.threads
    with busy(threads._aside, threads._apart), caplog.at_level(logging.INFO):
        for count in range(before + 1, before + 4):  # more than there are places
            with begun(client, WAITING[what]) as one:
                time.sleep(0.1)  # it may be anywhere by now
                one.setblocking(False)
                with pytest.raises(BlockingIOError):
                    one.recv(1)  # not answered
            wait_until(partial(has_left, app, count), DEADLINE_S)
        assert state.clips == 0
    assert [line for line in caplog.records if line.levelno >= logging.WARNING or line.exc_info] == []
    assert client.post("/drape", json=POSE).status_code == 200


def test_who_stays_gets_what_another_gave_up(service: tuple[FastAPI, httpx.Client]):
    app, client = service
    threads, before, sent = app.state.drape.runtime.threads, left(app), WAITING["a picture"]
    with ExitStack() as opened:
        with busy(threads._aside, threads._apart):
            stays = opened.enter_context(begun(client, sent))
            with begun(client, sent):
                time.sleep(0.1)
            wait_until(lambda: left(app) > before, DEADLINE_S)
        stays.settimeout(DEADLINE_S)
        assert stays.recv(15) == b"HTTP/1.1 200 OK"


def test_a_clip_that_is_being_computed_ends_with_the_frames_at_hand(service: tuple[FastAPI, httpx.Client]):
    app, client = service
    frames, before = app.state.drape.runtime.metrics.frames._value.get, left(app)
    already = frames()
    with begun(client, WAITING["a clip"]):
        wait_until(lambda: frames() > already, DEADLINE_S)
    wait_until(lambda: left(app) > before, DEADLINE_S)
    assert app.state.drape.clips == 0 and frames() - already < FRAMES
    computed = frames()
    assert client.post("/drape", json=POSE).status_code == 200, "the place is free, and the turn too"
    assert frames() - computed <= 1 + app.state.drape.runtime.settings.chunk_frames


def test_an_upload_whose_last_byte_has_come_goes_on(service: tuple[FastAPI, httpx.Client], tube: Garment):
    app, client = service
    state = app.state.drape
    with busy(state.sliced_thread._executor):
        with begun(client, request("POST", "/garments?name=kept.obj&avatar=standard", garment_obj(tube), BINARY)):
            wait_until(lambda: state.uploads.waiting == 1, DEADLINE_S)
            time.sleep(0.2)  # for all of it to come
        time.sleep(0.5)
        (job,) = state.uploads._jobs.values()
        assert job.state == "queued"
    wait_until(lambda: job.state != "queued", DEADLINE_S)  # the rest is that of every upload


def test_long_loops_end_when_nobody_wants_their_result(tube: Garment):
    frames = np.repeat(tube.vertices[None, : tube.vertex_count], 2, axis=0)
    quantised = RootMotion(np.zeros((2, 3)), np.zeros((2, 3)))
    kept = KeptConstants[int]()
    kept.get(("there",), lambda: 1)
    works = [
        lambda: render([Surface(tube.vertices, tube.faces)], size=(16, 16)),
        lambda: add_garment(GlbFile(), tube, frames, 30.0),
        lambda: add_garment(GlbFile(), tube, frames, 30.0, root_motion=quantised),
        lambda: kept.get(("missing",), lambda: 2),
    ]
    for work in works[:3]:
        work()
    token = WANTED.set(lambda: False)
    try:
        for work in works:
            with pytest.raises(Unwanted):
                work()
        assert kept.get(("there",), lambda: 3) == 1
    finally:
        WANTED.reset(token)
