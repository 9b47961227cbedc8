"""Log lines with time, client and request: JSON, one object a line, or text.

A line never has headers, query strings or bodies: keys, tickets and people's measurements travel there.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Asker:
    """Who asked what is being answered: the request's id and the client's address."""

    request: str
    client: str


ASKER: ContextVar[Asker | None] = ContextVar("asker", default=None)
FIELDS = ("method", "path", "status", "ms")  # that a record may have besides
UVICORN_WEBSOCKET = '%s - "WebSocket %s"'  # its lines have query strings; ours say the same without


class JsonLines(logging.Formatter):
    """Each record as one line of JSON: time (UTC), level, logger, message, request, client, and ``FIELDS`` it has."""

    def format(self, record: logging.LogRecord) -> str:
        document = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **_about(record),
        }
        if record.exc_info:
            document["exception"] = self.formatException(record.exc_info)
        return json.dumps(document, ensure_ascii=False)


class TextLines(logging.Formatter):
    """The same for people at a terminal."""

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
