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
    """What the service answers; nothing while it does not listen or is not ready."""
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", body, {"Content-Type": kind})
    try:
        with OPENER.open(request, timeout=30) as found:
            return found.read()
    except urllib.error.HTTPError as error:
        if error.code != 503:
            raise
    except OSError:
        pass
    return b""


def drape(port: int) -> int:
    """Asserts that a shirt is draped and that the page is there; the number of vertices."""
    assert b"<script" in answer(port, "/"), "the page"
    places = array.array("f", answer(port, "/drape", json.dumps(ASKED).encode()))
    assert len(places) > 3000 and all(map(math.isfinite, places)), "a draped shirt"
    return len(places) // 3
