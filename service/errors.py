"""Refusals as clients see them: a table gives each class of error its HTTP status and WebSocket close code."""

from __future__ import annotations

import json
from collections.abc import Mapping
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
    """A refusal of a request whose host or origin is not allowed, or that would change what another key owns."""


class NotAcceptable(InputError):
    """A refusal of a request whose header Accept takes none of the formats that the route offers."""


class Unauthorized(InputError):
    """A refusal of a request without a valid key or ticket."""


class TooSlow(InputError):
    """A refusal of a client that has not sent or read within the time it has."""


class Busy(Unavailable):
    """A refusal because a limit of what runs at a time or per second is reached; a later try may succeed."""


class Draining(Unavailable):
    """A refusal because this process ends. Another one takes its place, so the client should connect again."""

    def __init__(self) -> None:
        cure = "Connect again: another process takes over."
        super().__init__("service", expected="one that takes work", got="one that is being restarted", cure=cure)

    def __reduce__(self):
        return Draining, ()


class Full(Unavailable):
    """A refusal because the storage for uploads and clips is full."""


@dataclass(frozen=True)
class Rule:
    """The HTTP status, the WebSocket close code and the title of one kind of refusal."""

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
    """Returns the rule of the class of ``error``, an instance or a class; of its nearest base if it has none."""
    kind = error if isinstance(error, type) else type(error)
    return next(TABLE[base] for base in kind.__mro__ if base in TABLE)


def problem_of(error: DrapeError) -> dict[str, Any]:
    """Returns the problem document (RFC 9457) of ``error`` as a dictionary, with the fields of ``schemas.Problem``."""
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
    """Returns the HTTP response with the problem document and the status of ``error``."""
    document = problem_of(error)
    status = document["status"]
    headers = {401: {"WWW-Authenticate": "Bearer"}, 429: {"Retry-After": "1"}}.get(status)
    return JSONResponse(document, status_code=status, media_type=PROBLEM, headers=headers)


def close_reason(error: DrapeError) -> str:
    """Returns the sentence of ``error``, cut to the ``REASON_BYTES`` of a WebSocket close frame."""
    raw = str(error).encode()
    return raw.decode() if len(raw) <= REASON_BYTES else raw[: REASON_BYTES - 3].decode(errors="ignore") + "..."


def error_message(error: DrapeError) -> str:
    """Returns the text message that tells a stream's client of ``error`` before the close: the problem document as
    JSON, with "error" as its type and the class as its ``kind``."""
    return json.dumps({**problem_of(error), "type": "error", "kind": type(error).__name__})


def spoken_error(words: Mapping[str, str], otherwise: type[DrapeError]) -> DrapeError:
    """Returns the error that another process put in ``words``: kind, name, expected, got and cure. Its class is
    ``otherwise`` where ``TABLE`` has none of the name ``kind``."""
    kind = next((kind for kind in TABLE if kind.__name__ == words["kind"]), otherwise)
    return kind(words["name"], expected=words["expected"], got=words["got"], cure=words["cure"])


class InternalError(DrapeError):
    """The refusal that stands for a fault of the service. The log holds the cause, which clients do not see."""

    def __init__(self) -> None:
        super().__init__(
            "service", expected="an answer", got="an internal error", cure="Try again; the service's log has the cause."
        )

    def __reduce__(self):
        return InternalError, ()
