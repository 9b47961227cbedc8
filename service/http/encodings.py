"""What clients take compressed, and answers of JSON so short that the event loop may compress them."""

from __future__ import annotations

import gzip

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LEAST, MOST = 1 << 10, 1 << 16  # bytes: what is less gains nothing, what is more would keep frames waiting
LEVEL = 4  # of compression: of ``MOST`` in a millisecond
JSON = "json"  # in the media types of documents and of problems


def accepts(asked: str, encoding: str) -> bool:
    """Whether ``asked``, the header Accept-Encoding, takes ``encoding``."""
    for part in asked.split(","):
        name, _, quality = part.partition(";")
        if name.strip().lower() == encoding:
            return quality.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


class BriefJson:
    """Compresses an answer of JSON that comes in one piece of ``LEAST`` to ``MOST`` bytes, for who takes that. All
    others pass as they are: those in pieces, streams, files."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not accepts(Headers(scope=scope).get("accept-encoding", ""), "gzip"):
            await self.app(scope, receive, send)
            return
        held: list[Message] = []

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start" and _is_json(message):
                held.append(message)  # until its body has come
                return
            if held:
                start = held.pop()
                await send(start if message.get("more_body") else _packed(start, message))
            await send(message)

        await self.app(scope, receive, sent)


def _is_json(start: Message) -> bool:
    headers = Headers(raw=start["headers"])
    return JSON in headers.get("content-type", "") and "content-encoding" not in headers


def _packed(start: Message, message: Message) -> Message:
    """``start`` for the body of ``message``, which becomes a compressed one where that pays."""
    if LEAST <= len(message.get("body", b"")) <= MOST:
        message["body"] = gzip.compress(message["body"], LEVEL, mtime=0)
        headers = MutableHeaders(raw=start["headers"])
        headers["Content-Encoding"], headers["Content-Length"] = "gzip", str(len(message["body"]))
        headers.add_vary_header("Accept-Encoding")
    return start
