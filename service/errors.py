"""The error tree on the outside: one table gives each refusal its HTTP status and WebSocket close code."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from fastapi.responses import JSONResponse

from drape.errors import (
    ArtifactError,
    BodyError,
    DrapeError,
    InputError,
    MeshError,
    MotionError,
    NotFound,
    TooLarge,
    Unavailable,
)

PROBLEM = "application/problem+json"
REASON_BYTES = 123  # what a WebSocket close frame can carry


class Forbidden(InputError):
    """A refusal of a request because of where it comes from: its host or its origin is not allowed."""


class NotAcceptable(InputError):
    """None of the formats that the client accepts is one of ours."""


class Unauthorized(InputError):
    """No key or ticket that this service knows."""


class TooSlow(InputError):
    """A stream client that has stopped reading, opening or sending."""


class Busy(Unavailable):
    """All places are taken for now."""


class Draining(Unavailable):
    """The service ends, and another takes its place."""

    def __init__(self) -> None:
        cure = "Connect again: another process takes over."
        super().__init__("service", expected="one that takes work", got="one that is being restarted", cure=cure)

    def __reduce__(self):
        return Draining, ()


class Full(Unavailable):
    """No more room for what would be stored."""


@dataclass(frozen=True)
class Rule:
    """The HTTP status, close code and title of one kind of refusal."""

    status: int
    close_code: int
    title: str


# A class without a row takes the row of its nearest base; DrapeError is last resort.
TABLE: dict[type[DrapeError], Rule] = {
    NotFound: Rule(404, 4404, "Not found"),
    MeshError: Rule(422, 4422, "Mesh cannot be draped"),
    BodyError: Rule(422, 4422, "Body cannot be used"),
    MotionError: Rule(422, 4422, "Pose or clip cannot be used"),
    TooLarge: Rule(413, 1009, "Too large"),
    Unauthorized: Rule(401, 4401, "Unauthorized"),
    Forbidden: Rule(403, 4403, "Forbidden"),
    NotAcceptable: Rule(406, 4406, "Not acceptable"),
    TooSlow: Rule(408, 4408, "Too slow"),
    InputError: Rule(400, 4400, "Bad request"),
    ArtifactError: Rule(500, 1011, "Stored data does not hold together"),
    Draining: Rule(503, 1012, "Restarting"),
    Full: Rule(507, 1013, "Storage full"),
    Busy: Rule(429, 1013, "Busy"),
    Unavailable: Rule(503, 1013, "Unavailable"),
    DrapeError: Rule(500, 1011, "Failed"),
}


def rule_for(error: DrapeError | type[DrapeError]) -> Rule:
    """The row of ``error``'s class, or of its nearest base."""
    kind = error if isinstance(error, type) else type(error)
    return next(TABLE[base] for base in kind.__mro__ if base in TABLE)


def problem_of(error: DrapeError) -> dict[str, Any]:
    """The problem document (RFC 9457) of ``error``."""
    rule = rule_for(error)
    return {
        "type": f"urn:drape:{type(error).__name__}",
        "title": rule.title,
        "status": rule.status,
        "detail": str(error),
        "name": error.name,
        "expected": error.expected,
        "got": error.got,
        "cure": error.cure,
    }


def problem_response(error: DrapeError) -> JSONResponse:
    """The HTTP answer to ``error``."""
    document = problem_of(error)
    status = document["status"]
    headers = {401: {"WWW-Authenticate": "Bearer"}, 429: {"Retry-After": "1"}}.get(status)
    return JSONResponse(document, status_code=status, media_type=PROBLEM, headers=headers)


def close_reason(error: DrapeError) -> str:
    """The sentence of ``error``, cut to what a close frame carries; the whole one goes in a message before it."""
    raw = str(error).encode()
    return raw.decode() if len(raw) <= REASON_BYTES else raw[: REASON_BYTES - 3].decode(errors="ignore") + "..."


def error_message(error: DrapeError) -> str:
    """The JSON text message that precedes a close."""
    return json.dumps({**problem_of(error), "type": "error", "kind": type(error).__name__})


class InternalError(DrapeError):
    """A fault of ours; the log holds the cause, the client does not."""

    def __init__(self) -> None:
        super().__init__(
            "service", expected="an answer", got="an internal error", cure="Try again; the service's log has the cause."
        )

    def __reduce__(self):
        return InternalError, ()
