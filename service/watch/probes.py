"""``/livez``, ``/readyz`` and ``/metrics``: on the service's port, and on one of their own that no work keeps waiting.

The routes stand behind nothing that waits: no body, no place, no thread. Yet the loop answers them, so while it is busy
they wait; ``Probes`` is a thread with a port of its own (``DRAPE_PROBE_PORT``), which also answers while models load.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import BaseServer

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.params import Depends

from drape.errors import DrapeError, Unavailable
from service.errors import PROBLEM, Forbidden, problem
from service.http.negotiation import JSON
from service.http.openapi import EVERYWHERE, responses
from service.watch.lifecycle import Lifecycle
from service.watch.metrics import MEDIA_TYPE, Metrics

PATHS = ("/livez", "/readyz", "/metrics")
CLIENT_S = 2.0  # for one request of one client
MOST_CLIENTS = 16

Answer = tuple[int, str, bytes]


def answer(path: str, lifecycle: Lifecycle, metrics: Metrics) -> Answer:
    """Status, media type and content for one of ``PATHS``."""
    if path == "/metrics":
        return 200, MEDIA_TYPE, metrics.text()
    wrong = lifecycle.unhealthy() if path == "/livez" else lifecycle.unready()
    if wrong is None:
        return 200, JSON, b'{"status": "ok"}'
    return _refusal(wrong)


def _refusal(error: DrapeError) -> Answer:
    document = problem(error)
    return document["status"], PROBLEM, json.dumps(document).encode()


def install(app: FastAPI, lifecycle: Lifecycle, metrics: Metrics, admitted: Sequence[Depends]) -> None:
    """Adds the routes to ``app``; ``admitted`` lets nobody but clients at the series."""
    router = APIRouter()

    async def probe(request: Request) -> Response:
        status, kind, content = answer(request.url.path, lifecycle, metrics)
        return Response(content, status, media_type=kind)

    described = {
        "/livez": "200 while the process lives; 503 when it should be replaced.",
        "/readyz": "200 while the service takes work; 503 while it loads or drains.",
        "/metrics": "All series in the text format of Prometheus.",
    }
    for path in PATHS:
        series = path == "/metrics"
        asks = admitted if series else ()
        refusals, kind = (EVERYWHERE, "text/plain") if series else ((Forbidden, Unavailable), JSON)
        router.add_api_route(
            path,
            probe,
            description=described[path],
            response_class=Response,
            name=path[1:],
            dependencies=asks,
            responses=responses(*refusals, kinds=(kind,)),
        )
    app.include_router(router)


class Probes(ThreadingHTTPServer):
    """The same answers from a thread of its own on a listening socket; ``with`` starts and ends it."""

    daemon_threads = True

    def __init__(self, listener: socket.socket, lifecycle: Lifecycle, metrics: Metrics) -> None:
        self.lifecycle, self.metrics = lifecycle, metrics
        self._places = threading.BoundedSemaphore(MOST_CLIENTS)
        self._thread = threading.Thread(target=self.serve_forever, name="drape-probes", daemon=True)
        super().__init__(listener.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.server_address = listener, listener.getsockname()

    def __enter__(self) -> Probes:
        self._thread.start()
        return self

    def __exit__(self, *args: object) -> None:
        self.shutdown()
        self._thread.join()
        self.server_close()

    def process_request(self, request, client_address) -> None:
        """In a thread of its own; hangs up where ``MOST_CLIENTS`` are being answered."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request, client_address) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request, client_address) -> None:
        """A client that left is no error of ours."""


class _Handler(BaseHTTPRequestHandler):
    timeout = CLIENT_S
    server: BaseServer

    def do_GET(self) -> None:
        path, server = self.path.partition("?")[0], self.server
        assert isinstance(server, Probes)
        found: Answer = (404, "text/plain", f"expected one of {', '.join(PATHS)}\n".encode())
        if path in PATHS:
            found = answer(path, server.lifecycle, server.metrics)
        status, kind, content = found
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    log_message: Callable[..., None] = lambda *arguments: None
