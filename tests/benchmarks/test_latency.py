"""The latency benchmark: real sessions of a small network, rows that hold together, garments of any size."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks import latency
from benchmarks.speed import rivals as latency_rivals
from benchmarks.speed import tables as latency_report
from benchmarks.speed.setup import network_of, poses, shipped, timed, with_patches, with_vertices
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.graph.packing import pack_body
from service.graphs.engine import Engine
from service.graphs.packing import Packer, ScenePlan
from tests.fixtures.garments import reconstructed
from tests.fixtures.packed import exported, lively


@pytest.fixture(scope="module")
def record() -> dict:
    """The quick form with the small network in place of the full-size one."""
    patch = pytest.MonkeyPatch()
    patch.setattr(latency, "SINGLE", ("shorts",))
    threads = torch.get_num_threads()
    try:
        return latency.main(["--quick", "--threads", "1", "--model", str(exported()[1])])
    finally:
        torch.set_num_threads(threads)
        patch.undo()


@pytest.mark.slow
def test_rows_hold_together(record: dict):
    assert record["bench"] == "latency" and record["device"] == "cpu"
    assert record["provider"] == "CPUExecutionProvider"
    rows = {row["name"]: row for row in record["rows"] if row["garment"] == "shorts"}
    # This model has no graph in float16; those that are not packed, or give normals or steps, are of earlier records.
    earlier = {"onnx_readable", "onnx_normals", "onnx_steps"}
    assert rows.keys() == set(latency_report.NAMES) - {"onnx_fp16"} - earlier
    for row in record["rows"]:
        if "skipped" not in row and row["name"] != "floor":
            assert 0.0 < row["min_ms"] <= row["p50_ms"] <= row["p95_ms"] <= row["p99_ms"]
        assert row["vertices"] > 0 and row["patches"] > 0
    pushed = [row for row in record["rows"] if row["name"] == "onnx_pushed"]
    assert [row["passes"] for row in pushed] == [1, 0]
    assert all(row["min_ms"] > row["push_out_ms"] / 10 > 0.0 for row in pushed)
    kept = rows["onnx_subnormals"]
    assert kept["ratio"].keys() == {"packed", "push_out", "both"} and min(kept["ratio"].values()) > 0.0
    assert kept["push_out_ms"] < kept["p99_ms"]
    ours = rows["onnx"]
    assert_allclose(sum(ours["stage_ms"].values()), ours["p50_ms"], rtol=1e-4)
    assert ours["push_out_ms"] > 0.0
    assert rows["floor"]["p50_ms"] < ours["p50_ms"]
    assert rows["newton_vbd"]["skipped"] == "quick form"
    batches = [row for row in record["rows"] if row["garment"] == "mixed"]
    assert [row["batch"] for row in batches] == [1, 8]
    stores = [row["store_bytes"] for row in record["rows"] if "in store" in row["garment"]]
    assert stores[-1] == 4 * stores[0]


@pytest.mark.slow
def test_tables_and_plot_come_from_the_record(record: dict, tmp_path: Path):
    single = latency_report.single_table(record)
    assert "| shorts | packed graph: vertices | " in single and "| shorts | floor | " in single
    assert "| shorts | packed graph and push-out, subnormal numbers kept (" in single
    assert "| shorts | Newton VBD | quick form |  |  |  |" in single
    assert latency_report.stage_table(record).count("\n") == 2
    assert latency_report.batch_table(record).count("| 8 | ") == 1
    assert "all 4 in store" in latency_report.growth_table(record)
    latency_report.plot(record, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


def test_another_garment_of_the_shipped_model_takes_less_than_three_megabytes():
    packer = Packer(Engine(MODELS_DIR / "onefit"), load_body())
    packer.add("it", with_vertices(shipped("tshirt"), 5000))
    assert packer.store.packed("it").vertex_count == 5000
    assert packer.store.bytes < 3e6


def drape(garment, pose: np.ndarray) -> np.ndarray:
    packer = Packer(Engine(exported()[1]), load_body())
    packer.add("it", garment)
    return packer.run(ScenePlan(), pack_body(load_body()).rows(pose), [("it", 0)])[0].arrays["vertices"]


@pytest.mark.slow
def test_eager_torch_computes_the_same_drape():
    model, garment, pose = network_of(exported()[1]), shipped("shorts"), poses(3)[1:2]
    eager = latency_rivals.EagerDrape(model, garment, load_body())
    rows = pack_body(load_body()).rows(pose)
    with torch.no_grad():
        got = eager(**{name: torch.from_numpy(np.array(value)) for name, value in rows.items()})
    assert_allclose(got.numpy().reshape(-1, 3)[: garment.vertex_count], drape(garment, pose), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_more_vertices_lie_on_the_same_surface():
    """New vertices have a place of their own in their parents' patches: at rest, the middle of the edge."""
    garment, pose = shipped("shorts"), np.zeros((1, 24, 3))
    more = with_vertices(garment, 3 * garment.vertex_count)
    assert more.vertex_count == 3 * garment.vertex_count and more.patch_count == garment.patch_count
    assert_allclose(reconstructed(more)[: more.vertex_count], more.vertices[: more.vertex_count], rtol=0, atol=1e-6)
    assert with_vertices(garment, 500).vertex_count == 500
    assert drape(more, pose).shape == (more.vertex_count, 3)


def test_patches_are_as_many_as_asked():
    assert with_patches(shipped("shorts"), 40).patch_count == 40


def test_skinning_at_rest_is_the_garment():
    garment, body = shipped("shorts"), load_body()
    skinned = latency_rivals.SkinningPush(garment, body).skin(np.zeros((1, 24, 3)))[0]
    rest = garment.vertices[: garment.vertex_count] - body.joints_template[0]
    assert_allclose(skinned, rest, rtol=0, atol=1e-6)


def test_multiply_adds_are_those_of_the_layers():
    packer = Packer(Engine(exported()[1]), load_body())
    packer.add("it", shipped("shorts"))
    packed = packer.store.packed("it")
    model = lively()
    less = latency_rivals.multiply_adds(model, packed)
    config = model.config
    wide = config.decoder_sizes[0] * config.decoder_sizes[1]
    assert less > packed.patch_count * wide  # its largest layer alone


def test_a_clock_counts_every_call():
    calls = []
    timing = timed(lambda: calls.append(1), seconds=0.0)
    assert timing.calls == 10 and len(calls) == 15
    assert timing.min_ms <= timing.p50_ms


@pytest.mark.parametrize(
    ("python", "reason"),
    [(None, "give --newton PYTHON"), ("/nowhere/python", "FileNotFoundError"), (sys.executable, "newton|warp")],
)
def test_newton_says_why_it_did_not_run(python: str | None, reason: str):
    garment, body = shipped("shorts"), load_body()
    row = latency_rivals.newton_row(
        python, garment, body, np.zeros((1, 24, 3)), garment.vertices[: garment.vertex_count]
    )
    assert row["name"] == "newton_vbd"
    assert any(part in row["skipped"] for part in reason.split("|"))


def test_a_compilation_that_takes_too_long_is_given_up():
    with pytest.raises(TimeoutError, match="not done after 1 s"), latency_rivals._limit(1):
        time.sleep(30.0)
