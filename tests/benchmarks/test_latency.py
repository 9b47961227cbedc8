"""The latency benchmark: real sessions of a small network, rows that hold together, garments of any size."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import latency, records
from benchmarks.clock import timed
from benchmarks.latency import shipped
from benchmarks.speed import floor
from benchmarks.speed.skinning_push import SkinningPush
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.inference.engine import Engine
from drape.inference.packing import Packer
from tests.fixtures.packed import exported, lively


@pytest.fixture(scope="module")
def record() -> dict:
    """The quick form with the small network in place of the full-size one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(latency, "SINGLE", ("shorts",))
        return latency.main(["--quick", "--threads", "1", "--model", str(exported()[1])])


@pytest.mark.long
def test_rows_hold_together(record: dict):
    assert record["bench"] == "latency" and record["device"] == "cpu"
    assert record["provider"] == "CPUExecutionProvider"
    rows = {row["name"]: row for row in record["rows"] if row["garment"] == "shorts"}
    assert rows.keys() == set(records.NAMES) - {"torch_eager"}  # of an earlier record
    for row in record["rows"]:
        if row["name"] != "floor":
            assert 0.0 < row["min_ms"] <= row["p50_ms"] <= row["p95_ms"] <= row["p99_ms"]
        assert row["vertices"] > 0 and row["patches"] > 0
    pushed = [row for row in record["rows"] if row["name"] == "onnx_pushed"]
    assert [row["passes"] for row in pushed] == [1, 0]
    assert all(row["min_ms"] > row["push_out_ms"] / 10 > 0.0 for row in pushed)
    ours = rows["onnx"]
    assert ours["push_out_ms"] > 0.0
    # The floor is that of float32, which tiles go below, and a busy machine copies slowly.
    assert 0.0 < rows["floor"]["p50_ms"] < 3.0 * ours["p50_ms"]
    batches = [row for row in record["rows"] if row["garment"] == "mixed"]
    assert [row["batch"] for row in batches] == [1, 8]


def test_another_garment_of_the_shipped_model_takes_less_than_three_megabytes():
    packer = Packer(Engine(MODELS_DIR / "onefit"), load_body())
    packer.add("it", shipped("shorts"))
    assert packer.store.packed("it").vertex_count == shipped("shorts").vertex_count > 4500
    assert packer.store.bytes < 3e6


def test_skinning_at_rest_is_the_garment():
    garment, body = shipped("shorts"), load_body()
    skinned = SkinningPush(garment, body).skin(np.zeros((1, 24, 3)))[0]
    rest = garment.vertices[: garment.vertex_count] - body.joints_template[0]
    assert_allclose(skinned, rest, rtol=0, atol=1e-6)


def test_multiply_adds_are_those_of_the_layers():
    packer = Packer(Engine(exported()[1]), load_body())
    packer.add("it", shipped("shorts"))
    packed = packer.store.packed("it")
    model = lively()
    less = floor.multiply_adds(model, packed)
    config = model.config
    wide = config.decoder_sizes[0] * config.decoder_sizes[1]
    assert less > packed.patch_count * wide  # its largest layer alone


def test_a_clock_counts_every_call():
    calls = []
    timing = timed(lambda: calls.append(1), seconds=0.0)
    assert timing.calls == 10 and len(calls) == 15
    assert timing.min_ms <= timing.p50_ms
