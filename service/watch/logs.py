"""Log lines as JSON or text, and the middleware that logs, counts and traces each request.

Every request has an id and leaves one line, one count and, with tracing, one span: ``RequestLog``. A line never has
headers, query strings or bodies, because these hold keys, tickets and people's measurements.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import sys
import time
import uuid
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drape.errors import legible
from service.errors import Draining, InternalError, problem_response
from service.watch.outputs import log_time
from service.watch.probes import PATHS

if TYPE_CHECKING:
    from service.watch.prometheus import Metrics
    from service.watch.tracing import Tracing

HEADER = "X-Request-Id"
LEFT = 499  # the status in logs and metrics of a request whose client went away before its answer
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_STARTS = {"http.response.start", "websocket.accept", "websocket.http.response.start"}
log = logging.getLogger("drape.access")


@dataclass(frozen=True)
class Asker:
    """The request that is being answered: its id, the IP address of its client ("" if unknown), and its ASGI scope."""

    request: str
    client: str
    scope: Scope


ASKER: ContextVar[Asker | None] = ContextVar("asker", default=None)
FIELDS = ("method", "path", "status", "ms")  # further fields that a record may have
UVICORN_WEBSOCKET = '%s - "WebSocket %s"'  # Uvicorn's lines of WebSockets have query strings, so ours replace them


class JsonLines(logging.Formatter):
    """Formats a record as one line of JSON: time (UTC), level, logger, message, the request's id and client, those of
    ``FIELDS`` that it has, and the traceback of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        document = {
            "time": log_time(record.created),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **_about(record),
        }
        if record.exc_info:
            document["exception"] = self.formatException(record.exc_info)
        return json.dumps(document, ensure_ascii=False)


class TextLines(logging.Formatter):
    """Formats a record as text for people at a terminal: a line with local time, level, message and fields, and the
    traceback of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        fields = " ".join(f"{name}={value}" for name, value in _about(record).items())
        line = f"{time.strftime('%H:%M:%S', time.localtime(record.created))} {record.levelname} {record.getMessage()}"
        trace = "\n" + self.formatException(record.exc_info) if record.exc_info else ""
        return f"{line} {fields}".rstrip() + trace


def _about(record: logging.LogRecord) -> dict[str, object]:
    asker = ASKER.get()
    who: dict[str, object] = {} if asker is None else {"request": asker.request, "client": asker.client}
    return who | {name: getattr(record, name) for name in FIELDS if hasattr(record, name)}


def _without_queries(record: logging.LogRecord) -> bool:
    return not (record.name == "uvicorn.error" and str(record.msg).startswith(UVICORN_WEBSOCKET))


def set_up(form: Literal["json", "text"]) -> None:
    """Makes all loggers of this process write to standard error in the format ``form``, from level INFO on."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    handler.addFilter(_without_queries)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def request_id(headers: Headers) -> str:
    """Returns the header X-Request-Id of a request if it has at most 64 letters, digits, dots, dashes and underscores;
    else a new id of 32 hexadecimal digits."""
    sent = headers.get(HEADER, "")
    return sent if _ID.fullmatch(sent) else uuid.uuid4().hex


class RequestLog:
    """The outermost middleware: logs, counts and traces each request, and adds its id to the answer. A fault of ours is
    answered with ``InternalError`` and logged with its traceback; a client that goes away is logged without one."""

    def __init__(self, app: ASGIApp, metrics: Metrics, tracing: Tracing) -> None:
        self.app, self._metrics, self._tracing = app, metrics, tracing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers, method = Headers(scope=scope), scope.get("method", "WS")
        asker = Asker(request_id(headers), scope["client"][0] if scope.get("client") else "", scope)
        token = ASKER.set(asker)
        try:
            with self._tracing.request(method, headers, asker.request) as span:
                begun_s, status = time.perf_counter(), LEFT
                try:
                    status = await self._answer(scope, receive, send, asker)
                finally:
                    span.note_answer(method, logged_path(scope), status)
                    self._log(scope, method, status, time.perf_counter() - begun_s)
        finally:
            ASKER.reset(token)

    async def _answer(self, scope: Scope, receive: Receive, send: Send, asker: Asker) -> int:
        """Answers the request. Returns the status of the answer, ``LEFT`` if there is none."""
        status = 0

        async def send_named(message: Message) -> None:
            nonlocal status
            if message["type"] in _STARTS:
                status = message.get("status", 101)
                message.setdefault("headers", [])
                MutableHeaders(scope=message)[HEADER] = asker.request
            await send(message)

        try:
            await self.app(scope, receive, send_named)
        except ClientDisconnect:  # before its answer, or in the middle of it
            pass
        except asyncio.CancelledError:  # the service ends and waits no longer
            if scope["type"] == "http" and not status:
                await problem_response(Draining())(scope, receive, send_named)
        except Exception:
            log.exception("a request failed")
            if scope["type"] == "http" and not status:
                await problem_response(InternalError())(scope, receive, send_named)
        return status or LEFT

    def _log(self, scope: Scope, method: str, status: int, took_s: float) -> None:
        path = logged_path(scope)
        self._metrics.requests.labels(method, path, str(status)).inc()
        if scope["type"] == "http":
            self._metrics.request_seconds.labels(path).observe(took_s)
        fields = {"method": method, "path": legible(scope["path"][:200]), "status": status}
        level = logging.DEBUG if scope["path"] in PATHS else logging.INFO
        message = "answered" if status != LEFT else "the client left"
        log.log(level, message, extra=fields | {"ms": round(1e3 * took_s, 1)})


def logged_path(scope: Scope) -> str:
    """Returns the path of the request's route, with the names of parameters in place of their values; "page" for files
    of the page and unknown paths."""
    route: Any = scope.get("route")
    return getattr(route, "path", "") or "page"
