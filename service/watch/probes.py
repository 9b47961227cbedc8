"""Whether the service is alive and ready: ``Lifecycle`` knows it, and ``Probes`` answers on a port of its own.

The event loop notes a few times a second that it turns. On the service's port ``/livez`` and ``/readyz`` wait only for
that loop, and ``/metrics`` for frames of streams. ``Probes`` is a thread with its own port (``DRAPE_PROBE_PORT``), so
it also answers while models load and when the loop stands still.
"""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import BaseServer

from drape.errors import DrapeError, Unavailable
from service.errors import PROBLEM, problem_of
from service.watch.prometheus import MEDIA_TYPE, Metrics

JSON = "application/json"
PATHS = ("/livez", "/readyz", "/metrics")
CLIENT_S = 2.0  # the time for one request of a client of ``Probes``
MOST_CLIENTS = 16

Answer = tuple[int, str, bytes]
TICK_S = 0.25


class Lifecycle:
    """The state of a service: loading, ready or draining, and when the event loop last turned. Any thread may read it.
    A job or loop that stands still for ``stuck_s`` [s] makes it unhealthy."""

    def __init__(self, *, stuck_s: float) -> None:
        self._stuck_s = stuck_s
        self._ready = self.draining = False
        self.hurried = False  # true when requests that still run are refused, as the service ends
        self._turned_s: float | None = None
        self.still: dict[str, float] = {}  # how long [s] the oldest job of each lane has not moved (``Watchdog``)
        self.works: dict[str, Callable[[], bool]] = {}  # whether parts of a ready service run, by their names

    def ready(self) -> None:
        """Marks the service as loaded."""
        self._ready = True

    async def tick(self, lag: Callable[[float], None]) -> None:
        """Notes every ``TICK_S`` that the event loop turns, and calls ``lag`` with how late [s] it was. Runs until it
        is cancelled."""
        while True:
            begun_s = self._turned_s = time.monotonic()
            await asyncio.sleep(TICK_S)
            lag(max(0.0, time.monotonic() - begun_s - TICK_S))

    def ended(self) -> None:
        """Notes that the event loop has ended, so that it is not expected to turn."""
        self._turned_s = None

    @property
    def loop_still_s(self) -> float:
        """How long [s] ago the event loop last turned; 0 before it begins and after it ends."""
        return 0.0 if self._turned_s is None else time.monotonic() - self._turned_s

    def unhealthy(self) -> DrapeError | None:
        """Returns why the process should be replaced: the loop or a job that stands still. None if it is healthy."""
        waits = self.still | {"event loop": self.loop_still_s}
        lane = max(waits, key=waits.__getitem__)
        if waits[lane] <= self._stuck_s:
            return None
        return Unavailable(
            lane,
            expected=f"a {'turn' if lane == 'event loop' else 'move'} within {self._stuck_s:g} s",
            got=f"none for {waits[lane]:.1f} s",
            cure="Restart the service and keep its log.",
        )

    def unready(self) -> DrapeError | None:
        """Returns why no requests should be sent to this process: it loads, drains or is unhealthy, or a part has
        stopped. None if it is ready."""
        stopped = [name for name, runs in self.works.items() if not runs()]
        for got, reason in (("one that drains", self.draining), ("one that still loads", not self._ready)):
            if reason:
                cure = "Ask another replica, or again in a few seconds."
                return Unavailable("service", expected="one that takes work", got=got, cure=cure)
        if stopped:
            cure = "Restart the service; its log has the cause."
            return Unavailable("service", expected=f"running {stopped[0]}", got="one that has stopped", cure=cure)
        return self.unhealthy()


def probe_answer(path: str, lifecycle: Lifecycle, metrics: Metrics) -> Answer:
    """Returns the status, the media type and the body of the answer to GET ``path``, one of ``PATHS``."""
    if path == "/metrics":
        return 200, MEDIA_TYPE, metrics.text()
    fault = lifecycle.unhealthy() if path == "/livez" else lifecycle.unready()
    if fault is None:
        return 200, JSON, b'{"status": "ok"}'
    document = problem_of(fault)
    return document["status"], PROBLEM, json.dumps(document).encode()


class Probes(ThreadingHTTPServer):
    """A server that answers probes (``probe_answer``) on ``listener``, a listening socket, in threads of its own. As a
    context manager it runs while the block runs."""

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
        """Answers ``request``, a connection, in a thread of its own; closes it while ``MOST_CLIENTS`` are answered."""
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
        """Ignores the error: it comes from a client that has left."""


class _Handler(BaseHTTPRequestHandler):
    timeout = CLIENT_S
    server: BaseServer

    def do_GET(self) -> None:
        path, server = self.path.partition("?")[0], self.server
        assert isinstance(server, Probes)
        answer: Answer = (404, "text/plain", f"expected one of {', '.join(PATHS)}\n".encode())
        if path in PATHS:
            answer = probe_answer(path, server.lifecycle, server.metrics)
        status, kind, content = answer
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    log_message: Callable[..., None] = lambda *arguments: None
