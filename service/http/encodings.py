"""Reads the header Accept-Encoding, and compresses short answers of JSON on the event loop."""

from __future__ import annotations

import gzip

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LEAST, MOST = 1 << 10, 1 << 16  # bytes; shorter answers gain nothing, longer ones would delay frames
LEVEL = 4  # of gzip, which compresses ``MOST`` bytes in a millisecond
JSON = "json"  # a part of the media types of documents and of problems


def accepts(header: str, encoding: str) -> bool:
    """Returns whether ``header``, the value of Accept-Encoding, names ``encoding`` with a quality above 0."""
    for part in header.split(","):
        name, _, quality = part.partition(";")
        if name.strip().lower() == encoding:
            return quality.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


class BriefJson:
    """A middleware that compresses (gzip) answers of JSON in one piece of ``LEAST`` to ``MOST`` bytes, for clients that
    accept it. Other answers stay as they are."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not accepts(Headers(scope=scope).get("accept-encoding", ""), "gzip"):
            await self.app(scope, receive, send)
            return
        starts: list[Message] = []

        async def send_compressed(message: Message) -> None:
            if message["type"] == "http.response.start" and _is_json(message):
                starts.append(message)  # its headers depend on the body, which comes next
                return
            if starts:
                start = starts.pop()
                await send(start if message.get("more_body") else _compress(start, message))
            await send(message)

        await self.app(scope, receive, send_compressed)


def _is_json(start: Message) -> bool:
    headers = Headers(raw=start["headers"])
    return JSON in headers.get("content-type", "") and "content-encoding" not in headers


def _compress(start: Message, message: Message) -> Message:
    """Compresses the body of ``message`` if it has the right size, and sets its headers in ``start``. Returns
    ``start``."""
    if LEAST <= len(message.get("body", b"")) <= MOST:
        message["body"] = gzip.compress(message["body"], LEVEL, mtime=0)
        headers = MutableHeaders(raw=start["headers"])
        headers["Content-Encoding"], headers["Content-Length"] = "gzip", str(len(message["body"]))
        headers.add_vary_header("Accept-Encoding")
    return start
