"""Marks of a body are counted piece by piece, and no piece is lost."""

from __future__ import annotations

import asyncio

import pytest

from service.compute.sliced_thread import SlicedThread
from service.errors import TooLarge
from service.http import json_body
from service.http.json_body import PIECE_BYTES, check_marks


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
        asyncio.run(check_marks(b"," * 8 * PIECE_BYTES, sliced_thread, most_marks=PIECE_BYTES))
    assert len(counted) == 2
    sliced_thread.close()
