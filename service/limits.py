"""Limits on request bodies, which answer with a problem document, and on answers."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import TooLarge, problem_response
from service.settings import Settings

UPLOAD_PATH = "/garments"


def check_answer(size: int, what: str, settings: Settings) -> None:
    """Refuses (``TooLarge``) an answer of about ``size`` bytes, for ``what``."""
    limit = settings.max_answer_bytes
    if size > limit:
        raise TooLarge(
            "answer",
            expected=f"at most {limit} bytes",
            got=f"about {size} for {what}",
            cure="Send the clip in pieces.",
        )


class BodyLimit:
    """Reads each body up to its limit before the app sees the request; uploads have a limit of their own.

    Starlette's own limit answers in plain text. Every endpoint needs its whole body
    anyway, so reading it first costs nothing.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        upload = scope["path"] == UPLOAD_PATH
        limit = self._settings.max_upload_bytes if upload else self._settings.max_body_bytes
        declared = dict(scope["headers"]).get(b"content-length", b"")
        size = int(declared) if declared.isdigit() and len(declared) < 20 else 0
        messages: list[Message] = []
        more, read = size <= limit, 0
        while more:
            message = await receive()
            messages.append(message)
            read += len(message.get("body", b""))
            size = max(size, read)
            more = size <= limit and message["type"] == "http.request" and message.get("more_body", False)
        if size > limit:
            cure = f"Send less, or raise DRAPE_MAX_{'UPLOAD' if upload else 'BODY'}_BYTES."
            refusal = TooLarge("request body", expected=f"at most {limit} bytes", got=f"{size} or more", cure=cure)
            await problem_response(refusal)(scope, receive, send)
            return

        async def replay() -> Message:
            return messages.pop(0) if messages else await receive()

        await self.app(scope, replay, send)
