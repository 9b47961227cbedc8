"""What a release's trials ask of the service that they have started on a port of this machine."""

from __future__ import annotations

import array
import json
import math
import urllib.error
import urllib.request

ASKED = {"garment": "tshirt", "poses": [[[0.0, 0.0, 0.0]] * 24]}
# No proxy knows of a service on this machine.
OPENER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def answer(port: int, path: str, body: bytes | None = None, kind: str = "application/json") -> bytes:
    """Returns the body of the answer of the service on ``port``: to GET ``path``, or to POST with a ``body`` of the
    media type ``kind``. Empty while no service listens there or it is not ready (503).

    Raises ``HTTPError`` for any other error status.
    """
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", body, {"Content-Type": kind})
    try:
        with OPENER.open(request, timeout=30) as response:
            return response.read()
    except urllib.error.HTTPError as error:
        if error.code != 503:
            raise
    except OSError:
        pass
    return b""


def drape(port: int) -> int:
    """Asserts that the service on ``port`` has the page and drapes a shirt. Returns the shirt's number of vertices."""
    assert b"<script" in answer(port, "/"), "the page"
    places = array.array("f", answer(port, "/drape", json.dumps(ASKED).encode()))
    assert len(places) > 3000 and all(map(math.isfinite, places)), "a draped shirt"
    return len(places) // 3
