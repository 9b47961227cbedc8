"""JSON that clients send, counted before it is parsed."""

from __future__ import annotations

import asyncio

import pytest

from drape.errors import TooLarge
from service.compute.threads import SlicedThread
from service.http import json_body
from service.http.json_body import PIECE_BYTES, SMALL_MARKS, check_marks, read_document


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


def test_a_request_without_poses_has_fewer_marks():
    assert read_document(b"[" + b"0," * (SMALL_MARKS - 2) + b"0]")[-1] == 0
    with pytest.raises(TooLarge, match=f"at most {SMALL_MARKS} commas, colons and opening brackets, got more"):
        read_document(b"[" + b"0," * SMALL_MARKS + b"0]")
