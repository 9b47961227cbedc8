"""Log lines with time, client and request: JSON, one object a line, or text; and what each request leaves.

Every request has an id and leaves one line, one count and, where asked for, one span: ``RequestLog``. A line never has
headers, query strings or bodies: keys, tickets and people's measurements travel there.
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
LEFT = 499  # what a log says where the client went away before its answer; nobody gets it
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_STARTS = {"http.response.start", "websocket.accept", "websocket.http.response.start"}
log = logging.getLogger("drape.access")


@dataclass(frozen=True)
class Asker:
    """The request that is being answered: its id, the address of its client, and its scope."""

    request: str
    client: str
    scope: Scope


ASKER: ContextVar[Asker | None] = ContextVar("asker", default=None)
FIELDS = ("method", "path", "status", "ms")  # that a record may have besides
UVICORN_WEBSOCKET = '%s - "WebSocket %s"'  # its lines have query strings; ours say the same without


class JsonLines(logging.Formatter):
    """Each record as one line of JSON: time (UTC), level, logger, message, request, client, and ``FIELDS`` it has."""

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
    """Each record as lines of text, for people at a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        told = " ".join(f"{name}={value}" for name, value in _about(record).items())
        line = f"{time.strftime('%H:%M:%S', time.localtime(record.created))} {record.levelname} {record.getMessage()}"
        trace = "\n" + self.formatException(record.exc_info) if record.exc_info else ""
        return f"{line} {told}".rstrip() + trace


def _about(record: logging.LogRecord) -> dict[str, object]:
    asker = ASKER.get()
    who: dict[str, object] = {} if asker is None else {"request": asker.request, "client": asker.client}
    return who | {name: getattr(record, name) for name in FIELDS if hasattr(record, name)}


def _without_queries(record: logging.LogRecord) -> bool:
    return not (record.name == "uvicorn.error" and str(record.msg).startswith(UVICORN_WEBSOCKET))


def set_up(form: Literal["json", "text"]) -> None:
    """Sends all lines of this process to standard error in this form."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    handler.addFilter(_without_queries)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def request_id(headers: Headers) -> str:
    """The id that the client sent, if it is at most 64 letters, digits, dots, dashes and underscores, or a new one."""
    sent = headers.get(HEADER, "")
    return sent if _ID.fullmatch(sent) else uuid.uuid4().hex


class RequestLog:
    """The outermost middleware. A client that goes away leaves a line and no traceback; a fault of ours leaves one."""

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
            with self._tracing.request(method, headers, asker.request) as answered:
                begun_s, status = time.perf_counter(), LEFT
                try:
                    status = await self._answered(scope, receive, send, asker)
                finally:
                    answered.told(method, logged_path(scope), status)
                    self._tell(scope, method, status, time.perf_counter() - begun_s)
        finally:
            ASKER.reset(token)

    async def _answered(self, scope: Scope, receive: Receive, send: Send, asker: Asker) -> int:
        """The status that the request was answered with; ``LEFT`` where it was not."""
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
        except asyncio.CancelledError:  # the end of the service, which waits no longer
            if scope["type"] == "http" and not status:
                await problem_response(Draining())(scope, receive, send_named)
        except Exception:
            log.exception("a request failed")
            if scope["type"] == "http" and not status:
                await problem_response(InternalError())(scope, receive, send_named)
        return status or LEFT

    def _tell(self, scope: Scope, method: str, status: int, took_s: float) -> None:
        path = logged_path(scope)
        self._metrics.requests.labels(method, path, str(status)).inc()
        if scope["type"] == "http":
            self._metrics.request_seconds.labels(path).observe(took_s)
        said = {"method": method, "path": legible(scope["path"][:200]), "status": status, "ms": round(1e3 * took_s, 1)}
        level = logging.DEBUG if scope["path"] in PATHS else logging.INFO
        log.log(level, "answered" if status != LEFT else "the client left", extra=said)


def logged_path(scope: Scope) -> str:
    """The path with its parameters' names in place of their values; "page" for files of the page and unknown paths."""
    route: Any = scope.get("route")
    return getattr(route, "path", "") or "page"
