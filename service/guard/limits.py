"""Limits on the size and pace of request bodies, on the memory that all of them take, and on the size of answers."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import TYPE_CHECKING

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drape.errors import DrapeError, TooLarge
from service.errors import Busy, Draining, TooSlow, problem_response

if TYPE_CHECKING:
    from service.settings import Settings
    from service.watch.probes import Lifecycle

STORED_PATHS = ("/garments", "/avatars")
UPLOAD_PATHS = (*STORED_PATHS, "/motions")  # the routes whose bodies are files
JSON = "application/json"  # such a body stays in memory until it is whole
IDLE_S = 10.0  # the longest pause of a body
PACE_BYTES_S = 16384  # the least mean pace of a body
HELD_BYTES = 80 * 2**20  # the most of all request bodies in memory; also the most of all states that streams bring
LOOK_S = 0.5  # between two looks at whether the service ends


def check_answer(size: int, what: str, settings: Settings) -> None:
    """Refuses (``TooLarge``) an answer of about ``size`` bytes above ``max_answer_bytes``. ``what`` says in the refusal
    what the answer is for."""
    limit = settings.max_answer_bytes
    if size > limit:
        raise TooLarge(
            "answer", expected=f"at most {limit} bytes", got=f"about {size} for {what}", cure="Send the clip in pieces."
        )


class BodyLimit:
    """A middleware that limits request bodies as they are read: the size and the pace of each, and the memory that all
    take together. A file as a raw body goes to disk piece by piece and takes no memory.

    Nothing is read before the route asks for it, so a request that is refused by its head costs no memory. The refusal
    (``TooLarge``, ``TooSlow``, ``Busy``, ``Draining``) is raised where the route reads the body.
    """

    def __init__(self, app: ASGIApp, settings: Settings, lifecycle: Lifecycle) -> None:
        self.app, self._settings, self._life = app, settings, lifecycle
        self._held = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        body = _Body(self._settings, self._life, upload=scope["path"] in UPLOAD_PATHS)
        to_disk = body.upload and JSON not in headers.get("content-type", "").lower()
        declared = headers.get("content-length", "")
        try:
            if declared.isdigit() and len(declared) < 20:
                body.check_size(int(declared))
                if not to_disk:
                    self._check_held(int(declared))
        except DrapeError as error:
            await problem_response(error)(scope, receive, send)
            return

        async def receive_checked() -> Message:
            if body.ended:
                return await receive()
            message = await body.next(receive)
            if not to_disk:
                size = len(message.get("body", b""))
                self._check_held(size)
                self._held += size
            return message

        try:
            await self.app(scope, receive_checked, send)
        finally:
            self._held -= 0 if to_disk else body.size

    def _check_held(self, more: int) -> None:
        if more and self._held + more > HELD_BYTES:
            raise Busy(
                "request bodies",
                expected=f"at most {HELD_BYTES} bytes of all requests together",
                got=f"{self._held} and {more} more",
                cure="Try again in a second, or send a garment as the raw body.",
            )


class _Body:
    """The body of one request: its ``size`` so far in bytes, since when it comes, and whether it has ended."""

    def __init__(self, settings: Settings, lifecycle: Lifecycle, *, upload: bool) -> None:
        self._settings, self._life, self.upload = settings, lifecycle, upload
        self._limit = settings.max_upload_bytes if upload else settings.max_body_bytes
        self._begun_s = time.monotonic()
        self.size, self.ended = 0, False

    def check_size(self, size: int) -> None:
        """Refuses (``TooLarge``) a body of ``size`` bytes or more above the limit."""
        if size > self._limit:
            cure = f"Send less, or raise DRAPE_MAX_{'UPLOAD' if self.upload else 'BODY'}_BYTES."
            expected = f"at most {self._limit} bytes"
            raise TooLarge("request body", expected=expected, got=f"{size} or more", cure=cure)

    async def next(self, receive: Receive) -> Message:
        """Returns the next message with a piece of the body. Refuses a body that is too slow or too large."""
        until_s = min(self._begun_s + IDLE_S + self.size / PACE_BYTES_S, time.monotonic() + IDLE_S)
        message = None
        while message is None:
            with contextlib.suppress(TimeoutError):
                rest_s = max(0.0, until_s - time.monotonic())
                message = await asyncio.wait_for(receive(), min(LOOK_S, rest_s))
            if message is not None:
                break
            if self._life.hurried:
                raise Draining
            if time.monotonic() < until_s:
                continue
            raise TooSlow(
                "request body",
                expected=f"a piece within {IDLE_S:g} s, and {PACE_BYTES_S} bytes a second",
                got=f"{self.size} bytes in {time.monotonic() - self._begun_s:.1f} s",
                cure="Send faster.",
            )
        size = len(message.get("body", b""))
        self.check_size(self.size + size)
        self.size += size
        self.ended = message["type"] != "http.request" or not message.get("more_body", False)
        return message
