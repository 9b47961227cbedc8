"""The packed graph with matrices of 16 bits: what is cast, that it drapes alike, and its place in a model folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.testing import assert_allclose
from onnx import TensorProto, helper, numpy_helper

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.graph.packing import pack_body
from model_export import folder as changing
from model_export.folder import add_half
from model_export.precision import half as half_module
from model_export.precision.half import HALF, LEAST, halve_matrices
from service.graphs.engine import PACKED, Engine
from service.graphs.packing import Packer, ScenePlan
from tests.fixtures.packed import exported, garment
from tests.fixtures.poses import random_motion

INPUTS, OUTPUTS = 64, 80


def gemms(*, turned: bool) -> onnx.ModelProto:
    """y = x @ weight + bias and z = x @ small, which is too small."""
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(INPUTS, OUTPUTS)).astype(np.float32)
    tensors = [
        numpy_helper.from_array(np.ascontiguousarray(weight.T) if turned else weight, "weight"),
        numpy_helper.from_array(rng.normal(size=OUTPUTS).astype(np.float32), "bias"),
        numpy_helper.from_array(rng.normal(size=(INPUTS, 2)).astype(np.float32), "small"),
    ]
    nodes = [
        helper.make_node("Gemm", ["x", "weight", "bias"], ["y"], transB=int(turned)),
        helper.make_node("Gemm", ["x", "small"], ["z"]),
    ]
    values = {"x": INPUTS, "y": OUTPUTS, "z": 2}
    x, y, z = (helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size]) for name, size in values.items())
    graph = helper.make_graph(nodes, "layers", [x], [y, z], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def answers(proto: onnx.ModelProto, x: np.ndarray) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    return [np.asarray(array) for array in session.run(["y", "z"], {"x": x})]


@pytest.mark.parametrize("turned", [False, True])
def test_large_matrices_are_multiplied_in_sixteen_bits_and_small_ones_are_not(turned: bool):
    proto, x = gemms(turned=turned), np.random.default_rng(1).normal(size=(9, INPUTS)).astype(np.float32)
    y, z = answers(proto, x)
    assert halve_matrices(proto) == 1
    onnx.checker.check_model(proto)
    assert proto.graph.initializer[0].data_type == TensorProto.FLOAT  # the file keeps no second copy
    rounded, same = answers(proto, x)
    assert 1e-6 < np.abs(rounded - y).max() < 0.1
    assert_allclose(rounded, y, rtol=0, atol=2e-3 * np.sqrt(INPUTS) * np.abs(x).max())
    np.testing.assert_array_equal(same, z)


def test_a_graph_without_large_matrices_is_refused():
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm with 9000 weights or more"):
        halve_matrices(gemms(turned=False), least=9000)


def test_a_matrix_that_needs_its_digits_keeps_them(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(half_module, "WHOLE", ("weight",))
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm"):
        halve_matrices(gemms(turned=False))


@pytest.mark.slow
def test_a_model_folder_gets_the_graph_and_its_weights_only_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    model, folder, before = exported()
    shutil.copytree(folder, tmp_path / "model")
    with pytest.raises(ArtifactError, match=f"expected a Gemm with {LEAST} weights"):
        add_half(tmp_path / "model", model, garment("tank"))
    monkeypatch.setattr(changing, "LARGEST_ERROR_M", 1e-7)
    with pytest.raises(ArtifactError, match="packed graph in float16: expected at most 1e-07 m"):
        add_half(tmp_path / "model", model, garment("tank"), least=256)
    assert load_manifest(tmp_path / "model") == before
    monkeypatch.undo()

    manifest = add_half(tmp_path / "model", model, garment("tank"), least=256)
    assert manifest == load_manifest(tmp_path / "model")
    assert manifest.graphs[HALF].inputs == manifest.graphs[PACKED].inputs
    sizes = [(root / "weights.bin").stat().st_size for root in (folder, tmp_path / "model")]
    assert sizes[0] == sizes[1]

    body, found = load_body(), []
    rows = pack_body(body).rows(random_motion(3, seed=6)[0])
    for half in (None, True):
        engine = Engine(tmp_path / "model", half=half)
        assert engine.half is bool(half)
        packer = Packer(engine, body)
        packer.add("tank", garment("tank"))
        found.append(
            np.stack([r.arrays["vertices"] for r in packer.run(ScenePlan(), rows, [("tank", i) for i in range(3)])])
        )
    assert 0.0 < np.abs(found[1] - found[0]).max() < 5e-4
