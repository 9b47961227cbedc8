"""JSON in pieces is the JSON of the whole, and other work comes between the pieces."""

from __future__ import annotations

import asyncio
import json
import time

import numpy as np
import pytest

from service.answers import PIECE_NUMBERS, json_pieces, number_pieces
from service.piecework import Piecework

SHAPES = [
    (0,),
    (0, 3),
    (5,),
    (PIECE_NUMBERS + 1,),
    (3, 0),
    (7, 3),
    (PIECE_NUMBERS, 3),
    (2, 9, 3),
    (3, PIECE_NUMBERS, 3),
]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_the_pieces_of_an_array_are_its_lists(shape: tuple[int, ...], dtype: type, rng: np.random.Generator):
    array = (1000.0 * rng.normal(size=shape)).astype(dtype)
    pieces = list(number_pieces(array))
    found = json.loads(b"".join(pieces))
    assert found == array.tolist()
    assert max(piece.count(b",") for piece in pieces) <= PIECE_NUMBERS


def test_a_document_keeps_its_fields_and_every_bit_of_its_numbers(rng: np.random.Generator):
    array = np.concatenate([rng.normal(size=50_000), [0.0, -0.0, 1e-45, 3.4e38, 1e-7]]).astype(np.float32)
    document = {"fps": 29.97, "garments": [{"id": "ä", "vertices": 3}], "positions": array, "uv": [], "n": None}
    found = json.loads(b"".join(json_pieces(document)))
    assert list(found) == list(document)
    assert np.float32(found["positions"]).tobytes() == array.tobytes()
    assert {key: found[key] for key in ("fps", "garments", "uv", "n")} == {
        key: document[key] for key in ("fps", "garments", "uv", "n")
    }


def test_other_work_comes_between_pieces_and_two_are_never_done_at_once():
    piecework, at_work, most = Piecework(), 0, 0

    def work() -> None:
        nonlocal at_work, most
        at_work += 1
        most = max(most, at_work)
        time.sleep(0.001)
        at_work -= 1

    async def long(name: str, done: list[str]) -> None:
        async for _ in piecework.each(work() for _ in range(50)):
            done.append(name)

    async def both() -> list[str]:
        done: list[str] = []
        await asyncio.gather(long("a", done), long("b", done))
        return done

    done = asyncio.run(both())
    piecework.close()
    assert most == 1
    assert done.count("a") == done.count("b") == 50
    assert {"a", "b"} == set(done[:10]) == set(done[45:55])


def test_no_piece_begins_while_a_frame_is_computed():
    piecework, done = Piecework(), []

    async def held() -> None:
        async def pieces() -> None:
            async for piece in piecework.each(iter(range(9))):
                done.append(piece)

        with piecework.held():
            task = asyncio.create_task(pieces())
            await asyncio.sleep(0.05)
            assert done == []
        await task

    asyncio.run(held())
    piecework.close()
    assert done == list(range(9))
