"""A card's memory: records that point to their arrays there, a pool that loses nothing, and refusals in words."""

from __future__ import annotations

import numpy as np
import pytest

from drape.engine.card import Card, build_kernels
from drape.engine.card_frames import CardRecord, Flat, Pool, piece_bytes
from drape.engine.packer import Record
from drape.errors import Unavailable
from drape.live.fold_step import empty_arrays
from tests.fixtures.laws import each
from tests.fixtures.paper_card import SOURCE, driver, fails, paper_card


def memory(rng: np.random.Generator, places: int = 160, fine: int = 800) -> Record:
    _, record = empty_arrays(places, fine, np.dtype(np.float32))
    for block in record.arrays:
        block.reshape(-1).view(np.uint8)[:] = rng.integers(0, 256, block.nbytes, dtype=np.uint8)
    return record


def test_the_words_of_a_record_on_a_card_point_to_the_bits_of_its_arrays(rng: np.random.Generator):
    pool, blocks = Pool(paper_card(), 1 << 20), [rng.standard_normal((4, 160, 3)), rng.integers(0, 9, (2, 160))]
    record = Record.of_rows(blocks, 3, 0.5)
    there = CardRecord(pool, record)
    piece = np.empty(there.flat.size, np.uint8)
    pool.card.read(there.address, piece)
    words, rows = piece[: record.words.nbytes].view(np.uint64), [row for block in blocks for row in block]
    for (address, size), row in zip(words[: 2 * len(rows)].reshape(-1, 2).tolist(), rows, strict=True):
        begin = address - there.address
        assert size == row.size and piece[begin : begin + row.nbytes].tobytes() == row.tobytes()
    assert words[2 * len(rows) :].tobytes() == record.words[2 * len(rows) :].tobytes()


def test_idle_streams_cost_what_the_pool_gives_them(rng: np.random.Generator):
    pool, record = Pool(paper_card(), 8 << 20), memory(rng)
    held = [CardRecord(pool, record) for _ in range(10)]
    assert pool.size - pool.free_bytes == 10 * piece_bytes(Flat(record).size)
    for one in held[::2] + held[1::2]:
        one.give()
    assert pool.free_bytes == pool.size
    pool.give(pool.take(pool.size))  # in one piece again
    with pytest.raises(MemoryError, match=r"expected \d+ bytes in one piece, got 8388608 in all"):
        pool.take(pool.size + 1)


@each(
    case=(
        ({"version": 12080}, "expected a driver for CUDA 13.0 or later, got one for 12.8"),
        ({"cards": 0}, "expected more than 0 cards, got 0"),
        ({"major": 7}, "expected a card of compute capability 8.0 or later, got Card of paper, 7.0"),
        ({"free_bytes": 100 << 20}, "expected 1024 MB free on Card of paper, got 100 MB"),
        ({"layout": 1}, "expected kernels of this engine, [0-9a-f]{16}, got .* of 0000000000000001"),
    )
)
def test_a_card_that_cannot_be_used_is_refused_in_a_sentence(case: tuple[dict[str, int], str]):
    given, sentence = case
    with pytest.raises(Unavailable, match=sentence):
        paper_card(**given)  # pyright: ignore[reportArgumentType]


def test_without_a_driver_or_with_one_that_fails_the_sentence_says_so():
    with pytest.raises(Unavailable, match="expected NVIDIA's driver"):
        Card(SOURCE, driver="libno_such_driver.so")
    paper_card()
    for name, sentence in (("cuInit", "a card that NVIDIA's driver finds"), ("cuModuleLoadData", "to have kernels")):
        fails(name)
        with pytest.raises(Unavailable, match=f"{sentence}.*unspecified launch failure"):
            Card(SOURCE, driver=driver()[0])
    paper_card()
    fails("cuMemAlloc_v2", 2)
    with pytest.raises(OSError, match="cuMemAlloc_v2: out of memory"):
        Card(SOURCE, driver=driver()[0]).take(16)


def test_without_a_compiler_the_sentence_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FileNotFoundError, match="expected CUDA's compiler on PATH"):
        build_kernels()
