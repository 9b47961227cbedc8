"""Model folders as the service opens them: what is run of them, what is refused, weights that graphs share."""

from __future__ import annotations

import dataclasses
import shutil
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from onnx import TensorProto, helper

from drape.artifacts import MODELS_DIR, Manifest, TensorSpec, file_digest, load_manifest
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.errors import ArtifactError, InputError, Unavailable
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.graph_names import DYNAMIC, ENCODER, PACKED, PUSH, PUSH_OVER
from drape.inference.onnx_runtime import Device, Session, check_distributions, nodes_off_provider, open_session
from drape.inference.packing import Packer, ScenePlan
from drape.stages.collision import Pusher
from tests.fixtures.garments import tube_garment
from tests.fixtures.packed import MOVING, exported, garment
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import ROUNDING_M, STATE_SIZE, TINY, TINY_DYNAMIC, expected_vertices


@pytest.fixture
def folder(tiny_folder: Path, tmp_path: Path) -> Path:
    """A copy of the tiny model that a test may spoil."""
    return Path(shutil.copytree(tiny_folder / "models" / TINY, tmp_path / TINY))


def rewrite(folder: Path, **changes: object) -> None:
    manifest = dataclasses.replace(load_manifest(folder), **changes)
    (folder / "manifest.json").write_text(manifest.to_json())


def respecify(folder: Path, graph: str, **changes: object) -> None:
    """Writes the manifest with one graph's entry changed, and the digest of its file as it is now."""
    manifest = Manifest.from_json((folder / "manifest.json").read_text(), where="test")
    spec = manifest.graphs[graph]
    spec = dataclasses.replace(spec, **{"sha256": file_digest(folder / spec.file), **changes})
    changed = dataclasses.replace(manifest, graphs={**manifest.graphs, graph: spec})
    (folder / "manifest.json").write_text(changed.to_json())


def install(folder: Path, *names: str) -> None:
    """Distributions as pip leaves them: a dist-info folder with METADATA."""
    for name in names:
        info = folder / f"{name.replace('-', '_')}-9.9.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.9\n")


def test_two_onnxruntimes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    install(tmp_path, "onnxruntime", "onnxruntime-gpu")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(Unavailable, match=r"both: onnxruntime 9.9 and onnxruntime-gpu 9.9\. Uninstall both"):
        check_distributions()


def test_no_onnxruntime_is_refused_with_the_extras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    with pytest.raises(Unavailable, match=r"none installed.*Install one: pip install onnxruntime"):
        check_distributions()


@pytest.mark.parametrize("name", ["onnxruntime", "onnxruntime-gpu"])
def test_one_onnxruntime_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str):
    install(tmp_path, name)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert check_distributions() == name


def test_the_readable_graph_is_not_opened_where_there_is_a_packed_one(
    folder: Path, body: BodyModel, tube: Garment, monkeypatch
):
    """It stays in the folder as the reference of the export's check; a model without it is served."""
    opened: list[str] = []

    def recorded(label: str, *arguments: object, **options: object):
        opened.append(label)
        return open_session(label, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("drape.inference.engine.open_session", recorded)
    manifest = load_manifest(folder)
    rewrite(folder, graphs={name: spec for name, spec in manifest.graphs.items() if name != "drape"})
    engine = Engine(folder, compiled=False)
    engine.check_body(body)
    packer = Packer(engine, body)
    packer.add("tube", tube)
    poses, rest = random_motion(2)[0], np.zeros((2, 3))
    results = packer.run(ScenePlan(), pack_body(body).rows(poses), [("tube", 0), ("tube", 1)])
    expected = expected_vertices(body, tube, poses, rest) - body.rest_joints(None)[0]
    assert_allclose([r.arrays["vertices"] for r in results], expected, rtol=0, atol=ROUNDING_M)
    assert opened == [f"{TINY}/garment_encoder.onnx", f"{TINY}/packed.onnx"]
    assert engine.provider == "CPUExecutionProvider"


def test_the_engine_needs_no_onnx_runtime(tiny_folder: Path, monkeypatch: pytest.MonkeyPatch):
    def refused(*_: object, **__: object) -> None:
        raise AssertionError("ONNX Runtime was asked for")

    for name in ("check_distributions", "open_session"):
        monkeypatch.setattr(f"drape.inference.engine.{name}", refused)
    engine = Engine(tiny_folder / "models" / TINY_DYNAMIC)
    packer, pusher = Packer(engine, load_body()), Pusher(engine, load_body())
    whole = garment("tank")
    packer.add("tank", whole)
    pusher.add("tank", garment_feed(whole), whole.vertices[: whole.vertex_count], whole.faces)
    engine.advance(np.zeros((1, 24, 12)), np.zeros((1, STATE_SIZE)), np.full(1, 0.03))
    plan, body = ScenePlan(skin=True), pack_body(load_body()).rows(np.zeros((1, 24, 3)))
    (found,) = packer.run(plan, body, [("tank", 0)])
    pusher.push(["tank"], found.arrays["vertices"][None], found.arrays["skin"][None])


def test_a_part_of_a_graph_is_opened_once(folder: Path):
    engine = Engine(folder, compiled=False)
    part = engine.open_cut(PACKED, ["vertices"])
    assert engine.open_cut(PACKED, ("vertices",), passes=engine.pass_count) is part  # all of them are the default
    assert engine.open_cut(PACKED, ["vertices"], passes=0) is not part
    assert engine.open_cut(PACKED, ["vertices"], given=["skin"]) is not part


@pytest.mark.filterwarnings("ignore:Specified provider")
@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="CUDA may open here")
def test_cuda_that_does_not_open_is_refused(folder: Path):
    with pytest.raises(Unavailable, match=r"^DRAPE_PROVIDER: expected CUDAExecutionProvider .*DRAPE_PROVIDER=cpu"):
        Engine(folder, device=Device("cuda"))


def test_another_body_is_refused(folder: Path, body: BodyModel):
    with pytest.raises(ArtifactError, match="body_digest"):
        Engine(folder).check_body(dataclasses.replace(body, digest="0" * 64))


@pytest.mark.parametrize("name", [ENCODER, PACKED, PUSH, PUSH_OVER])
def test_a_missing_graph_is_refused(folder: Path, name: str):
    manifest = load_manifest(folder)
    rewrite(folder, graphs={key: spec for key, spec in manifest.graphs.items() if key != name})
    with pytest.raises(ArtifactError, match=rf"graph '{name}'.*Export the model again\."):
        Engine(folder)


@pytest.mark.parametrize(("name", "output"), [(ENCODER, "patch_first"), (PACKED, "jet"), (PUSH, "skin")])
def test_a_graph_without_what_is_read_of_it_is_refused(folder: Path, name: str, output: str):
    spec = load_manifest(folder).graphs[name]
    respecify(folder, name, outputs=tuple(tensor for tensor in spec.outputs if tensor.name != output))
    with pytest.raises(ArtifactError, match=f"{TINY} {name} outputs: expected {output}"):
        Engine(folder)


def test_a_changed_file_is_refused(folder: Path):
    file = folder / "packed.onnx"
    file.write_bytes(file.read_bytes() + b"\0")
    with pytest.raises(ArtifactError, match=r"packed\.onnx sha256"):
        Engine(folder)


def test_a_file_that_is_no_graph_is_refused(folder: Path):
    (folder / "garment_encoder.onnx").write_bytes(b"not a graph")
    respecify(folder, ENCODER)
    with pytest.raises(ArtifactError, match="model: expected an ONNX model"):
        Engine(folder, compiled=False)


def test_a_manifest_with_other_tensors_is_refused_by_name(folder: Path):
    inputs = load_manifest(folder).graphs[ENCODER].inputs
    respecify(folder, ENCODER, inputs=(dataclasses.replace(inputs[0], name="features"),))
    with pytest.raises(ArtifactError, match="tiny garment_encoder inputs"):
        Engine(folder, compiled=False)
    respecify(folder, ENCODER, inputs=(dataclasses.replace(inputs[0], dtype="float64"),))
    with pytest.raises(ArtifactError, match="patch_features: expected float64"):
        Engine(folder, compiled=False)


def test_features_of_another_length_are_refused(folder: Path):
    garment = tube_garment(load_body())
    with pytest.raises(ArtifactError, match="patch_features: expected 166 numbers"):
        Engine(folder).encode(dataclasses.replace(garment, patch_features=garment.patch_features[:, :5]))


def test_passes_that_cannot_be_chosen_are_refused(folder: Path):
    spec = load_manifest(folder).graphs[PACKED]
    respecify(folder, PACKED, outputs=tuple(tensor for tensor in spec.outputs if not tensor.name.startswith("pass_")))
    engine = Engine(folder)
    assert engine.check_passes(0) is None  # there are none
    with pytest.raises(InputError, match="passes: expected none: the passes of model tiny are fixed, got 1"):
        engine.check_passes(1)


@pytest.fixture
def dynamic_folder(tiny_folder: Path, tmp_path: Path) -> Path:
    """A copy of the dynamic model that a test may spoil."""
    return Path(shutil.copytree(tiny_folder / "models" / TINY_DYNAMIC, tmp_path / TINY_DYNAMIC))


def test_the_engine_knows_what_it_opened(dynamic_folder: Path, tiny_folder: Path):
    engine = Engine(dynamic_folder)
    assert (engine.dynamic, engine.state_size, engine.code_size) == (True, STATE_SIZE, MOVING.body_code_size)
    static = Engine(tiny_folder / "models" / TINY)
    assert (static.dynamic, static.state_size, static.code_size) == (False, 0, 0)


def test_a_dynamic_model_without_its_recurrent_graph_is_refused(dynamic_folder: Path):
    graphs = load_manifest(dynamic_folder).graphs
    rewrite(dynamic_folder, graphs={key: spec for key, spec in graphs.items() if key != DYNAMIC})
    with pytest.raises(ArtifactError, match=f"graph '{DYNAMIC}'"):
        Engine(dynamic_folder)


@pytest.mark.parametrize("changes", [{"dynamic": False}, {"state_size": STATE_SIZE + 1}])
def test_a_manifest_that_says_otherwise_than_its_graphs_is_refused(dynamic_folder: Path, changes: dict):
    rewrite(dynamic_folder, **changes)
    with pytest.raises(ArtifactError, match="dynamic: expected a packed graph with a dynamic_code"):
        Engine(dynamic_folder)


def test_a_packed_graph_that_takes_no_code_is_refused(dynamic_folder: Path):
    graphs = load_manifest(dynamic_folder).graphs
    inputs = tuple(tensor for tensor in graphs[PACKED].inputs if tensor.name != "dynamic_code")
    rewrite(dynamic_folder, graphs={**graphs, PACKED: dataclasses.replace(graphs[PACKED], inputs=inputs)})
    with pytest.raises(ArtifactError, match="dynamic: expected a packed graph with a dynamic_code"):
        Engine(dynamic_folder)


def test_a_state_that_is_not_finite_is_refused(dynamic_folder: Path):
    engine = Engine(dynamic_folder)
    features = np.zeros((2, 24, 12), np.float32)
    features[1, 0, 9] = np.nan
    with pytest.raises(ArtifactError, match="next_state: expected finite numbers"):
        engine.advance(features, np.zeros((2, STATE_SIZE)), np.full(2, 0.03))


JETS = ["jet", "frame_centre"]


@pytest.fixture
def weights_folder(tmp_path: Path) -> Path:
    """A copy of the shipped model that a test may spoil."""
    return Path(shutil.copytree(MODELS_DIR / "onefit", tmp_path / "onefit"))


def with_weights(weights_folder: Path, content: Callable[[bytes], bytes]) -> Path:
    """``weights_folder`` after its weights became ``content`` of what they were, and the manifest agrees."""
    manifest = load_manifest(weights_folder)
    assert manifest.weights is not None
    path = weights_folder / manifest.weights.file
    path.write_bytes(content(path.read_bytes()))
    agreeing = replace(manifest, weights=replace(manifest.weights, sha256=file_digest(path)))
    (weights_folder / "manifest.json").write_text(agreeing.to_json())
    return weights_folder


def jets(engine: Engine) -> list[np.ndarray]:
    """Posed jets for drawn numbers, by a part of the packed graph that is opened now: three of all, every index 0."""
    part, draw, feed = engine.open_cut(PACKED, JETS), np.random.default_rng(3), {}
    for tensor in engine.manifest.graphs[PACKED].inputs:
        shape = [3 if isinstance(axis, str) else axis for axis in tensor.shape]
        drawn = (
            np.zeros(shape) if tensor.dtype.startswith("int") else draw.uniform(0.01, 0.1, size=shape)
        )  # passes stay small
        if tensor.name in part.inputs:
            feed[tensor.name] = engine.value(drawn.astype(tensor.dtype))
    return part.run(JETS, feed)


def same(got: list[np.ndarray], want: list[np.ndarray]) -> None:
    for have, wanted in zip(got, want, strict=True):
        assert np.isfinite(wanted).all()
        assert_array_equal(have, wanted)


def test_a_folder_replaced_later_mixes_with_nothing_that_is_open(weights_folder: Path):
    engine = Engine(weights_folder)
    want = jets(engine)
    other = Engine(with_weights(weights_folder, lambda raw: (1.5 * np.frombuffer(raw, np.float32)).tobytes()))
    same(jets(engine), want)
    assert np.abs(jets(other)[0] - want[0]).max() > 1e-3
    assert other.manifest.digest != engine.manifest.digest


def test_a_folder_without_shared_weights_gives_the_same_bits(weights_folder: Path):
    """As folders were before: every graph holds its own tensors."""
    manifest = load_manifest(weights_folder)
    graphs = {}
    for key, spec in manifest.graphs.items():
        onnx.save(onnx.load(str(weights_folder / spec.file)), str(weights_folder / spec.file))
        graphs[key] = replace(spec, sha256=file_digest(weights_folder / spec.file))
    assert manifest.weights is not None
    (weights_folder / manifest.weights.file).unlink()
    (weights_folder / "manifest.json").write_text(replace(manifest, graphs=graphs, weights=None).to_json())
    alone, shared = (Engine(folder, compiled=False) for folder in (weights_folder, MODELS_DIR / "onefit"))
    assert load_manifest(weights_folder).weights is None
    shirt = garment("tank")
    same([alone.encode(shirt)], [shared.encode(shirt)])
    same(jets(alone), jets(shared))


def test_weights_that_are_not_the_manifests_are_refused(weights_folder: Path):
    (weights_folder / "weights.bin").write_bytes((weights_folder / "weights.bin").read_bytes()[:-4])
    with pytest.raises(ArtifactError, match=r"onefit/weights\.bin sha256"):
        Engine(weights_folder)
    (weights_folder / "weights.bin").unlink()
    with pytest.raises(ArtifactError, match=r"onefit weights: expected weights\.bin, got no such file"):
        Engine(weights_folder)


def test_a_file_too_short_for_its_graphs_is_refused(weights_folder: Path):
    """The manifest agrees with the file, the graphs do not."""
    short = with_weights(weights_folder, lambda raw: raw[:4096])
    with pytest.raises(ArtifactError, match="expected a graph that ONNX Runtime opens"):
        Engine(short, compiled=False).open_cut(PACKED, JETS)
    with pytest.raises(ArtifactError, match="onefit parameters: expected those of the network that it describes"):
        Engine(short)


SMALL = np.full(4_000_000, 1e-30, np.float32)  # enough numbers for two threads to share
RUNS = 5  # where one thread comes too late to a run, it does not to all
FACTOR = np.full(1, 1e-10, np.float32)
INPUTS = (TensorSpec("x", ("n",), "float32", "1"), TensorSpec("y", (1,), "float32", "1"))


def multiplying(device: Device) -> Session:
    """z = x y for x (n,) and y (1,)."""
    x, y, z = (helper.make_tensor_value_info(*tensor) for tensor in (
        ("x", TensorProto.FLOAT, ["n"]), ("y", TensorProto.FLOAT, [1]), ("z", TensorProto.FLOAT, ["n"])
    ))  # fmt: skip
    graph = helper.make_graph([helper.make_node("Mul", ["x", "y"], ["z"])], "g", [x, y], [z])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    return Session(open_session("multiplying", model.SerializeToString(), {}, device), device)


def in_thread(call: Callable[[], np.ndarray]) -> np.ndarray:
    """What ``call`` gives in a thread of its own, which computes as before afterwards."""
    found = []

    def work() -> None:
        found.append(call())
        assert (SMALL[:4] * FACTOR > 0.0).all()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return found[0]


@pytest.mark.parametrize("threads", [1, 2])
def test_subnormal_numbers_are_zero_in_every_thread_of_a_session(threads: int):
    opened = multiplying(Device(threads=threads))
    feed = {"x": SMALL, "y": FACTOR}
    for run in (lambda call: call(), in_thread):
        for _ in range(RUNS):
            assert_array_equal(run(lambda: opened.run(["z"], feed)[0]), 0.0)
        assert_array_equal(run(lambda: opened.run(["z"], feed | {"x": -1e10 * SMALL})[0]), -1e10 * SMALL * FACTOR)
    assert (SMALL[:4] * FACTOR > 0.0).all()  # numpy, here


def test_nodes_that_run_elsewhere_are_counted():
    opened = multiplying(Device())._opened
    assert nodes_off_provider(opened, Device()) == 0
    assert nodes_off_provider(opened, Device("cuda")) == 1


def test_the_packed_graph_runs_where_it_is_asked_to():
    engine = Engine(exported()[1], compiled=False)
    engine.open_cut(PACKED, ["vertices"])
    assert engine.nodes_off_provider == 0
