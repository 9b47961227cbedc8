"""Every request leaves one line, one count and, where asked for, spans; none tells what a client sent."""

from __future__ import annotations

import gzip
import http.server
import json
import logging
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import httpx
import numpy as np
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span, Status
from websockets.sync.client import connect

from drape.errors import Unavailable
from drape.garment.cache import Garment
from drape.wire import messages as wire
from drape.wire.options import DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.watch.logs import JsonLines, TextLines, set_up
from service.watch.tracing import Tracing, make_tracing
from tests.architecture.repository import ROOT
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import ended_job, wait_until
from tests.fixtures.serving import serve, served
from tests.fixtures.streams import PROTOCOLS, raw_stream, stream_address


@contextmanager
def written(form: logging.Formatter, wanted: Callable[[dict], bool] | None = None) -> Iterator[list[str]]:
    """Lines of all loggers, as ``form`` writes them; waits at the end for one that is ``wanted``."""
    lines: list[str] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if not record.name.startswith(("httpx", "httpcore", "websockets.client")):  # the client's own
                lines.append(self.format(record))

    kept, root = Kept(), logging.getLogger()
    kept.setFormatter(form)
    level = root.level
    root.addHandler(kept)
    root.setLevel(logging.INFO)
    try:
        yield lines
        if wanted:
            wait_until(lambda: any(wanted(json.loads(line)) for line in list(lines)), missing=str(lines))
    finally:
        root.removeHandler(kept)
        root.setLevel(level)


def test_an_id_is_taken_or_made_and_given_back(live: str):
    assert httpx.get(live + "/garments", headers={"X-Request-Id": "page-7.a_B"}).headers["X-Request-Id"] == "page-7.a_B"
    for bad in ("", "two words", "x" * 65, "a\tb", "(7)"):
        made = httpx.get(live + "/nothing", headers={"X-Request-Id": bad}).headers["X-Request-Id"]
        assert len(made) == 32 and made != bad
    with connect(stream_address(live), subprotocols=PROTOCOLS, additional_headers={"X-Request-Id": "s1"}) as opened:
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
    with written(JsonLines()) as lines:
        for path in ("/drape", "/garments?name=a.obj"):
            half = socket.create_connection((host, int(port)))
            half.sendall(f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n".encode())
            half.sendall(b"Content-Length: 100\r\n\r\n{")
            time.sleep(0.1)
            cut(half)
        for said in (None, {"type": "open", "garment": "tube"}):
            with connect(stream_address(live), subprotocols=PROTOCOLS) as opened:
                if said is not None:
                    opened.send(json.dumps(said))
                    opened.recv()
                    for sequence in range(3):
                        opened.send(wire.pack_pose(wire.Pose(sequence, 0.0, np.zeros(3), np.zeros((24, 3)))))
                cut(opened.socket)
        wait_until(lambda: sum('"drape.access"' in line for line in list(lines)) == 4)
    assert any(json.loads(line).get("status") == 499 for line in lines)
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
        wait_until(lambda: any("request=told" in line for line in list(lines)))
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


TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
REST = np.zeros((1, 24, 3)).tolist()


class Collector(http.server.ThreadingHTTPServer):
    """What OTLP over HTTP brings; ``spans`` and ``resource`` of all of it."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Taking)
        self.spans: list[Span] = []
        self.resource: dict[str, str] = {}
        self.url = f"http://127.0.0.1:{self.server_address[1]}"

    def named(self, name: str) -> list[Span]:
        return [span for span in self.spans if span.name == name]


class _Taking(http.server.BaseHTTPRequestHandler):
    server: Collector

    def do_POST(self) -> None:
        content = self.rfile.read(int(self.headers["Content-Length"]))
        if self.headers.get("Content-Encoding") == "gzip":
            content = gzip.decompress(content)
        for one in ExportTraceServiceRequest.FromString(content).resource_spans:
            self.server.resource |= {pair.key: pair.value.string_value for pair in one.resource.attributes}
            self.server.spans += [span for scope in one.scope_spans for span in scope.spans]
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    with Collector() as made:
        thread = threading.Thread(target=made.serve_forever, daemon=True)
        thread.start()
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", made.url)
        yield made
        made.shutdown()
        thread.join()


def attributes(span: Span) -> dict[str, str | int]:
    return {pair.key: pair.value.string_value or pair.value.int_value for pair in span.attributes}


def test_a_request_has_a_span_under_its_clients_and_a_child_per_stage(make_settings, collector: Collector):
    settings = make_settings(trace=True)
    runtime = DrapeRuntime(settings)
    with serve(create_app(settings, runtime=runtime), settings) as url:
        sent = {"traceparent": f"00-{TRACE}-{PARENT}-01", "X-Request-Id": "page-7", "Authorization": "Bearer secret"}
        answer = httpx.post(url + "/drape?token=hidden", json={"garment": "cape", "poses": REST}, headers=sent)
        assert answer.status_code == 404
        answer = httpx.post(url + "/drape", json={"garment": "tube", "poses": REST}, headers=sent)
        assert answer.status_code == 200
        stages = [stage.name for stage in runtime.plan(runtime.garments.get("tube"), DrapeOptions()).stages]
        httpx.get(url + "/garments/tube")
    refused, draped = collector.named("POST /drape")
    for span, status in ((refused, 404), (draped, 200)):
        assert span.trace_id.hex() == TRACE and span.parent_span_id.hex() == PARENT
        assert attributes(span) == {
            "http.request.method": "POST",
            "http.route": "/drape",
            "http.response.status_code": status,
            "drape.request": "page-7",
        }
    children = [span for span in collector.spans if span.parent_span_id == draped.span_id]
    assert len(stages) >= 2 and [span.name for span in children] == stages
    for span in children:
        assert draped.start_time_unix_nano <= span.start_time_unix_nano <= span.end_time_unix_nano
        assert span.end_time_unix_nano <= draped.end_time_unix_nano
    (other,) = collector.named("GET /garments/{garment_id}")
    assert other.parent_span_id == b"" and other.trace_id.hex() != TRACE
    assert collector.resource["service.name"] == "drape" and "service.version" in collector.resource
    assert not any(secret in str(collector.spans) for secret in ("secret", "hidden"))


def test_frames_of_streams_are_traces_of_their_own_with_links_to_their_streams(make_settings, collector: Collector):
    with served(make_settings(trace=True)) as url, raw_stream(url) as stream:
        stream.open(garment="tube")
        for turn in range(3):
            stream.message(turn, np.full((24, 3), 0.1 * turn))
    (whole,) = collector.named("WS /stream")
    assert attributes(whole)["http.response.status_code"] == 101
    frames = collector.named("frames")
    assert len(frames) == 3
    for span in frames:
        assert span.parent_span_id == b"" and span.trace_id != whole.trace_id
        assert [link.span_id for link in span.links] == [whole.span_id]
        assert attributes(span) == {"drape.frames": 1, "drape.tier": "custom"}
        assert len([child for child in collector.spans if child.parent_span_id == span.span_id]) >= 2


def test_an_upload_is_a_trace_with_a_link_to_its_request(make_settings, collector: Collector, tube: Garment):
    with served(make_settings(trace=True)) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        for name, content in (("sleeve.obj", garment_obj(tube)), ("broken.obj", b"v 0 0 0\n")):
            sent = {"name": name, "avatar": "standard"}
            told = ended_job(client, client.post("/garments", content=content, params=sent))
            assert told["state"] == ("done" if name == "sleeve.obj" else "failed"), told
    good, bad = collector.named("upload")
    requests = collector.named("POST /garments")
    assert [span.links[0].span_id for span in (good, bad)] == [span.span_id for span in requests]
    assert [event.name for event in good.events][-1] == "prepare" and len(good.events) >= 4
    assert good.status.code == Status.STATUS_CODE_UNSET
    assert bad.status.code == Status.STATUS_CODE_ERROR and bad.status.message == "MeshError"


def test_the_sdks_own_variables_choose(collector: Collector, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OTEL_SERVICE_NAME", "fitting-room")
    tracing = make_tracing(True)
    with tracing.request("GET", {}, "a") as answered:
        answered.note_answer("GET", "/health", 500)
    tracing.close()
    (span,) = collector.spans
    assert collector.resource["service.name"] == "fitting-room" and span.status.code == Status.STATUS_CODE_ERROR
    monkeypatch.setenv("OTEL_TRACES_SAMPLER", "always_off")
    sparing = make_tracing(True)
    with sparing.work("frames"):
        pass
    sparing.close()
    assert len(collector.spans) == 1


def test_what_work_raises_is_noted_by_its_class_alone(collector: Collector):
    tracing = make_tracing(True)
    with pytest.raises(ValueError, match="secret"), tracing.work("frames"):
        raise ValueError("secret")
    tracing.close()
    (span,) = collector.spans
    assert span.status.message == "ValueError" and not span.events and "secret" not in str(span)


def test_a_collector_that_is_away_does_not_hold_the_end(monkeypatch: pytest.MonkeyPatch):
    with Collector() as deaf:  # takes connections and answers none
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", deaf.url)
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_TIMEOUT", "60")  # for which it would wait by itself
        tracing = make_tracing(True)
        with tracing.work("frames"):
            pass
        begun_s = time.monotonic()
        tracing.close()
        assert time.monotonic() - begun_s < 50.0


def test_nothing_happens_and_nothing_is_loaded_where_nobody_asks():
    code = """
import sys
from service.watch.tracing import make_tracing
tracing = make_tracing(False)
with tracing.request("GET", {}, "a") as answered, tracing.work("frames", [tracing.here()]):
    tracing.stage("network", 0.1)
    tracing.event("fit")
    answered.note_answer("GET", "/health", 200)
tracing.close()
assert not tracing.on and tracing.here() is None
assert not [name for name in sys.modules if name.startswith(("opentelemetry.sdk", "opentelemetry.exporter"))]
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_outside_of_any_span_there_is_nothing_to_link_to():
    assert make_tracing(True).here() is None


def test_without_the_packages_the_start_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(Unavailable, match=r"DRAPE_TRACE: expected the packages of the extra 'otel'.*pip install"):
        make_tracing(True)
    assert not Tracing().on
