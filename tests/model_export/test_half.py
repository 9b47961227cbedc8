"""The packed graph in sixteen bits: one layer's arithmetic, that it drapes alike, and its place in a model folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from onnx import TensorProto, helper, numpy_helper

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.graph.packing import pack_body
from drape.inference.engine import PACKED, Engine
from drape.inference.packing import Packer, ScenePlan
from model_export import folder as changing
from model_export import half as half_module
from model_export.folder import add_half
from model_export.half import HALF, LEAST, halve_matrices
from tests.fixtures.packed import exported, garment
from tests.fixtures.poses import random_motion

INPUTS, OUTPUTS = 64, 80
RNG = np.random.default_rng(0)
WEIGHT = RNG.normal(size=(INPUTS, OUTPUTS)).astype(np.float32)
BIAS, SMALL = RNG.normal(size=OUTPUTS).astype(np.float32), RNG.normal(size=(INPUTS, 2)).astype(np.float32)
ITEMS = [("tank", 0), ("shorts", 3), ("tank", 2)]


def gemms(*, turned: bool = False) -> onnx.ModelProto:
    """y = x @ weight + bias, its matrix maybe ``turned``, and z = x @ small."""
    weight = np.ascontiguousarray(WEIGHT.T) if turned else WEIGHT
    tensors = {"weight": weight, "bias": BIAS, "small": SMALL}
    nodes = [
        helper.make_node("Gemm", ["x", "weight", "bias"], ["y"], transB=int(turned)),
        helper.make_node("Gemm", ["x", "small"], ["z"]),
    ]
    sizes = {"x": INPUTS, "y": OUTPUTS, "z": 2}
    x, y, z = (helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size]) for name, size in sizes.items())
    constants = [numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = helper.make_graph(nodes, "layers", [x], [y, z], constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def answers(proto: onnx.ModelProto, x: np.ndarray) -> list[np.ndarray]:
    onnx.checker.check_model(proto)
    session = onnxruntime.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    return [np.asarray(array) for array in session.run(["y", "z"], {"x": x})]


@pytest.mark.parametrize("turned", [False, True])
def test_large_matrices_are_multiplied_in_sixteen_bits_and_small_ones_are_not(turned: bool):
    proto, x = gemms(turned=turned), np.random.default_rng(1).normal(size=(9, INPUTS)).astype(np.float32)
    y, z = answers(proto, x)
    assert halve_matrices(proto) == 1
    assert proto.graph.initializer[0].data_type == TensorProto.FLOAT  # the file keeps no second copy
    rounded, same = answers(proto, x)
    assert 1e-6 < np.abs(rounded - y).max() < 0.1
    assert_allclose(rounded, y, rtol=0, atol=2e-3 * np.sqrt(INPUTS) * np.abs(x).max())
    assert_array_equal(same, z)


def test_graphs_without_the_layers_are_refused(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm with 9000 weights or more"):
        halve_matrices(gemms(), least=9000)
    monkeypatch.setattr(half_module, "WHOLE", ("weight",))  # a matrix that needs its digits keeps them
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm"):
        halve_matrices(gemms())


def packer(engine: Engine) -> Packer:
    made = Packer(engine, load_body())
    for kind in ("tank", "shorts"):
        made.add(kind, garment(kind))
    return made


def draped(made: Packer, items: list[tuple[str, int]]) -> list[np.ndarray]:
    rows = pack_body(load_body()).rows(random_motion(4, seed=6)[0])
    return [result.arrays["vertices"] for result in made.run(ScenePlan(), rows, items)]


def moved_m(folder: Path, chosen: dict[str, Any], other: dict[str, Any]) -> list[float]:
    """Mean distances [m] of items between the engines of two choices; an item has the same bits alone."""
    one, two = (packer(Engine(folder, **options)) for options in (chosen, other))
    found = draped(two, ITEMS)
    for item, together in zip(ITEMS, found, strict=True):
        assert_array_equal(draped(two, [item])[0], together)
    return [float(np.linalg.norm(a - b, axis=-1).mean()) for a, b in zip(draped(one, ITEMS), found, strict=True)]


@pytest.mark.slow
def test_a_model_folder_gets_the_graph_in_float16_and_its_weights_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
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
    assert [Engine(tmp_path / "model", half=half).half for half in (None, True)] == [False, True]
    assert all(0.0 < moved < 5e-4 for moved in moved_m(tmp_path / "model", {"compiled": False}, {"half": True}))
