"""JSON in pieces is the JSON of the whole, and other work comes between the pieces."""

from __future__ import annotations

import asyncio
import json
import time

import numpy as np
import pytest

from drape.export.glb_file import PIECE_BYTES, GlbFile
from service.compute.sliced_thread import SlicedThread
from service.http.answers import PIECE_NUMBERS, file_answer, json_pieces, messages_answer, number_pieces

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
    sliced_thread, at_work, most = SlicedThread(), 0, 0

    def work() -> None:
        nonlocal at_work, most
        at_work += 1
        most = max(most, at_work)
        time.sleep(0.001)
        at_work -= 1

    async def long(name: str, done: list[str]) -> None:
        async for _ in sliced_thread.each(work() for _ in range(50)):
            done.append(name)

    async def both() -> list[str]:
        done: list[str] = []
        await asyncio.gather(long("a", done), long("b", done))
        return done

    done = asyncio.run(both())
    sliced_thread.close()
    assert most == 1
    assert done.count("a") == done.count("b") == 50
    assert {"a", "b"} == set(done[:10]) == set(done[45:55])


def test_no_piece_begins_while_a_frame_is_computed():
    sliced_thread, done = SlicedThread(), []

    async def held() -> None:
        async def pieces() -> None:
            async for piece in sliced_thread.each(iter(range(9))):
                done.append(piece)

        with sliced_thread.held():
            task = asyncio.create_task(pieces())
            await asyncio.sleep(0.05)
            assert done == []
        await task

    asyncio.run(held())
    sliced_thread.close()
    assert done == list(range(9))


@pytest.mark.parametrize("sizes", [(), (5,), (PIECE_BYTES, 3), (10_000,) * 100])
def test_messages_are_sent_a_few_at_a_time(sizes: tuple[int, ...]):
    messages = [bytes([i % 251]) * size for i, size in enumerate(sizes)]
    sliced_thread, pieces = SlicedThread(), []

    async def read() -> None:
        answer = messages_answer(messages, sliced_thread, {"X-Drape-Frames": "1"})
        assert answer.headers["Content-Length"] == str(sum(sizes)) and answer.headers["X-Drape-Frames"] == "1"
        pieces.extend([piece async for piece in answer.body_iterator])

    asyncio.run(read())
    sliced_thread.close()
    assert b"".join(pieces) == b"".join(messages)
    assert all(len(piece) <= PIECE_BYTES for piece in pieces)


def test_a_file_is_sent_as_it_would_be_written(rng: np.random.Generator):
    file, sliced_thread, pieces = GlbFile(), SlicedThread(), []
    arrays = [rng.normal(size=(count, 3)).astype(np.float32) for count in (50_000, 1, 7)]
    indices = [file.array(array) for array in [*arrays, np.arange(3, dtype=np.uint8), arrays[1]]]

    async def read() -> None:
        answer = file_answer(file, file.head(), sliced_thread, {})
        pieces.extend([piece async for piece in answer.body_iterator])
        assert answer.headers["Content-Length"] == str(sum(len(piece) for piece in pieces))

    asyncio.run(read())
    sliced_thread.close()
    whole = b"".join(pieces)
    assert whole == file.to_bytes() and max(len(piece) for piece in pieces[1:]) <= PIECE_BYTES
    for array, index in zip(arrays, indices, strict=False):
        view = file.json["bufferViews"][file.json["accessors"][index]["bufferView"]]
        start = len(pieces[0]) + view["byteOffset"]
        assert whole[start : start + view["byteLength"]] == array.tobytes()
