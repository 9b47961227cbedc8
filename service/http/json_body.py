"""Reads JSON of clients, whose marks are counted before it is parsed, so that no body holds the interpreter lock long.

A mark is a comma, a colon or an opening bracket. A parser makes an object of each and holds the lock until it ends: a
mebibyte of empty lists took seconds. The number of marks that a request can need is known, so more are refused
unparsed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json

from drape.body.skeleton import JOINT_COUNT
from drape.errors import TooLarge
from drape.wire.options import Advanced, DrapeOptions, wire_names
from service.compute.threads import BRIEF_TEXT, SlicedThread
from service.http.problems import BODY, JsonSource, not_json, validation_refusal

MARKS = b",:[{"
_OTHER_BYTES = bytes(byte for byte in range(256) if byte not in MARKS)
FRAME_MARKS = 4 * JOINT_COUNT + 5  # the marks of a frame: 24 x 3 numbers in poses and 3 in trans
SMALL_MARKS = 10_000  # the most marks of a request without poses
PIECE_BYTES = 256 * 1024  # counted in half a millisecond
JSON = "application/json"

Asked = TypeVar("Asked", bound=BaseModel)


def clip_marks(max_frames: int) -> int:
    """Returns the most marks (commas, colons, opening brackets) that a request with a clip of ``max_frames`` frames may
    have. It is a quarter more than needed, so that a clip that is a little too long is refused by its number of
    frames."""
    return 5 * max_frames * FRAME_MARKS // 4 + SMALL_MARKS


def read_document(text: bytes, *, source: JsonSource = BODY) -> Any:
    """Returns the value of the JSON ``text`` of ``source``. Refuses (``TooLarge``) text with more than ``SMALL_MARKS``
    of the characters ``MARKS``, and (``InputError``) text that is not JSON."""
    marks = 0
    for more in _marks(text):
        marks = _check_count(marks + more, SMALL_MARKS, source)
    return parse_text(text, source=source)


async def check_marks(text: bytes, sliced_thread: SlicedThread, *, most_marks: int) -> None:
    """Refuses (``TooLarge``) a JSON ``text`` with more than ``most_marks`` of the characters ``MARKS``. Those of a long
    text are counted in pieces on ``sliced_thread``."""
    if len(text) <= BRIEF_TEXT:
        _check_count(sum(_marks(text)), most_marks)
        return
    marks = 0
    async for more in sliced_thread.run_pieces(_marks(text)):
        marks = _check_count(marks + more, most_marks)


def _marks(text: bytes) -> Iterator[int]:
    """Yields the number of marks in each piece of ``text``."""
    for start in range(0, len(text), PIECE_BYTES):
        yield len(text[start : start + PIECE_BYTES].translate(None, _OTHER_BYTES))


def _check_count(marks: int, most_marks: int, source: JsonSource = BODY) -> int:
    if marks > most_marks:
        raise TooLarge(
            source.name,
            expected=f"at most {most_marks} commas, colons and opening brackets",
            got="more",
            cure="Send less in one request.",
        )
    return marks


def parse_text(text: bytes, *, source: JsonSource = BODY) -> Any:
    """Returns the value of the JSON ``text`` of ``source``, whose ``MARKS`` the caller has counted. Refuses
    (``InputError``) text that is not JSON."""
    try:
        return from_json(text, cache_strings="none")
    except ValueError as error:
        raise not_json(source.otherwise, source) from error


def validate_document(model: type[Asked], document: Any, *, source: JsonSource = BODY) -> Asked:
    """Returns ``document``, the value of the JSON of ``source``, as an instance of ``model``. Refuses (``InputError``)
    it for the first field that is wrong."""
    known = set(wire_names(model).values())
    known |= Advanced.model_fields.keys() if issubclass(model, DrapeOptions) else set()
    if isinstance(document, dict):
        for unknown in [key for key in document if key not in known][1:]:
            del document[unknown]  # pydantic would make an error of each, but a refusal names only the first
    try:
        return model.model_validate(document)
    except ValidationError as error:
        raise validation_refusal(error.errors(include_url=False), sorted(known), source) from error


async def json_text(request: Request) -> bytes:
    """Returns the bytes of the body of ``request``. Refuses (``InputError``) a body whose Content-Type is not JSON, and
    an empty one."""
    kind = content_type(request)
    body = await request.body()
    if kind != JSON and not (kind.startswith("application/") and kind.endswith("+json")):
        raise not_json("a body of another type")
    if not body:
        raise not_json("nothing")
    return body


def content_type(request: Request) -> str:
    """Returns the media type of the body of ``request`` in lower case, without parameters; "" without a
    Content-Type."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()
