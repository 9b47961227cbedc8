"""Whether the service lives and takes work, and who says so: ``Lifecycle``, and ``Probes`` on a port of its own.

The event loop says that it turns, a few times a second. ``/livez`` and ``/readyz`` on the service's port wait for
nothing but that loop, and ``/metrics`` for frames of streams. ``Probes`` is a thread with a port of its own
(``DRAPE_PROBE_PORT``). It sees a loop that has stopped turning, and it answers while models load.
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
CLIENT_S = 2.0  # for one request of one client
MOST_CLIENTS = 16

Answer = tuple[int, str, bytes]
TICK_S = 0.25


class Lifecycle:
    """Loading, ready or draining, and when the event loop last came round; read from any thread."""

    def __init__(self, *, stuck_s: float) -> None:
        self._stuck_s = stuck_s
        self._ready = self.draining = False
        self.hurried = False  # what is not through by now is told to come again
        self._turned_s: float | None = None
        self.still: dict[str, float] = {}  # for how long [s] the oldest job of each lane has not moved: ``Watchdog``
        self.works: dict[str, Callable[[], bool]] = {}  # what must be running, by name

    def ready(self) -> None:
        """Says that everything is loaded."""
        self._ready = True

    async def tick(self, lag: Callable[[float], None]) -> None:
        """Says again and again that the loop turns, and tells ``lag`` how late [s] it came round."""
        while True:
            begun_s = self._turned_s = time.monotonic()
            await asyncio.sleep(TICK_S)
            lag(max(0.0, time.monotonic() - begun_s - TICK_S))

    def ended(self) -> None:
        """Says that the loop has ended in good order: it need not turn any more."""
        self._turned_s = None

    @property
    def loop_still_s(self) -> float:
        """For how long [s] the event loop has not come round."""
        return 0.0 if self._turned_s is None else time.monotonic() - self._turned_s

    def unhealthy(self) -> DrapeError | None:
        """Why the process should be replaced; None while it lives."""
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
        """Why no work should be sent here; None while it is welcome."""
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
    """Status, media type and content for one of ``PATHS``."""
    if path == "/metrics":
        return 200, MEDIA_TYPE, metrics.text()
    wrong = lifecycle.unhealthy() if path == "/livez" else lifecycle.unready()
    if wrong is None:
        return 200, JSON, b'{"status": "ok"}'
    return _refusal(wrong)


def _refusal(error: DrapeError) -> Answer:
    document = problem_of(error)
    return document["status"], PROBLEM, json.dumps(document).encode()


class Probes(ThreadingHTTPServer):
    """Answers probes (``probe_answer``) from a thread of its own on a listening socket; ``with`` starts and ends it."""

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
        """Answers in a thread of its own; hangs up while ``MOST_CLIENTS`` are being answered."""
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
        """Does nothing: a client that left is no error of ours."""


class _Handler(BaseHTTPRequestHandler):
    timeout = CLIENT_S
    server: BaseServer

    def do_GET(self) -> None:
        path, server = self.path.partition("?")[0], self.server
        assert isinstance(server, Probes)
        found: Answer = (404, "text/plain", f"expected one of {', '.join(PATHS)}\n".encode())
        if path in PATHS:
            found = probe_answer(path, server.lifecycle, server.metrics)
        status, kind, content = found
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    log_message: Callable[..., None] = lambda *arguments: None
