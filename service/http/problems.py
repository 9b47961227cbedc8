"""Answers refusals with problem documents (RFC 9457), and makes refusals of pydantic's errors about requests."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from drape.errors import DrapeError, InputError, MotionError, NotFound, did_you_mean
from service.errors import PROBLEM, problem_of, problem_response

SHOWN = 60  # the most characters of a value that a refusal repeats

# What is expected in a field, by the depth inside it: of the list, its items, their items.
_LEVELS: dict[str, tuple[str, ...]] = {
    "poses": ("a list of frames", "24 joints", "3 numbers [rad]", "a finite number [rad]"),
    "trans": ("one translation per frame", "3 numbers [m]", "a finite number [m]"),
    "betas": ("at most 10 numbers", "a finite number"),
}
_CURES: dict[str, str] = {
    "poses": "Send poses as frames x 24 joints x 3 rotation-vector components, all finite.",
    "trans": "Send trans as frames x 3 finite numbers, or leave it out.",
    "betas": "Send at most 10 finite shape coefficients, or leave betas out.",
}


_HTTP_REFUSALS: dict[int, tuple[type[DrapeError], str, str]] = {
    404: (NotFound, "a path of this service", "See /docs for the paths."),
    405: (InputError, "a method that this path has", "See /docs for the methods."),
}


def install_handlers(app: FastAPI) -> None:
    """Makes ``app`` answer every refusal with a problem document. ``service.watch.logs`` answers faults of ours."""

    @app.exception_handler(DrapeError)
    async def on_refusal(request: Request, error: DrapeError) -> JSONResponse:
        return problem_response(error)

    @app.exception_handler(RequestValidationError)
    async def on_validation(request: Request, error: RequestValidationError) -> JSONResponse:
        return problem_response(validation_refusal(error.errors()))

    @app.exception_handler(HTTPException)
    async def on_http(request: Request, error: HTTPException) -> JSONResponse:
        kind, expected, cure = _HTTP_REFUSALS.get(
            error.status_code, (InputError, "a request of this service", "See /docs.")
        )
        refusal = kind("request", expected=expected, got=f"{request.method} {request.url.path}", cure=cure)
        document = {**problem_of(refusal), "status": error.status_code, "title": str(error.detail)}
        return JSONResponse(document, status_code=error.status_code, media_type=PROBLEM, headers=error.headers)


class JsonSource(NamedTuple):
    """Where JSON came from, for refusals: its ``name``, the ``cure`` where it holds no JSON object, and the words for
    text that is not JSON (``otherwise``)."""

    name: str
    cure: str
    otherwise: str = "text that is not JSON"


BODY = JsonSource("request body", "Send JSON with Content-Type: application/json.")


def validation_refusal(errors: Sequence[Any], known: Iterable[str] = (), source: JsonSource = BODY) -> InputError:
    """Returns the refusal for the first of pydantic's ``errors`` in ``source``: a ``MotionError`` for poses,
    translations and shapes, else an ``InputError``. ``known`` are the allowed field names, of which a misspelt field's
    cure names the nearest.

    A field that may have several types has an error for each. The one for the deepest part of the field is used.
    """
    same_field = (error for error in errors if error["loc"][:1] == errors[0]["loc"][:1])
    first = max(same_field, key=lambda error: len(error["loc"]))
    location = _without_kinds([part for part in first["loc"] if part not in ("query", "path", "header")], first["type"])
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    if not location:
        return not_json(_shown(first), source)
    field = _shortened(str(location[0]))
    name = field + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location[1:])
    levels = _LEVELS.get(field)
    if levels is None or first["type"] in ("missing", "extra_forbidden"):
        expected = {"missing": "a value", "extra_forbidden": "no such field"}.get(first["type"]) or _wanted(first)
        got = {"missing": "nothing", "extra_forbidden": "one"}.get(first["type"], _shown(first))
        cure = "See /docs for the request's fields."
        cure = did_you_mean(field, known, cure) if first["type"] == "extra_forbidden" and len(location) == 1 else cure
        return InputError(name, expected=expected, got=got + more, cure=cure)
    depth = sum(isinstance(part, int) for part in location[1:])
    expected = levels[min(depth, len(levels) - 1)]
    if first["type"] in ("too_long", "too_short"):
        context = first.get("ctx", {})
        got = str(context.get("actual_length", len(first.get("input") or ())))
        if depth == 0 and first["type"] == "too_short":
            expected = "at least 1 frame"
    else:
        got = _shown(first)
    return MotionError(name, expected=expected, got=got + more, cure=_CURES[field])


def not_json(got: str, source: JsonSource = BODY) -> InputError:
    """Returns the refusal of a ``source`` that holds no JSON object but ``got``."""
    return InputError(source.name, expected="a JSON object", got=got, cure=source.cure)


def check_query(names: Iterable[str], known: tuple[str, ...]) -> None:
    """Refuses (``InputError``) query parameters whose names are not ``known``, so that a typing mistake is not
    ignored."""
    for name in names:
        if name not in known:
            cure = did_you_mean(name, known, f"Known are {', '.join(known)}.")
            raise InputError(name, expected="no such parameter", got="one", cure=cure)


def _without_kinds(location: list[int | str], complaint: str) -> list[int | str]:
    """Returns pydantic's ``location`` of an error without the parts that name a type and not a field."""
    fields = {0, len(location) - 1} if complaint in ("missing", "extra_forbidden") else {0}

    def is_kind(part: int | str) -> bool:
        return isinstance(part, str) and (not part.isidentifier() or part != part.lower())

    return [part for i, part in enumerate(location) if i in fields or not is_kind(part)]


def _wanted(error: Any) -> str:
    """Returns what is expected, from pydantic's sentence: that of "String should have at least 1 character" is "at
    least 1 character"."""
    if str(error["type"]).startswith("union_tag"):  # the object has a field that names its kind
        context = error["ctx"]
        tags = f": one of {context['expected_tags']}" if "expected_tags" in context else ""
        return f"{context['discriminator']}{tags}"
    return re.sub(r"^[A-Z][a-z]+ should (be |have )?", "", str(error["msg"]))


def _shown(error: Any) -> str:
    """Returns the value that came as short text for a refusal."""
    value = error.get("ctx", {}).get("tag", error.get("input"))
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    return _shortened(repr(value[:SHOWN] if isinstance(value, str) else value))


def _shortened(text: str) -> str:
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."
