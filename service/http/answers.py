"""Chooses the format of an answer by the Accept header, and sends answers of many numbers in pieces.

A piece takes so little time that streams need not wait, and is dropped once it is sent."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from fastapi.responses import Response, StreamingResponse
from pydantic_core import to_json

from drape.export.glb_file import PIECE_BYTES, GlbFile
from service.compute.threads import BRIEF_BYTES, SlicedThread
from service.errors import NotAcceptable

BINARY = "application/octet-stream"
JSON = "application/json"
GLB = "model/gltf-binary"
PNG = "image/png"
PC2 = "application/x-pc2"
USDA = "model/vnd.usda"
USDZ = "model/vnd.usdz+zip"
VAT = "application/zip"
PIECE_NUMBERS = 4096  # the encoder holds the interpreter lock for half a millisecond for so many


def choose(accept: str | None, offered: Sequence[str]) -> str:
    """Returns the media type of ``offered`` that the header ``accept`` prefers; the first of equals, or of all without
    a header. Refuses (``NotAcceptable``) a header that takes none of them."""
    if accept is None or not accept.strip():
        return offered[0]
    ranges = [_parse(part) for part in accept.split(",") if part.strip()]
    best, best_quality = offered[0], 0.0
    for kind in offered:
        # The most specific range that covers the type counts (RFC 9110, 12.5.1).
        fitting = [(specificity, quality) for pattern, quality in ranges if (specificity := _covers(pattern, kind))]
        quality = max(fitting)[1] if fitting else 0.0
        if quality > best_quality:
            best, best_quality = kind, quality
    if best_quality <= 0.0:
        raise NotAcceptable(
            "Accept", expected=f"one of {', '.join(offered)}", got=accept[:120], cure="Ask for one of these."
        )
    return best


def _parse(part: str) -> tuple[str, float]:
    pattern, *parameters = (piece.strip() for piece in part.split(";"))
    quality = 1.0
    for parameter in parameters:
        key, _, value = parameter.partition("=")
        if key.strip().lower() == "q":
            try:
                quality = min(max(float(value), 0.0), 1.0)
            except ValueError:
                quality = 0.0
    return pattern.lower(), quality


def _covers(pattern: str, kind: str) -> int:
    """Returns how precisely ``pattern`` names ``kind``: 3 exactly, 2 as "type/*", 1 as "*/*", 0 not at all."""
    if pattern == kind:
        return 3
    if pattern == kind.partition("/")[0] + "/*":
        return 2
    return 1 if pattern == "*/*" else 0


def json_answer(
    document: Mapping[str, object], sliced_thread: SlicedThread, headers: Mapping[str, str] | None = None
) -> StreamingResponse:
    """Returns the response that sends ``document`` as JSON, with arrays as nested lists."""
    return StreamingResponse(sliced_thread.run_pieces(json_pieces(document)), media_type=JSON, headers=headers)


def binary_answer(
    array: np.ndarray, sliced_thread: SlicedThread, headers: Mapping[str, str], *, tail: bytes = b""
) -> Response:
    """Returns the response that sends ``array`` in C order as little-endian float32, and then ``tail``."""
    if array.nbytes <= BRIEF_BYTES:
        return Response(b"".join([*number_bytes(array), tail]), media_type=BINARY, headers={**headers})
    headers = {**headers, "Content-Length": str(4 * array.size + len(tail))}
    pieces = itertools.chain(number_bytes(array), (tail,))
    return StreamingResponse(sliced_thread.run_pieces(pieces), media_type=BINARY, headers=headers)


def number_bytes(array: np.ndarray) -> Iterator[bytes]:
    """Returns an iterator over the bytes of ``array`` in C order as little-endian float32, in pieces."""
    return (part.astype("<f4", copy=False).tobytes() for part in _parts(array, PIECE_BYTES // 4))


def file_answer(
    file: GlbFile, head: bytes, sliced_thread: SlicedThread, headers: Mapping[str, str]
) -> StreamingResponse:
    """Returns the response that sends the GLB ``file``; ``head`` is what ``file.head()`` returned."""
    headers = {**headers, "Content-Length": str(len(head) + file.binary_bytes)}
    pieces = itertools.chain((head,), file.pieces())
    return StreamingResponse(sliced_thread.run_pieces(pieces), media_type=GLB, headers=headers)


def messages_answer(
    messages: Sequence[bytes], sliced_thread: SlicedThread, headers: Mapping[str, str]
) -> StreamingResponse:
    """Returns the response that sends the bytes of ``messages`` one after the other, a few in each piece."""
    size = sum(len(message) for message in messages)
    count = max(1, PIECE_BYTES * len(messages) // max(size, 1))
    pieces = (b"".join(messages[start : start + count]) for start in range(0, len(messages), count))
    headers = {**headers, "Content-Length": str(size)}
    return StreamingResponse(sliced_thread.run_pieces(pieces), media_type=BINARY, headers=headers)


def json_pieces(document: Mapping[str, object]) -> Iterator[bytes]:
    """Yields the JSON text of ``document`` in pieces, with arrays as nested lists. A float32 is written as the double
    that equals it, so none is rounded."""
    before = b"{"
    for key, value in document.items():
        before += to_json(key) + b":"
        for piece in number_pieces(value) if isinstance(value, np.ndarray) else (to_json(value),):
            yield before + piece
            before = b""
        before = b","
    yield b"}"


def number_pieces(array: np.ndarray) -> Iterator[bytes]:
    """Yields the JSON text of ``array`` as nested lists, in pieces of at most ``PIECE_NUMBERS`` numbers."""
    if array.size <= PIECE_NUMBERS:
        yield to_json(array.tolist())
        return
    before = b"["
    for part in _parts(array, PIECE_NUMBERS):
        # A single row may be longer than a piece.
        for piece in number_pieces(part[0]) if len(part) == 1 else (to_json(part.tolist())[1:-1],):
            yield before + piece
            before = b""
        before = b","
    yield b"]"


def _parts(array: np.ndarray, numbers: int) -> Iterator[np.ndarray]:
    """Yields views of ``array``, cut along its first axis into parts of about ``numbers`` numbers and at least one
    row."""
    rows = max(1, numbers * len(array) // max(array.size, 1))
    for start in range(0, len(array), rows):
        yield array[start : start + rows]
