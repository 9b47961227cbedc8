"""A limit on request bodies that answers with a problem document."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import TooLarge, problem_response


class BodyLimit:
    """Reads each body up to ``limit`` bytes before the app sees the request.

    Starlette's own limit answers in plain text. Every endpoint needs its whole body
    anyway, so reading it first costs nothing.
    """

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self.app, self.limit = app, limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        declared = dict(scope["headers"]).get(b"content-length", b"")
        size, messages = 0, []
        more = True
        while more:
            if declared.isdigit() and int(declared) > self.limit:
                size = int(declared)
            else:
                message = await receive()
                size += len(message.get("body", b""))
                messages.append(message)
                more = message["type"] == "http.request" and message.get("more_body", False)
            if size > self.limit:
                refusal = TooLarge(
                    "request body",
                    expected=f"at most {self.limit} bytes",
                    got=f"{size} or more",
                    cure="Send less, or raise DRAPE_MAX_BODY_BYTES.",
                )
                await problem_response(refusal)(scope, receive, send)
                return

        async def replay() -> Message:
            return messages.pop(0) if messages else await receive()

        await self.app(scope, replay, send)
