"""The engine opens only what its manifest describes, on the provider that was asked for."""

from __future__ import annotations

import dataclasses
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.artifacts import Manifest, TensorSpec, file_digest, load_manifest
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.errors import ArtifactError, InputError, Unavailable
from drape.garment.cache import Garment
from drape.graph.packing import pack_body
from service.graphs.engine import ENCODER, PACKED, PUSH, PUSH_OVER, Engine
from service.graphs.onnx_runtime import Device, check_distributions, open_session
from service.graphs.packing import Packer, ScenePlan
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import ROUNDING_M, TINY, expected_vertices, tube_garment


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


def test_the_readable_graph_is_never_opened(folder: Path, body: BodyModel, tube: Garment, monkeypatch):
    """It stays in the folder as the reference of the export's check; a model without it is served."""
    opened: list[str] = []

    def recorded(label: str, *arguments: object, **options: object):
        opened.append(label)
        return open_session(label, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("service.graphs.engine.open_session", recorded)
    manifest = load_manifest(folder)
    rewrite(folder, graphs={name: spec for name, spec in manifest.graphs.items() if name != "drape"})
    engine = Engine(folder)
    engine.check_body(body)
    packer = Packer(engine, body)
    packer.add("tube", tube)
    poses, rest = random_motion(2)[0], np.zeros((2, 3))
    results = packer.run(ScenePlan(), pack_body(body).rows(poses), [("tube", 0), ("tube", 1)])
    expected = expected_vertices(body, tube, poses, rest) - body.rest_joints(None)[0]
    assert_allclose([r.arrays["vertices"] for r in results], expected, rtol=0, atol=ROUNDING_M)
    assert opened == [f"{TINY}/garment_encoder.onnx", f"{TINY}/packed.onnx"]
    assert engine.provider == "CPUExecutionProvider"


def test_a_part_of_a_graph_is_opened_once(folder: Path):
    engine = Engine(folder)
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
        Engine(folder)


def test_a_manifest_with_other_tensors_is_refused_by_name(folder: Path):
    inputs = load_manifest(folder).graphs[ENCODER].inputs
    respecify(folder, ENCODER, inputs=(dataclasses.replace(inputs[0], name="features"),))
    with pytest.raises(ArtifactError, match="tiny garment_encoder inputs"):
        Engine(folder)
    respecify(folder, ENCODER, inputs=(dataclasses.replace(inputs[0], dtype="float64"),))
    with pytest.raises(ArtifactError, match="patch_features: expected float64"):
        Engine(folder)


def test_features_of_another_length_are_refused(folder: Path):
    garment = tube_garment(load_body())
    with pytest.raises(ArtifactError, match="patch_features: expected 166 numbers"):
        Engine(folder).first(dataclasses.replace(garment, patch_features=garment.patch_features[:, :5]))


def test_passes_that_cannot_be_chosen_are_refused(folder: Path):
    spec = load_manifest(folder).graphs[PACKED]
    respecify(folder, PACKED, outputs=tuple(tensor for tensor in spec.outputs if not tensor.name.startswith("pass_")))
    engine = Engine(folder)
    assert engine.check_passes(0) is None  # there are none
    with pytest.raises(InputError, match="passes: expected none: the passes of model tiny are fixed, got 1"):
        engine.check_passes(1)


def test_specs_survive_their_json(folder: Path):
    manifest = load_manifest(folder)
    assert manifest.graphs[PACKED].inputs[0] == TensorSpec(
        "joint_quaternion", ("bodies", 25, 4), "float32", "1, relative to the parent"
    )
