"""Marks of a body are counted piece by piece, and no piece is lost."""

from __future__ import annotations

import asyncio

import pytest

from service.errors import TooLarge
from service.json_body import PIECE_BYTES, check_marks
from service.piecework import Piecework


@pytest.mark.parametrize("size", [1, PIECE_BYTES, PIECE_BYTES + 1, 3 * PIECE_BYTES - 1])
def test_as_many_marks_as_there_are(size: int):
    text, piecework = b"," * size + b"0" * 17, Piecework()
    asyncio.run(check_marks(text, piecework, most_marks=size))
    with pytest.raises(TooLarge, match=f"got {size}\\."):
        asyncio.run(check_marks(text, piecework, most_marks=size - 1))
    piecework.close()
