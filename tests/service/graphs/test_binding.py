"""Buckets: the same bits as without them, memory of each set of shapes once and bounded, constants that may go."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.artifacts import TensorSpec
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.inference.binding import BoundSession
from drape.inference.engine import Engine
from drape.inference.graph_names import PACKED
from drape.inference.onnx_runtime import Device, nodes_off_provider, open_session
from drape.inference.packing import Packer, ScenePlan
from drape.stages.batch import PoseInput
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.garments import ship
from tests.fixtures.packed import KINDS, exported, garment
from tests.fixtures.poses import random_motion
from tests.service.graphs.packers import BODIES, bodies, make_packer, packer_of

PLANS = [ScenePlan("both", skin=True), ScenePlan("jets"), ScenePlan(passes=1)]
__all__ = ["bodies"]  # a fixture


def mixes(count: int) -> list[list[tuple[str, int]]]:
    """Batches of 1 to ``count`` items."""
    generator = np.random.default_rng(7)
    return [
        [(KINDS[generator.integers(len(KINDS))], int(generator.integers(BODIES))) for _ in range(size + 1)]
        for size in range(count)
    ]


@pytest.mark.slow
def test_buckets_change_no_bit_of_any_plan_alone_and_in_any_mix(bodies: dict[str, np.ndarray]):
    plain, bound = make_packer(), packer_of(Engine(exported()[1], bound=True))
    for plan in PLANS:
        for items in mixes(7):
            pairs = zip(plain.run(plan, bodies, items), bound.run(plan, bodies, items), strict=True)
            for want, got in pairs:
                assert set(got.arrays) == set(want.arrays)
                for name, array in want.arrays.items():
                    assert_array_equal(got.arrays[name], array)
    assert plain._engine.buckets == plain._engine.held_bytes == 0
    assert bound._engine.buckets > 0 and bound._engine.held_bytes > 0


@pytest.mark.slow
def test_a_bucket_is_taken_again_and_answers_do_not_share_its_memory(bodies: dict[str, np.ndarray]):
    packer, plan = packer_of(Engine(exported()[1], bound=True)), ScenePlan()
    first = packer.run(plan, bodies, [("tank", 0), ("shorts", 1)])
    kept, buckets = [result.arrays["vertices"].copy() for result in first], packer._engine.buckets
    assert buckets == 1
    packer.run(plan, bodies, [("tank", 2), ("shorts", 3)])
    packer.run(plan, bodies, [("shorts", 5), ("tank", 4)])  # other constants, shapes of the same rungs
    assert packer._engine.buckets == buckets
    for result, before in zip(first, kept, strict=True):
        assert_array_equal(result.arrays["vertices"], before)
    again = packer.run(plan, bodies, [("tank", 0), ("shorts", 1)])
    for result, before in zip(again, kept, strict=True):
        assert_array_equal(result.arrays["vertices"], before)


@pytest.mark.slow
def test_garments_that_come_and_go_leave_no_stale_constants(bodies: dict[str, np.ndarray]):
    packer = Packer(Engine(exported()[1], bound=True), load_body())
    packer.add("a", garment("tank"))
    before = packer.run(ScenePlan(), bodies, [("a", 3)])[0].arrays["vertices"]
    packer.add("b", garment("shorts"))
    assert packer._engine.buckets == 0
    assert_array_equal(packer.run(ScenePlan(), bodies, [("a", 3)])[0].arrays["vertices"], before)
    packer.remove("a")
    alone = Packer(Engine(exported()[1], compiled=False), load_body())
    alone.add("b", garment("shorts"))
    want = alone.run(ScenePlan(), bodies, [("b", 2)])[0].arrays["vertices"]
    assert_array_equal(packer.run(ScenePlan(), bodies, [("b", 2)])[0].arrays["vertices"], want)


@pytest.mark.slow
def test_a_service_in_buckets_is_warm_and_answers_alike(make_settings, tmp_path: Path):
    ship(tmp_path, "tank", "shorts")
    poses, trans = random_motion(3, seed=8)
    clip, found = PoseInput(poses, trans, np.zeros(10), np.zeros(3)), []
    for buckets in (None, True):
        settings = make_settings(shipped_garments_dir=tmp_path, chunk_frames=3)
        engine = Engine(Path(settings.model), compiled=False, bound=buckets)
        runtime = DrapeRuntime(settings, engine=engine)
        ready = runtime.engine.buckets
        plans = [
            runtime.plan(runtime.garments.get(kind), DrapeOptions(advanced=Advanced(push_out=True)))
            for kind in ("tank", "shorts")
        ]
        found.append([run(plan, [clip]) for plan in plans])
        assert runtime.engine.buckets == ready  # all that a clip takes was there before the first request
        assert (ready > 0) is bool(buckets)
        assert runtime.device_bytes > 0
        runtime.close()
    for plain, bound in zip(*found, strict=True):
        assert_allclose(bound.vertices, plain.vertices, rtol=0, atol=2e-5)  # pushed out by the engine and by a graph


# --- one session ---


def doubling() -> onnxruntime.InferenceSession:
    """y = 2 x + c for x (n, 3) and c (3,)."""
    from onnx import TensorProto, helper, numpy_helper

    x, c, y = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (("x", ["n", 3]), ("c", [3]), ("y", ["n", 3]))
    )
    nodes = [helper.make_node("Mul", ["x", "two"], ["z"]), helper.make_node("Add", ["z", "c"], ["y"])]
    graph = helper.make_graph([*nodes], "g", [x, c], [y], [numpy_helper.from_array(np.array(2.0, np.float32), "two")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    return open_session("doubling", model.SerializeToString(), {}, Device())


def session(**limits: int) -> BoundSession:
    inputs = (TensorSpec("x", ("n", 3), "float32", "1"), TensorSpec("c", (3,), "float32", "1"))
    return BoundSession(doubling(), Device(), inputs, (TensorSpec("y", ("n", 3), "float32", "1"),), **limits)


def test_what_stays_is_written_once_and_what_changes_every_time():
    bound, x, c = session(), np.ones((2, 3), np.float32), np.zeros(3, np.float32)
    assert_array_equal(bound.run(["y"], {"x": x, "c": c}, unchanging=["c"])[0], np.full((2, 3), 2.0))
    x[:], c[:] = 2.0, 5.0  # the second against what "still" says
    assert_array_equal(bound.run(["y"], {"x": x, "c": c}, unchanging=["c"])[0], np.full((2, 3), 4.0))
    other = np.full(3, 7.0, np.float32)
    assert_array_equal(bound.run(["y"], {"x": x, "c": other}, unchanging=["c"])[0], np.full((2, 3), 11.0))
    assert_array_equal(bound.run(["y"], {"x": x, "c": c})[0], np.full((2, 3), 9.0))
    assert bound.buckets == 1 and bound.bytes == 4 * (6 + 3 + 6)


def test_values_of_the_device_are_read_where_they_lie():
    bound, c = session(), np.ones(3, np.float32)
    value = Device().value(c)
    assert_array_equal(bound.run(["y"], {"x": np.zeros((1, 3), np.float32), "c": value})[0], [[1.0] * 3])
    c[:] = 4.0
    assert_array_equal(bound.run(["y"], {"x": np.zeros((1, 3), np.float32), "c": value})[0], [[4.0] * 3])
    another = Device().value(np.zeros(3, np.float32))
    bound.run(["y"], {"x": np.zeros((1, 3), np.float32), "c": another})
    assert bound.buckets == 2


def test_memory_is_bounded_by_buckets_and_by_bytes():
    c = np.zeros(3, np.float32)
    few, small = session(kept_buckets=2), session(kept_bytes=4 * (30 + 3 + 30))
    for bound in (few, small):
        for count in (1, 10, 2, 10, 3, 1):
            x = np.full((count, 3), count, np.float32)
            assert_array_equal(bound.run(["y"], {"x": x, "c": c})[0], 2.0 * x)
            assert bound.buckets <= 3 and bound.buckets <= (2 if bound is few else 3)
    assert small.bytes <= 4 * (30 + 3 + 30)
    few.forget()
    assert few.buckets == few.bytes == 0


def test_inputs_that_do_not_agree_are_refused():
    inputs = (TensorSpec("x", ("n", 3), "float32", "1"), TensorSpec("c", ("n",), "float32", "1"))
    bound = BoundSession(doubling(), Device(), inputs, (TensorSpec("y", ("n", 3), "float32", "1"),))
    with pytest.raises(ArtifactError, match="input c: expected n 2"):
        bound.run(["y"], {"x": np.zeros((2, 3), np.float32), "c": np.zeros(3, np.float32)})


def test_nodes_that_run_elsewhere_are_counted():
    opened = doubling()
    assert nodes_off_provider(opened, Device()) == 0
    assert nodes_off_provider(opened, Device("cuda")) == 2


# --- on a GPU ---


@pytest.mark.slow
@pytest.mark.gpu
def test_captured_graphs_drape_as_the_cpu(bodies: dict[str, np.ndarray]):
    plain = make_packer()
    on_gpu = packer_of(Engine(exported()[1], device=Device("cuda")))
    for plan in PLANS:
        for items in mixes(5):
            want = plain.run(plan, bodies, items)
            for _ in range(3):  # the capture, and replays
                for a, b in zip(want, on_gpu.run(plan, bodies, items), strict=True):
                    if "vertices" in a.arrays:
                        assert_allclose(b.arrays["vertices"], a.arrays["vertices"], rtol=0, atol=1e-3)


def test_the_packed_graph_runs_where_it_is_asked_to():
    engine = Engine(exported()[1], compiled=False)
    engine.open_cut(PACKED, ["vertices"])
    assert engine.nodes_off_provider == 0
