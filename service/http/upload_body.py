"""A garment file inside JSON: cut out of the text before the rest is parsed, and decoded piece by piece.

Tens of megabytes in one string are what a parser and a decoder hold the interpreter lock for longest. In a long body
all but the edges must lie inside that one string, so the middle is cut out and a mark left in its place; where the
mark is not found in ``data_base64`` after parsing, something else was long, and is refused.
"""

from __future__ import annotations

import binascii
from collections.abc import Iterable, Iterator

from pydantic_core import from_json

from drape.errors import InputError
from service.errors import TooLarge
from service.http.json_body import document_of, validated
from service.http.schemas import UploadRequest

EDGE_BYTES = 128 * 1024
PIECE_BYTES = 128 * 1024
CUT = "|"  # no digit of base64, so no file holds it
ESCAPE_BYTES = 6  # of the longest, \u002b


def read_upload(text: bytes) -> tuple[UploadRequest, Iterator[bytes]]:
    """The request and the bytes of its file; taking those refuses (``InputError``) what is no base64."""
    beside = f"{2 * EDGE_BYTES} bytes besides data_base64"
    if len(text) <= 2 * EDGE_BYTES:
        sent = validated(UploadRequest, document_of(text))
        return sent, _file_bytes([sent.data_base64])
    first, last = _before_escape(text, EDGE_BYTES), _before_escape(text, len(text) - EDGE_BYTES)
    rest = text[:first] + CUT.encode() + text[last:]
    sent = validated(UploadRequest, document_of(rest, otherwise=f"text that is not JSON, or more than {beside}"))
    before, cut, after = sent.data_base64.partition(CUT)
    if not cut:
        raise TooLarge("request body", expected=f"at most {beside}", got="more", cure="Shorten name and avatar.")
    return sent, _file_bytes(_joined(before, _unescaped(text, first, last), after))


def _before_escape(text: bytes, place: int) -> int:
    """``place``, or the beginning of the escape around it."""
    start = text.rfind(b"\\", place - ESCAPE_BYTES + 1, place)
    return place if start < 0 else start


def _unescaped(text: bytes, start: int, last: int) -> Iterator[str]:
    """The inside of a JSON string from ``start`` to ``last``, in pieces."""
    while start < last:
        end = last if last - start <= PIECE_BYTES else _before_escape(text, start + PIECE_BYTES)
        yield from_json(b'"' + text[start:end] + b'"')
        start = end


def _joined(before: str, middle: Iterator[str], after: str) -> Iterator[str]:
    yield before
    yield from middle
    yield after


def _file_bytes(parts: Iterable[str]) -> Iterator[bytes]:
    """The ``parts`` of one base64 text, decoded."""
    rest, padded = b"", False
    try:
        for part in parts:
            text = rest + part.encode("ascii")
            if padded and text:
                raise ValueError("Excess data after padding")
            whole = len(text) - len(text) % 4
            yield binascii.a2b_base64(text[:whole], strict_mode=True)
            rest, padded = text[whole:], text[:whole].endswith(b"=")
        yield binascii.a2b_base64(rest, strict_mode=True)
    except ValueError as error:
        raise InputError(
            "data_base64", expected="base64", got=str(error), cure="Encode the file's bytes as standard base64."
        ) from error
