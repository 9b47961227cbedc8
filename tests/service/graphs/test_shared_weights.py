"""Graphs whose weights lie in a file beside them: opened whole and in parts, and never with another model's weights."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.testing import assert_array_equal

from drape.artifacts import MODELS_DIR, file_digest, load_manifest
from drape.errors import ArtifactError
from service.graphs.engine import PACKED, Engine
from tests.fixtures.packed import garment

JETS = ["jet", "frame_centre"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the shipped model that a test may spoil."""
    return Path(shutil.copytree(MODELS_DIR / "onefit", tmp_path / "onefit"))


def changed(folder: Path) -> Path:
    """``folder`` after another model of the same sizes took its place."""
    manifest = load_manifest(folder)
    assert manifest.weights is not None
    path = folder / manifest.weights.file
    numbers = np.frombuffer(path.read_bytes(), np.float32)
    path.write_bytes((1.5 * numbers).astype(np.float32).tobytes())
    text = (folder / "manifest.json").read_text().replace(manifest.weights.sha256, file_digest(path))
    (folder / "manifest.json").write_text(text)
    return folder


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


def test_a_folder_replaced_later_mixes_with_nothing_that_is_open(folder: Path):
    engine = Engine(folder)
    want = jets(engine)
    other = Engine(changed(folder))
    same(jets(engine), want)
    assert np.abs(jets(other)[0] - want[0]).max() > 1e-3
    assert other.manifest.digest != engine.manifest.digest


def test_a_folder_without_shared_weights_gives_the_same_bits(folder: Path):
    """As folders were before: every graph holds its own tensors."""
    manifest = load_manifest(folder)
    graphs = {}
    for key, spec in manifest.graphs.items():
        onnx.save(onnx.load(str(folder / spec.file)), str(folder / spec.file))
        graphs[key] = replace(spec, sha256=file_digest(folder / spec.file))
    assert manifest.weights is not None
    (folder / manifest.weights.file).unlink()
    (folder / "manifest.json").write_text(replace(manifest, graphs=graphs, weights=None).to_json())
    alone, shared = Engine(folder), Engine(MODELS_DIR / "onefit")
    assert load_manifest(folder).weights is None
    shirt = garment("tank")
    same([alone.first(shirt)], [shared.first(shirt)])
    same(jets(alone), jets(shared))


def test_weights_that_are_not_the_manifests_are_refused(folder: Path):
    (folder / "weights.bin").write_bytes((folder / "weights.bin").read_bytes()[:-4])
    with pytest.raises(ArtifactError, match=r"onefit/weights\.bin sha256"):
        Engine(folder)
    (folder / "weights.bin").unlink()
    with pytest.raises(ArtifactError, match=r"onefit weights: expected weights\.bin, got no such file"):
        Engine(folder)


def test_a_file_too_short_for_its_graphs_is_refused(folder: Path):
    """The manifest agrees with the file, the graphs do not."""
    manifest = load_manifest(folder)
    assert manifest.weights is not None
    path = folder / manifest.weights.file
    path.write_bytes(path.read_bytes()[:4096])
    text = (folder / "manifest.json").read_text().replace(manifest.weights.sha256, file_digest(path))
    (folder / "manifest.json").write_text(text)
    with pytest.raises(ArtifactError, match="expected a graph that ONNX Runtime opens"):
        Engine(folder).open_cut(PACKED, JETS)
