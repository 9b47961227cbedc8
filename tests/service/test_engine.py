"""The engine opens only what its manifest describes, on the provider that was asked for."""

from __future__ import annotations

import dataclasses
import shutil
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.testing import assert_allclose
from onnx import helper

from drape.artifacts import Manifest, TensorSpec, file_digest, load_manifest
from drape.body.model import BodyModel
from drape.errors import ArtifactError, Unavailable
from drape.garment.cache import Garment
from drape.graph.feeds import body_feed, garment_feed
from service.engine import DRAPE, ENCODER, Engine
from service.runtime import Device, check_distributions
from tests.fixtures.tiny_model import ENCODER_MATRIX, TINY


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
    with pytest.raises(Unavailable, match=r"none installed\. Install one: pip install '\.\[cpu\]'"):
        check_distributions()


@pytest.mark.parametrize("name", ["onnxruntime", "onnxruntime-gpu"])
def test_one_onnxruntime_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str):
    install(tmp_path, name)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert check_distributions() == name


def test_it_computes_what_its_graphs_say(folder: Path, body: BodyModel, tube: Garment):
    engine = Engine(folder)
    engine.check_body(body)
    embedding = engine.embed(tube.patch_features)
    assert_allclose(embedding, tube.patch_features @ ENCODER_MATRIX, rtol=1e-5, atol=1e-6)
    feed = body_feed(body, np.zeros((2, 24, 3)), np.zeros((2, 3)))
    vertices = engine.drape({**feed.arrays, **garment_feed(tube), "patch_embedding": 0.0 * embedding})
    assert_allclose(vertices + feed.root[:, None], np.stack([tube.vertices] * 2), rtol=0, atol=2e-6)
    assert engine.provider == "CPUExecutionProvider"


@pytest.mark.filterwarnings("ignore:Specified provider")
@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="CUDA may open here")
def test_cuda_that_does_not_open_is_refused(folder: Path):
    with pytest.raises(Unavailable, match=r"^DRAPE_PROVIDER: expected CUDAExecutionProvider .*DRAPE_PROVIDER=cpu"):
        Engine(folder, device=Device("cuda"))


def test_another_body_is_refused(folder: Path, body: BodyModel):
    with pytest.raises(ArtifactError, match="body_digest"):
        Engine(folder).check_body(dataclasses.replace(body, digest="0" * 64))


def test_a_missing_graph_is_refused(folder: Path):
    manifest = load_manifest(folder)
    rewrite(folder, graphs={ENCODER: manifest.graphs[ENCODER]})
    with pytest.raises(ArtifactError, match="graph 'drape'"):
        Engine(folder)


def test_a_changed_file_is_refused(folder: Path):
    file = folder / "drape.onnx"
    file.write_bytes(file.read_bytes() + b"\0")
    with pytest.raises(ArtifactError, match=r"drape\.onnx sha256"):
        Engine(folder)


def test_a_file_that_is_no_graph_is_refused(folder: Path):
    (folder / "drape.onnx").write_bytes(b"not a graph")
    respecify(folder, DRAPE)
    with pytest.raises(ArtifactError, match="a graph that ONNX Runtime opens"):
        Engine(folder)


def test_a_manifest_with_other_tensors_is_refused_by_name(folder: Path):
    inputs = load_manifest(folder).graphs[DRAPE].inputs
    respecify(folder, DRAPE, inputs=inputs[1:])
    with pytest.raises(ArtifactError, match="tiny drape inputs"):
        Engine(folder)
    respecify(folder, DRAPE, inputs=(*inputs[:-1], dataclasses.replace(inputs[-1], dtype="float64")))
    with pytest.raises(ArtifactError, match="chart_local: expected float64"):
        Engine(folder)


def test_a_graph_without_vertices_is_refused(folder: Path):
    path = folder / "drape.onnx"
    model = onnx.load(str(path))
    for node in model.graph.node:
        node.output[:] = ["points" if name == "vertices" else name for name in node.output]
    for output in model.graph.output:
        output.name = "points" if output.name == "vertices" else output.name
    onnx.save(model, str(path))
    outputs = tuple(
        dataclasses.replace(t, name="points") if t.name == "vertices" else t
        for t in load_manifest_unchecked(folder).graphs[DRAPE].outputs
    )
    respecify(folder, DRAPE, outputs=outputs)
    with pytest.raises(ArtifactError, match="drape outputs: expected vertices"):
        Engine(folder)


def load_manifest_unchecked(folder: Path) -> Manifest:
    return Manifest.from_json((folder / "manifest.json").read_text(), where="test")


def test_features_of_another_length_are_refused(folder: Path):
    with pytest.raises(ArtifactError, match="patch_features: expected 154 numbers"):
        Engine(folder).embed(np.zeros((12, 5)))


def test_answers_that_are_not_finite_are_refused(folder: Path, body: BodyModel, tube: Garment):
    path = folder / "drape.onnx"
    model = onnx.load(str(path))
    for node in model.graph.node:
        node.output[:] = ["whole" if name == "vertices" else name for name in node.output]
    model.graph.node.append(helper.make_node("Div", ["whole", "nought"], ["vertices"]))
    model.graph.initializer.append(helper.make_tensor("nought", onnx.TensorProto.FLOAT, [1], [0.0]))
    onnx.save(model, str(path))
    respecify(folder, DRAPE)
    engine = Engine(folder)
    feed = body_feed(body, np.zeros((1, 24, 3)), np.zeros((1, 3)))
    with pytest.raises(ArtifactError, match="vertices: expected finite"):
        engine.drape({**feed.arrays, **garment_feed(tube), "patch_embedding": engine.embed(tube.patch_features)})


def test_specs_survive_their_json(folder: Path):
    manifest = load_manifest(folder)
    assert manifest.graphs[DRAPE].inputs[0] == TensorSpec("body_features", ("frame", 226), "float32")
