"""JSON that clients send, counted before it is parsed, and garment files inside JSON."""

from __future__ import annotations

import asyncio
import base64
import json

import numpy as np
import pytest

from drape.errors import InputError
from service.compute.threads import SlicedThread
from service.errors import TooLarge
from service.http import json_body
from service.http.json_body import check_marks
from service.http.upload_body import EDGE_BYTES, PIECE_BYTES, read_upload


@pytest.mark.parametrize("size", [1, PIECE_BYTES, PIECE_BYTES + 1, 3 * PIECE_BYTES - 1])
def test_as_many_marks_as_there_are(size: int):
    text, sliced_thread = b"," * size + b"0" * 17, SlicedThread()
    asyncio.run(check_marks(text, sliced_thread, most_marks=size))
    with pytest.raises(TooLarge, match=f"at most {size - 1} .* got more"):
        asyncio.run(check_marks(text, sliced_thread, most_marks=size - 1))
    sliced_thread.close()


def test_a_body_with_too_many_marks_is_not_counted_to_its_end(monkeypatch: pytest.MonkeyPatch):
    counted, marks = [], json_body._marks

    def noted(text: bytes):
        for piece in marks(text):
            counted.append(piece)
            yield piece

    monkeypatch.setattr(json_body, "_marks", noted)
    sliced_thread = SlicedThread()
    with pytest.raises(TooLarge):
        asyncio.run(check_marks(b"," * 8 * json_body.PIECE_BYTES, sliced_thread, most_marks=json_body.PIECE_BYTES))
    assert len(counted) == 2
    sliced_thread.close()


SIZES = [0, 1, 2, 3, 4, 5000, 3 * EDGE_BYTES // 2 - 50, 3 * EDGE_BYTES // 2 + 1, 3 * EDGE_BYTES + 1, 1_000_003]
FIELDS = {"name": "a", "format": "obj", "avatar": {"gender": 1.0}}


def file_of(size: int) -> bytes:
    return np.random.default_rng(size).integers(0, 256, size, np.uint8).tobytes()


def escaped_not_at_all(data: str) -> str:
    return data


def escaped_like_php(data: str) -> str:
    return data.replace("/", "\\/")


def escaped_like_dotnet(data: str) -> str:
    return data.replace("+", "\\u002B")


def escaped_throughout(data: str) -> str:
    return "".join(f"\\u{ord(letter):04x}" for letter in data)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("escaped", [escaped_not_at_all, escaped_like_php, escaped_like_dotnet, escaped_throughout])
def test_the_file_comes_out_as_it_went_in(size: int, first: bool, escaped):
    payload = file_of(size)
    data = f'"data_base64": "{escaped(base64.b64encode(payload).decode())}"'
    rest = json.dumps(FIELDS)[1:-1]
    text = "{" + (f"{data}, {rest}" if first else f"{rest}, {data}") + "}"
    sent, pieces = read_upload(text.encode())
    assert (sent.name, sent.format, sent.avatar) == ("a", "obj", {"gender": 1.0})
    parts = list(pieces)
    assert b"".join(parts) == payload
    assert max(map(len, parts)) <= max(2 * EDGE_BYTES, PIECE_BYTES)


@pytest.mark.parametrize(
    ("place", "spoil"),
    [(0, "!"), (-1, "!"), (400_001, "!"), (400_001, '"'), (400_001, "="), (400_001, "|"), (EDGE_BYTES, "|"), (7, "€")],
)
def test_what_is_no_base64_is_refused(place: int, spoil: str):
    letters = list(base64.b64encode(file_of(600_000)).decode())
    letters[place] = spoil
    text = json.dumps(FIELDS)[:-1] + ', "data_base64": "' + "".join(letters) + '"}'
    with pytest.raises(InputError, match="data_base64: expected base64, got"):
        list(read_upload(text.encode())[1])


@pytest.mark.parametrize("data", ["QQ", "QQ==QQ==", "QUJD=", "QQ=", "A", "QUJ\nD"])
@pytest.mark.parametrize("before", [0, 2 * EDGE_BYTES, 2 * EDGE_BYTES + 3])
def test_what_ends_wrong_is_refused_in_a_long_file_too(data: str, before: int):
    text = json.dumps(FIELDS | {"data_base64": "A" * (before - before % 4) + data})
    with pytest.raises(InputError, match="data_base64: expected base64, got"):
        list(read_upload(text.encode())[1])


def test_what_is_long_beside_the_file_is_refused():
    limit = f"at most {2 * EDGE_BYTES} bytes besides data_base64, got more"
    for avatar in ("x" * 1_000_000, {"note": "x" * 1_000_000}):
        with pytest.raises(TooLarge, match=limit):
            read_upload(json.dumps(FIELDS | {"data_base64": "QUJD", "avatar": avatar}).encode())
    numbers = json.dumps(FIELDS | {"data_base64": "QUJD", "avatar": {"betas": [0.123456789012345] * 100_000}})
    with pytest.raises(TooLarge, match="at most 10000 commas, colons and opening brackets"):
        read_upload(numbers.encode())
    spaces = json.dumps(FIELDS | {"data_base64": "QUJD"}) + " " * 1_000_000
    with pytest.raises(InputError, match=f"not JSON, or more than {2 * EDGE_BYTES} bytes besides data_base64"):
        read_upload(spaces.encode())
