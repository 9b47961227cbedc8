"""Garments that a packer holds: bounded memory, constants kept once, changes that no frame waits for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.body.assets import load_body
from drape.cloth.fabric_table import fabric
from drape.graph.feeds import garment_feed
from drape.inference.packing import Packer, ScenePlan
from drape.inference.store import FIRST
from tests.fixtures.garments import tube_garment
from tests.fixtures.packed import KINDS, garment
from tests.service.graphs.packers import bodies, make_packer

__all__ = ["bodies"]  # a fixture
pytestmark = pytest.mark.slow


def test_memory_of_compositions_is_bounded_and_numbers_stay(bodies):
    bounded, free = make_packer(kept_bytes=300_000), make_packer()
    for batch in range(6):
        items = [(KINDS[(batch + i) % len(KINDS)], i) for i in range(3)]
        kept, new = bounded.run(ScenePlan(), bodies, items), free.run(ScenePlan(), bodies, items)
        assert bounded.kept_bytes <= 300_000
        for a, b in zip(kept, new, strict=True):
            assert_array_equal(a.arrays["vertices"], b.arrays["vertices"])
    assert free.kept_bytes > 300_000


def test_constants_are_kept_once(bodies):
    packer = make_packer()
    before = packer.store.bytes
    packer.run(ScenePlan(), bodies, [("tank", 0), ("shorts", 1)])
    assert packer.store.bytes == before
    for kind in KINDS:
        for name, array in packer.store.packed(kind).stored.items():
            assert np.shares_memory(array, packer.store.arrays()[name])


def waits_not(packer: Packer, bodies, change: Callable[[Callable[[], None]], str]) -> None:
    """Fails where a frame waits for a ``change`` of the garments that stands still; it names one that is in store."""
    begun, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        begun.set()
        assert go_on.wait(300.0)

    with ThreadPoolExecutor(2) as threads:
        try:
            changing = threads.submit(change, hold)
            assert begun.wait(300.0)
            frame = threads.submit(packer.run, ScenePlan(), bodies, [("tank", 0)])
            assert len(frame.result(100.0)) == 1 and not changing.done()
        finally:
            go_on.set()
        assert changing.result(300.0) in packer.store


def test_no_frame_waits_while_a_garment_is_packed(bodies):
    packer, feed = make_packer(compiled=True), garment_feed(garment("shorts"), body=load_body())

    def add(hold: Callable[[], None]) -> str:
        class Held(dict):
            def __getitem__(self, name: str) -> np.ndarray:
                hold()
                return super().__getitem__(name)

        packer.add("more", garment("shorts"), Held(feed))
        return "more"

    waits_not(packer, bodies, add)


def test_no_frame_waits_while_a_fabric_is_encoded(bodies, monkeypatch: pytest.MonkeyPatch):
    packer = make_packer(compiled=True)
    encode = packer._engine.encode

    def dress(hold: Callable[[], None]) -> str:
        monkeypatch.setattr(packer._engine, "encode", lambda *asked: (hold(), encode(*asked))[1])
        return packer.dressed("tank", fabric("denim"))

    waits_not(packer, bodies, dress)


def test_constants_are_not_laid_out_before_a_graph_asks(bodies):
    packer = make_packer(compiled=True)
    packer.run(ScenePlan(), bodies, [("tank", 0), ("shorts", 1)])
    tank = packer.store.packed("tank").stored[FIRST]
    packer.add("more", garment("shorts"))
    packer.remove("shorts")
    assert packer.store.packed("tank").stored[FIRST] is tank, "a frame waits for no copy of all garments"
    kept = {*KINDS, "more"} - {"shorts"}
    assert len(packer.store.arrays()[FIRST]) == sum(packer.store.packed(key).patch_count for key in kept)


def test_garments_come_and_go(bodies):
    packer = make_packer()
    items = [("tank", 0), ("trousers", 1)]
    before = packer.run(ScenePlan(), bodies, items)
    packer.add("tube", replace(tube_garment(load_body()), patch_features=garment("tank").patch_features[:12]))
    packer.remove("shorts")
    assert "shorts" not in packer.store and "tube" in packer.store
    after = packer.run(ScenePlan(), bodies, [*items, ("tube", 2)])
    for a, b in zip(before, after[:2], strict=True):
        assert_array_equal(a.arrays["vertices"], b.arrays["vertices"])
    assert after[2].arrays["vertices"].shape == (216, 3)
