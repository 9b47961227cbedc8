"""Connections that are held open for nothing end by themselves, and cost next to nothing until then."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator

import httpx
import numpy as np
import pytest
from starlette.types import Message

from clients.stream import DrapeStream
from service.app import create_app
from service.errors import Draining
from service.guard import connection_times, limits
from service.guard.connection_times import HEAD_BYTES
from service.settings import Settings
from service.watch.probes import Lifecycle
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.serving import files_in, serve, served

HEAD = "Host: 127.0.0.1\r\nContent-Type: {kind}\r\nContent-Length: {size}\r\n\r\n"


@pytest.fixture(scope="module")
def tight(settings: Settings) -> Iterator[Settings]:
    """Little time, for those who shall be refused for being slow. Who shall be answered may be slow in tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connection_times, "HEAD_S", 0.5)
        patch.setattr(limits, "IDLE_S", 0.5)
        patch.setattr(limits, "PACE_BYTES_S", 2**20)
        yield settings


@pytest.fixture(scope="module")
def narrow(make_settings: Callable[..., Settings]) -> Iterator[Settings]:
    """Few places and bytes, and times for whoever is answered; only a reader has little."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connection_times, "HEAD_S", 3.0)
        patch.setattr(connection_times, "READ_S", 0.5)
        patch.setattr(limits, "HELD_BYTES", 2**20)
        yield make_settings(max_connections_per_address=24)


def place_of(url: str) -> tuple[str, int]:
    host, port = url.removeprefix("http://").split(":")
    return host, int(port)


@pytest.fixture(scope="module")
def address(tight: Settings) -> Iterator[tuple[str, int]]:
    with served(tight) as url:
        yield place_of(url)


@pytest.fixture(scope="module")
def narrow_address(narrow: Settings) -> Iterator[tuple[str, int]]:
    with served(narrow) as url:
        yield place_of(url)


def said_until_closed(one: socket.socket, within_s: float = PATIENT_S) -> str:
    """What the service said before it closed the connection; fails if it does not."""
    one.settimeout(within_s)
    parts = []
    with contextlib.suppress(ConnectionResetError):
        while part := one.recv(65536):
            parts.append(part)
    one.close()
    return b"".join(parts).decode()


def refused(text: str, status: int) -> str:
    """The sentence of the problem document in a raw answer."""
    assert text.startswith(f"HTTP/1.1 {status} "), text
    return json.loads(text.split("\r\n\r\n", 1)[1])["detail"]


def opened(address: tuple[str, int], sent: bytes) -> socket.socket:
    one = socket.create_connection(address)
    one.sendall(sent)
    return one


def post(path: str, kind: str = "application/json", size: int = 1000) -> bytes:
    return f"POST {path} HTTP/1.1\r\n{HEAD.format(kind=kind, size=size)}".encode()


def test_heads_that_never_end_are_refused(address: tuple[str, int]):
    half = [opened(address, sent) for sent in (b"", b"GET / HTTP/1.1\r\nHost: ", b"\r\n", b"POST /drape HTTP")]
    for one in half:
        assert "request head: expected a whole head within 0.5 s" in refused(said_until_closed(one), 408)


def test_a_head_that_drips_is_refused_too(address: tuple[str, int]):
    one = opened(address, b"GET / HTTP/1.1\r\n")
    with contextlib.suppress(OSError):
        for _ in range(600):
            one.sendall(b"X-A: b\r\n")
            time.sleep(0.1)
        pytest.fail("a dripping head was kept")
    one.close()


def test_blank_lines_between_requests_hold_no_connection(address: tuple[str, int]):
    one = opened(address, b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    time.sleep(0.2)
    one.sendall(b"\r\n")
    text = said_until_closed(one)
    assert text.startswith("HTTP/1.1 200") and "HTTP/1.1 408" in text


def test_a_head_that_is_too_long_is_refused(narrow_address: tuple[str, int]):
    one = opened(narrow_address, b"GET / HTTP/1.1\r\nX-A: " + b"a" * (HEAD_BYTES + 65536))
    assert f"request head: expected at most {HEAD_BYTES} bytes" in refused(said_until_closed(one), 413)


@pytest.mark.parametrize(("path", "kind"), [("/drape", "application/json"), ("/garments?name=a.obj", "text/plain")])
def test_bodies_that_stop_are_refused_and_their_connections_closed(
    address: tuple[str, int], tight: Settings, path: str, kind: str
):
    text = said_until_closed(opened(address, post(path, kind) + b"[" * 100))
    assert "request body: expected a piece within 0.5 s" in refused(text, 408)
    assert files_in(tight.garments_dir) == []


def test_a_body_that_drips_is_refused(address: tuple[str, int]):
    one = opened(address, post("/drape"))
    begun_s = time.monotonic()
    with contextlib.suppress(OSError):
        while time.monotonic() - begun_s < PATIENT_S:
            one.sendall(b" ")
            time.sleep(0.1)
        pytest.fail("a dripping body was kept")
    one.close()


def test_an_answer_before_the_body_reaches_a_client_that_still_sends(narrow_address: tuple[str, int]):
    one = opened(narrow_address, post("/nothing", size=400_000))
    for _ in range(4):
        one.sendall(b" " * 65536)
        time.sleep(0.05)
    assert said_until_closed(one).startswith("HTTP/1.1 40")


def test_a_connection_whose_body_ended_after_its_answer_goes_on(narrow_address: tuple[str, int]):
    one = opened(narrow_address, post("/nothing", size=10) + b"12345")
    time.sleep(0.2)
    one.sendall(b"67890" + b"GET /livez HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    text = said_until_closed(one)
    assert text.startswith("HTTP/1.1 40") and "HTTP/1.1 200" in text


def test_connections_are_counted(narrow_address: tuple[str, int], narrow: Settings):
    held = [socket.create_connection(narrow_address) for _ in range(narrow.max_connections_per_address)]
    time.sleep(0.1)
    sentence = refused(said_until_closed(socket.create_connection(narrow_address)), 429)
    assert "connections: expected at most 24 from one address, got one more" in sentence
    for one in held:
        one.close()
    time.sleep(0.1)
    assert httpx.get(f"http://{narrow_address[0]}:{narrow_address[1]}/livez").status_code == 200


def test_connections_are_counted_in_all(make_settings: Callable[..., Settings]):
    with served(make_settings(max_connections=2)) as url:
        held = [socket.create_connection(place_of(url)) for _ in range(2)]
        time.sleep(0.1)
        assert "at most 2 in all" in refused(said_until_closed(socket.create_connection(place_of(url))), 429)
        for one in held:
            one.close()
        time.sleep(0.1)


def test_bytes_of_all_bodies_together_are_limited_and_come_free(narrow_address: tuple[str, int], narrow: Settings):
    url = f"http://{narrow_address[0]}:{narrow_address[1]}"
    size = limits.HELD_BYTES
    declared = httpx.post(url + "/drape", content=b" " * (size + 1), headers={"Content-Type": "application/json"})
    assert declared.status_code == 429 and "request bodies: expected at most" in declared.json()["detail"]

    def pieces() -> Iterator[bytes]:
        yield from (b" " * 65536 for _ in range(size // 65536 + 2))

    undeclared = httpx.post(url + "/drape", content=pieces(), headers={"Content-Type": "application/json"})
    assert undeclared.status_code == 429
    for _ in range(3):  # nothing is held of what was refused
        half = httpx.post(url + "/drape", content=b" " * (size // 2), headers={"Content-Type": "application/json"})
        assert half.status_code == 400
    # A file in a raw body goes to disk and is not held.
    assert httpx.post(url + "/garments?name=a.obj", content=b"#" * (size + 1)).status_code == 202


def test_a_body_that_still_comes_when_the_service_hurries_is_refused(settings: Settings):
    life = Lifecycle(stuck_s=60.0)
    life.hurried = True

    async def silent() -> Message:
        await asyncio.sleep(PATIENT_S)
        return {"type": "http.request"}

    with pytest.raises(Draining):
        asyncio.run(limits._Body(settings, life, upload=True).next(silent))


def test_places_are_looked_for_before_a_body_is_read(make_settings: Callable[..., Settings], monkeypatch):
    settings = make_settings(intake_queue=1, max_clips=1)
    app = create_app(settings)
    with serve(app, settings) as url:
        waiting = opened(place_of(url), post("/garments?name=a.obj", "text/plain") + b"#")
        wait_until(lambda: app.state.drape.uploads.waiting > 0)
        for kind in ("text/plain", "application/json"):
            one = opened(place_of(url), post("/garments?name=b.obj", kind))
            one.settimeout(PATIENT_S)
            assert one.recv(64).startswith(b"HTTP/1.1 429")
            one.close()
        waiting.close()
        with app.state.drape.slot():
            for path in ("/drape", "/bodies/anny_default/posed"):
                one = opened(place_of(url), post(path))
                one.settimeout(PATIENT_S)
                assert one.recv(64).startswith(b"HTTP/1.1 429")
                one.close()


def test_an_answer_that_nobody_reads_ends(narrow_address: tuple[str, int]):
    poses = json.dumps({"garment": "tube", "poses": [[[0.0] * 3] * 24] * 1000}).encode()
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    one.connect(narrow_address)
    one.sendall(post("/drape", size=len(poses)) + poses)
    url = f"http://{narrow_address[0]}:{narrow_address[1]}/metrics"
    kept = "an answer that nobody reads was kept"
    wait_until(lambda: 'path="/drape",status="200"' in httpx.get(url).text, missing=kept)
    one.close()


def test_a_reader_that_was_slow_for_a_while_keeps_its_connection(narrow_address: tuple[str, int]):
    """Its time to read ends when it reads on, and does not run out while it asks for nothing."""
    poses = json.dumps({"garment": "tube", "poses": [[[0.0] * 3] * 24] * 1000}).encode()
    one = http.client.HTTPConnection(*narrow_address, timeout=PATIENT_S)
    one.sock = socket.socket()
    one.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    one.sock.connect(narrow_address)
    one.request("POST", "/drape", poses, {"Content-Type": "application/json"})
    answer = one.getresponse()
    first = answer.read(1)
    time.sleep(0.4 * connection_times.READ_S)
    assert answer.status == 200 and len(first + answer.read()) > 1000 * 216 * 6  # bytes: numbers of frames
    time.sleep(2.5 * connection_times.READ_S)
    one.request("GET", "/livez")
    assert one.getresponse().status == 200
    one.close()


def test_a_stream_has_no_time_for_another_head(narrow_address: tuple[str, int]):
    """Its connection began as one of HTTP, whose times end with that."""
    host, port = narrow_address

    async def talk() -> int:
        async with await DrapeStream.open(f"http://{host}:{port}", "tube") as stream:
            await asyncio.sleep(1.5 * connection_times.HEAD_S)
            await stream.send(np.zeros((24, 3)))
            return len((await stream.receive()).frame.positions)

    assert asyncio.run(talk()) == 216
