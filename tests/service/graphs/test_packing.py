"""Packed batches: the same bits alone and in any mix, only what a plan asks for, refusals."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.contact.skin import body_skin, skin_table
from drape.errors import ArtifactError, InputError, NotFound
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.packing import pack_body, pass_name
from drape.inference.engine import Engine
from drape.inference.graph_names import PACKED
from drape.inference.onnx_runtime import Device
from drape.inference.packing import SHAPE_INDEX, Packer, Result, ScenePlan
from drape.inference.subgraph import cut
from drape.stages.batch import PoseInput
from drape.stages.walk import run
from drape.wire.options import DrapeOptions
from model_export.parity import parity_poses
from model_export.readable_graphs import DrapeGraph, drape_inputs
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.packed import KINDS, described, exported, garment
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import expected_vertices
from tests.service.graphs.packers import BODIES, bodies, make_packer, packer_of
from training.onefit import OneFit

pytestmark = pytest.mark.slow
__all__ = ["bodies"]  # a fixture
WEIGHTS_FOLDER = "session.model_external_initializers_file_folder_path"  # of models that come as bytes
PLANS = [ScenePlan(), ScenePlan("both", skin=True), ScenePlan("jets"), ScenePlan(passes=0)]


@pytest.fixture(scope="module")
def packer() -> Packer:
    return make_packer()


@pytest.fixture(scope="module", params=["graph", "compiled"])
def either(request: pytest.FixtureRequest, packer: Packer) -> Packer:
    """A packer that runs the graph, and one whose network is compiled."""
    return packer if request.param == "graph" else make_packer(compiled=True)


def test_it_drapes_as_the_readable_graph(either: Packer):
    body = load_body()
    poses, _ = random_motion(3, seed=2)
    betas = np.linspace(-1.0, 1.0, body.shape_count)
    rows, root = pack_body(body, betas).rows(poses), body.rest_joints(betas)[0]
    items = [("shorts", 1), ("tank", 2), ("shorts", 0)]
    for (kind, row), result in zip(items, either.run(ScenePlan(), rows, items), strict=True):
        want = expected_vertices(body, garment(kind), poses[row : row + 1], np.zeros((1, 3)), betas)[0] - root
        assert result.finite
        assert_allclose(result.arrays["vertices"], want, rtol=0, atol=1e-5)


def test_all_passes_are_the_default_and_fewer_are_the_readable_network_with_fewer(either: Packer):
    model, folder, _ = exported()
    count, body = Engine(folder).pass_count, load_body()
    assert count == model.config.corrections > 0
    poses, _ = random_motion(3, seed=2)
    rows, items = pack_body(body).rows(poses), [("shorts", 1), ("tank", 2), ("shorts", 0)]
    whole = [r.arrays["vertices"] for r in either.run(ScenePlan(), rows, items)]
    every = [r.arrays["vertices"] for r in either.run(ScenePlan(passes=count), rows, items)]
    for a, b in zip(whole, every, strict=True):
        assert_array_equal(a, b)
    readable = DrapeGraph(model).eval()
    feed = body_feed(body, poses, np.zeros((3, 3)), skin=True)
    for passes in range(count):
        found = either.run(ScenePlan(passes=passes), rows, items)
        for (kind, row), result, before in zip(items, found, whole, strict=True):
            one = {name: value[row : row + 1] for name, value in feed.arrays.items()}
            with torch.no_grad():
                embedding = model.garment(torch.from_numpy(described(kind))).numpy()
            arrays = {**one, **garment_feed(garment(kind), body=body), "patch_embedding": embedding}
            with torch.no_grad():
                taken = {spec.name: torch.from_numpy(arrays[spec.name]) for spec in drape_inputs(model)}
                want = with_passes(readable, passes)(taken)[0].numpy()[0]
            got = result.arrays["vertices"]
            assert_allclose(got, want, rtol=0, atol=1e-5)
            assert np.abs(got - before).max() > 1e-3, "must differ for the test to mean something"


def with_passes(readable: DrapeGraph, passes: int) -> DrapeGraph:
    """``readable`` with only the first ``passes`` corrections of its network."""
    shorter = copy.deepcopy(readable)
    for part in shorter.modules():
        if isinstance(part, OneFit):
            part.corrections = part.corrections[:passes]
    return shorter


def test_passes_that_the_model_does_not_have_are_refused(packer: Packer, tmp_path: Path):
    rows = pack_body(load_body()).rows(np.zeros((1, 24, 3)))
    for passes in (-1, Engine(exported()[1]).pass_count + 1):
        with pytest.raises(InputError, match="passes: expected 0 to"):
            packer.run(ScenePlan(passes=passes), rows, [("tank", 0)])


def test_fewer_passes_take_fewer_weights():
    data = (exported()[1] / "packed.onnx").read_bytes()
    last = pass_name(Engine(exported()[1]).pass_count)
    held = []
    for instead in ({}, {last: pass_name(0)}):
        graph = onnx.load_from_string(cut(data, ["vertices"], instead=instead)).graph
        held.append(sum(int(np.prod(tensor.dims)) for tensor in graph.initializer))
    assert held[0] - held[1] >= sum(p.numel() for p in exported()[0].corrections.parameters())


@pytest.mark.parametrize(("threads", "compiled"), [(1, False), (2, True)])
def test_an_item_has_the_same_bits_alone_and_in_any_batch(bodies, threads: int, compiled: bool):
    packer = make_packer(threads, compiled=compiled)
    generator = np.random.default_rng(threads)
    alone: dict[tuple[ScenePlan, str, int], dict[str, np.ndarray]] = {}
    for size in (1, 2, 3, 7, 20, BODIES):
        plan = PLANS[generator.integers(len(PLANS))]
        items = [(KINDS[generator.integers(len(KINDS))], int(generator.integers(BODIES))) for _ in range(size)]
        for (kind, row), result in zip(items, packer.run(plan, bodies, items), strict=True):
            key = (plan, kind, row)
            if key not in alone:
                one = {name: values[row : row + 1] for name, values in bodies.items()}
                alone[key] = packer.run(plan, one, [(kind, 0)])[0].arrays
            assert result.arrays.keys() == alone[key].keys() == set(plan.outputs)
            for name, value in result.arrays.items():
                assert_array_equal(value, alone[key][name], err_msg=f"{name} of {kind} in a batch of {size}")


def test_parts_of_a_batch_and_threads_change_no_bit(bodies):
    items = [(KINDS[i % len(KINDS)], i) for i in range(8)]
    whole, parts, threaded = (
        [r.arrays["vertices"] for r in made.run(ScenePlan(), bodies, items)]
        for made in (make_packer(tiles_per_call=1 << 20), make_packer(tiles_per_call=1), make_packer(2))
    )
    for a, b, c in zip(whole, parts, threaded, strict=True):
        assert_array_equal(a, b)
        assert_array_equal(a, c)


def test_a_body_is_posed_once_for_all_that_it_wears(bodies, monkeypatch: pytest.MonkeyPatch):
    packer, posed = make_packer(compiled=True, tiles_per_call=1), []
    network = packer._engine.compiled
    assert network is not None
    body = network.body
    monkeypatch.setattr(network, "body", lambda feed, row, counts: posed.append(row) or body(feed, row, counts))
    packer.run(ScenePlan(), bodies, [(kind, row) for kind in KINDS for row in (0, 1)])
    assert posed == [0, 1]


def nodes_run(packer: Packer, plan: ScenePlan, folder: Path) -> list[str]:
    """Names of the nodes that ONNX Runtime ran for ``plan``, from its own profile."""
    engine = packer._engine
    data = cut((exported()[1] / "packed.onnx").read_bytes(), plan.outputs, direct=SHAPE_INDEX)
    options = onnxruntime.SessionOptions()
    options.enable_profiling, options.profile_file_prefix = True, str(folder / "profile")
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL  # names stay
    options.add_session_config_entry(WEIGHTS_FOLDER, str(exported()[1]))
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    key = PACKED, plan.outputs, SHAPE_INDEX, plan.passes, ()
    engine._opened[key] = _Recorded(session)  # type: ignore[assignment]
    rows = pack_body(load_body()).rows(np.zeros((1, 24, 3)))
    packer.run(plan, rows, [("tank", 0), ("shorts", 0)])
    events = json.loads(Path(session.end_profiling()).read_text())
    return [e["name"].removesuffix("_kernel_time") for e in events if e["name"].endswith("_kernel_time")]


class _Recorded:
    """A session as the packer takes it, around one that profiles."""

    def __init__(self, session: onnxruntime.InferenceSession) -> None:
        self._session = session
        self.inputs = tuple(tensor.name for tensor in session.get_inputs())

    def run(self, outputs, feed) -> list[np.ndarray]:
        values = {n: Device().value(v) if isinstance(v, np.ndarray) else v for n, v in feed.items()}
        return [value.numpy() for value in self._session.run_with_ort_values(list(outputs), values)]


@pytest.mark.parametrize(
    "plan", [ScenePlan(), ScenePlan("both", skin=True), ScenePlan("jets")], ids=["vertices", "both", "jets"]
)
def test_nothing_that_a_plan_does_not_ask_for_is_computed(plan: ScenePlan, tmp_path: Path):
    packer = make_packer()
    ran = nodes_run(packer, plan, tmp_path)
    graph = onnx.load(str(exported()[1] / "packed.onnx")).graph
    ancestors, needed = set(), set(plan.outputs)
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            ancestors.add(node.name)
            needed.update(node.input)
    gathers = {n.name for n in graph.node if n.op_type == "Gather" and n.input[1] in SHAPE_INDEX}
    assert sorted(ran) == sorted(ancestors - gathers)
    assert len(ran) < len(graph.node)


def test_the_posed_skin_is_that_of_the_bones_and_bodies_may_differ_in_shape():
    body, poses = load_body(), parity_poses(3, seed=2)
    betas = [np.zeros(10), np.linspace(-1.0, 1.0, 10), np.zeros(10)]
    rows = [pack_body(body, shape).rows(poses[i : i + 1]) for i, shape in enumerate(betas)]
    joined = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    packer = make_packer()
    items = [("tank", 0), ("shorts", 1), ("tank", 2)]
    together = packer.run(ScenePlan(skin=True), joined, items)
    for i, (result, shape) in enumerate(zip(together, betas, strict=True)):
        alone = packer.run(ScenePlan(skin=True), rows[i], [(items[i][0], 0)])[0]
        for name, value in result.arrays.items():
            assert_array_equal(value, alone.arrays[name])
        rotations, translations = body.bones(poses[i : i + 1], None, shape)
        on_bones = body_skin(body).on_bones(body, shape)
        relative = translations - body.rest_joints(shape)[0]
        want = skin_table(on_bones.rows, on_bones.bones, rotations.astype(np.float32), relative.astype(np.float32))
        assert_allclose(result.arrays["skin"][..., :4], want[0, ..., :4], rtol=0, atol=2e-6)
        assert_allclose(result.arrays["skin"], want[0], rtol=0, atol=5e-4)  # normals of folds are short cross products


def test_what_is_not_finite_is_told_of_its_own_item(bodies):
    packer = make_packer()
    quaternion = bodies["joint_quaternion"].copy()
    quaternion[3, 7] = np.nan
    for plan in PLANS:
        results = packer.run(plan, bodies | {"joint_quaternion": quaternion}, [("tank", 2), ("tank", 3), ("shorts", 4)])
        assert [result.finite for result in results] == [True, False, True]


def test_prepare_opens_the_sessions_of_a_plan():
    packer = make_packer()
    packer.prepare(ScenePlan("jets"), skin_given=False, shapes=False)
    opened = {key[1:3] for key in packer._engine._opened if key[0] == PACKED}
    assert opened == {(ScenePlan("jets").outputs, SHAPE_INDEX)}
    packer.prepare(ScenePlan("jets"), skin_given=False, shapes=True)
    assert (PACKED, ScenePlan("jets").outputs, (), None, ()) in packer._engine._opened


def test_no_items_give_no_results(packer: Packer, bodies):
    assert packer.run(ScenePlan(), bodies, []) == []


@pytest.mark.parametrize("row", [-1, BODIES])
def test_a_body_that_is_not_there_is_refused(packer: Packer, bodies, row: int):
    with pytest.raises(InputError, match=rf"body row: expected a row in \[0, {BODIES}\), got {row}"):
        packer.run(ScenePlan(), bodies, [("tank", 0), ("tank", row)])


def test_a_garment_that_is_not_in_store_is_refused(packer: Packer, bodies):
    with pytest.raises(NotFound, match="garment: expected tank, shorts, trousers, got cape"):
        packer.run(ScenePlan(), bodies, [("cape", 0)])
    with pytest.raises(NotFound, match="got cape"):
        packer.remove("cape")


def test_a_manifest_with_other_tensors_is_refused(tmp_path: Path):
    folder = Path(shutil.copytree(exported()[1], tmp_path / "small"))
    manifest = load_manifest(folder)
    spec = manifest.graphs[PACKED]
    tensors = tuple(replace(t, dtype="float16") if t.name == "patch_first" else t for t in spec.inputs)
    changed = replace(manifest, graphs={**manifest.graphs, PACKED: replace(spec, inputs=tensors)})
    (folder / "manifest.json").write_text(changed.to_json())
    packer = Packer(Engine(folder, compiled=False), load_body())
    packer.add("tank", garment("tank"))
    with pytest.raises(ArtifactError, match="packed patch_first: expected float16 as in the manifest"):
        packer.prepare(ScenePlan(), skin_given=False, shapes=False)


def test_the_service_refuses_what_is_not_finite(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime()
    entry = runtime.garments.get("tube")
    broken = replace(entry.garment, patch_features=np.full_like(entry.garment.patch_features, np.nan))
    plan = runtime.plan(entry, DrapeOptions())
    for stage in runtime.stages:
        stage.add(broken, garment_feed(broken, body=runtime.body))
    rest = PoseInput(np.zeros((1, 24, 3)), np.zeros((1, 3)), np.zeros(runtime.body.shape_count), np.zeros(1))
    with pytest.raises(ArtifactError, match="tiny vertices: expected finite numbers"):
        run(plan, [rest])


def test_two_threads_get_the_bits_of_one(bodies: dict[str, np.ndarray]):
    packer, plan = make_packer(), ScenePlan()
    batches = [[(kind, row) for kind in KINDS[: 1 + row % len(KINDS)]] for row in range(8)]
    alone = [packer.run(plan, bodies, items) for items in batches]
    packer._forget()

    def all_of_them(_: int) -> list[list[Result]]:
        return [packer.run(plan, bodies, items) for items in batches]

    with ThreadPoolExecutor(2) as threads:
        for found in threads.map(all_of_them, range(4)):
            for items, wanted in zip(found, alone, strict=True):
                for one, other in zip(items, wanted, strict=True):
                    assert_array_equal(one.arrays["vertices"], other.arrays["vertices"])
    assert packer.kept_bytes == sum(call.composition.bytes for call in packer._kept.values())


@pytest.mark.slow
@pytest.mark.gpu
def test_a_gpu_drapes_as_the_cpu(bodies: dict[str, np.ndarray]):
    plain, on_gpu = make_packer(), packer_of(Engine(exported()[1], device=Device("cuda")))
    items = [("tank", 0), ("shorts", 3), ("tank", 2)]
    for plan in (ScenePlan("both", skin=True), ScenePlan("jets"), ScenePlan(passes=1)):
        for a, b in zip(plain.run(plan, bodies, items), on_gpu.run(plan, bodies, items), strict=True):
            if "vertices" in a.arrays:
                assert_allclose(b.arrays["vertices"], a.arrays["vertices"], rtol=0, atol=1e-3)
