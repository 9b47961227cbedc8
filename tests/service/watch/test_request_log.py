"""Request ids, and log lines that say who and when and nothing secret."""

from __future__ import annotations

import json
import logging
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import httpx
import numpy as np
import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from drape.wire import messages as wire
from service.watch.logs import JsonLines, TextLines, set_up

PROTOCOLS = [Subprotocol(wire.SUBPROTOCOL)]


@contextmanager
def written(form: logging.Formatter, wanted: Callable[[dict], bool] | None = None) -> Iterator[list[str]]:
    """Lines of all loggers, as ``form`` writes them; waits at the end for one that is ``wanted``."""
    lines: list[str] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if not record.name.startswith(("httpx", "httpcore")):  # the client's own
                lines.append(self.format(record))

    kept, root = Kept(), logging.getLogger()
    kept.setFormatter(form)
    level = root.level
    root.addHandler(kept)
    root.setLevel(logging.INFO)
    try:
        yield lines
        deadline = time.monotonic() + 5.0
        while wanted and not any(wanted(json.loads(line)) for line in list(lines)):
            assert time.monotonic() < deadline, lines
            time.sleep(0.01)
    finally:
        root.removeHandler(kept)
        root.setLevel(level)


def test_an_id_is_taken_or_made_and_given_back(live: str):
    assert httpx.get(live + "/garments", headers={"X-Request-Id": "page-7.a_B"}).headers["X-Request-Id"] == "page-7.a_B"
    for bad in ("", "two words", "x" * 65, "a\tb", "(7)"):
        made = httpx.get(live + "/nothing", headers={"X-Request-Id": bad}).headers["X-Request-Id"]
        assert len(made) == 32 and made != bad
    address = live.replace("http", "ws") + "/stream"
    with connect(address, subprotocols=PROTOCOLS, additional_headers={"X-Request-Id": "s1"}) as opened:
        assert opened.response is not None and opened.response.headers["X-Request-Id"] == "s1"


def test_a_line_has_time_client_and_request_and_no_secret(live: str):
    with written(JsonLines(), lambda line: line.get("request") == "told") as lines:
        headers = {"X-Request-Id": "told", "Authorization": "Bearer s3cret"}
        httpx.get(live + "/garments/cape?key=s3cret", headers=headers)
    (line,) = [json.loads(text) for text in lines if '"told"' in text]
    assert line.pop("time").startswith("20") and line.pop("ms") >= 0.0
    assert line == {
        "level": "info",
        "logger": "drape.access",
        "message": "answered",
        "request": "told",
        "client": "127.0.0.1",
        "method": "GET",
        "path": "/garments/cape",
        "status": 404,
    }
    assert not any("s3cret" in text for text in lines)


def test_probes_leave_no_line(live: str):
    with written(JsonLines(), lambda line: line.get("path") == "/garments") as lines:
        for path in ("/livez", "/readyz", "/metrics", "/garments"):
            httpx.get(live + path)
    assert {json.loads(text).get("path") for text in lines} & {"/livez", "/readyz", "/metrics"} == set()


def cut(connection: socket.socket) -> None:
    """Ends a connection with a reset, as a client that was killed."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def test_clients_that_go_away_leave_no_traceback(live: str):
    host, port = live.removeprefix("http://").split(":")
    with written(JsonLines(), lambda line: line.get("status") == 499) as lines:
        for path in ("/drape", "/garments?name=a.obj"):
            half = socket.create_connection((host, int(port)))
            half.sendall(f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n".encode())
            half.sendall(b"Content-Length: 100\r\n\r\n{")
            time.sleep(0.1)
            cut(half)
        for said in (None, {"type": "open", "garment": "tube"}):
            with connect(live.replace("http", "ws") + "/stream", subprotocols=PROTOCOLS) as opened:
                if said is not None:
                    opened.send(json.dumps(said))
                    opened.recv()
                    for sequence in range(3):
                        opened.send(wire.pack_pose(wire.Pose(sequence, 0.0, np.zeros(3), np.zeros((24, 3)))))
                cut(opened.socket)
        time.sleep(0.5)
    assert [line for line in lines if "exception" in json.loads(line)] == []
    assert [line for line in lines if json.loads(line)["level"] in ("warning", "error")] == []


def test_a_fault_of_ours_leaves_its_traceback_under_the_request(live: str, monkeypatch: pytest.MonkeyPatch):
    def broken(self: object) -> list:
        raise ValueError("broken on purpose")

    monkeypatch.setattr("service.compute.garments.Registry.entries", broken)
    with written(JsonLines(), lambda line: "exception" in line) as lines:
        response = httpx.get(live + "/garments", headers={"X-Request-Id": "fault"})
        assert response.status_code == 500 and "broken" not in response.text
    (line,) = [json.loads(text) for text in lines if "broken on purpose" in text]
    assert response.headers["X-Request-Id"] == "fault"
    assert line["request"] == "fault" and "ValueError: broken on purpose" in line["exception"]


def test_text_lines_say_the_same(live: str):
    with written(TextLines()) as lines:
        httpx.get(live + "/garments/cape", headers={"X-Request-Id": "told"})
        logging.getLogger("drape.test").error("wrong", exc_info=ValueError("so"))
        time.sleep(0.2)
    assert any("INFO answered request=told client=127.0.0.1 method=GET path=/garments/cape" in line for line in lines)
    assert any(line.endswith("ValueError: so") for line in lines)


def test_the_set_up_writes_to_standard_error_and_hides_queries_of_streams(capsys: pytest.CaptureFixture[str]):
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        for form in ("json", "text"):
            set_up(form)
            logging.getLogger("uvicorn.error").info('%s - "WebSocket %s" [accepted]', "1.2.3.4", "/stream?key=s3cret")
            logging.getLogger("drape.test").info("said %d", 3)
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
    first, second = capsys.readouterr().err.splitlines()
    assert json.loads(first)["message"] == "said 3" and second.endswith("INFO said 3")
