"""The packed graph in fewer bits: one layer's arithmetic, that it drapes alike, and its place in a model folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from onnx import TensorProto, helper, numpy_helper

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.graph.packing import pack_body
from model_export import folder as changing
from model_export.folder import add_half, add_int8
from model_export.precision import half as half_module
from model_export.precision.half import HALF, LEAST, halve_matrices
from model_export.precision.int8 import (
    MARGIN,
    MIDDLE,
    STEPS,
    WEIGHT_STEPS,
    Wide,
    calibrated,
    round_matrices,
    wide_layers,
)
from service.graphs.engine import PACKED, Engine
from service.graphs.graph_names import ROUNDED
from service.graphs.packing import Packer, ScenePlan
from tests.fixtures.packed import exported, garment
from tests.fixtures.poses import random_motion
from training.data import BodySource

INPUTS, OUTPUTS = 64, 80
RNG = np.random.default_rng(0)
LAYER = Wide(
    RNG.normal(size=(INPUTS, OUTPUTS)).astype(np.float32), RNG.uniform(0.5, 2.0, size=INPUTS).astype(np.float32)
)
BIAS, SMALL = RNG.normal(size=OUTPUTS).astype(np.float32), RNG.normal(size=(INPUTS, 2)).astype(np.float32)
ITEMS = [("tank", 0), ("shorts", 3), ("tank", 2)]


def gemms(*, turned: bool = False) -> onnx.ModelProto:
    """y = x @ weight + bias, its matrix maybe ``turned``, and z = x @ small."""
    weight = np.ascontiguousarray(LAYER.weight.T) if turned else LAYER.weight
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


@pytest.mark.parametrize("turned", [False, True])
def test_a_layer_in_int8_is_its_formula_alone_and_in_a_batch(turned: bool):
    proto = gemms(turned=turned)
    x = (np.random.default_rng(2).uniform(-1.4, 1.4, size=(9, INPUTS)) * LAYER.most).astype(np.float32)
    exact, _ = answers(proto, np.clip(x, -LAYER.most, LAYER.most))
    round_matrices(proto, {"layer": LAYER})
    assert [node.op_type for node in proto.graph.node].count("MatMulInteger") == 1
    got, _ = answers(proto, x)

    steps = np.clip(np.rint(STEPS * x / LAYER.most), -MIDDLE, STEPS)
    scaled = LAYER.weight * (LAYER.most / STEPS)[:, None]
    scale = np.abs(scaled).max(axis=0) / WEIGHT_STEPS
    assert_allclose(got, scale * (steps @ np.rint(scaled / scale)) + BIAS, rtol=0, atol=1e-4)
    assert 0.0 < np.abs(got - exact).max() < 0.02 * INPUTS
    for row in range(len(x)):
        assert_array_equal(answers(proto, x[row : row + 1])[0][0], got[row])


def test_graphs_without_the_layers_are_refused(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ArtifactError, match="expected a Gemm with the weights of other"):
        round_matrices(gemms(), {"layer": LAYER, "other": Wide(LAYER.weight + 1.0, LAYER.most)})
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm with 9000 weights or more"):
        halve_matrices(gemms(), least=9000)
    monkeypatch.setattr(half_module, "WHOLE", ("weight",))  # a matrix that needs its digits keeps them
    with pytest.raises(ArtifactError, match="packed graph: expected a Gemm"):
        halve_matrices(gemms())


def test_it_is_calibrated_on_what_the_layers_see():
    model, _, _ = exported()
    poses, _ = random_motion(3, seed=5)
    seen: list[torch.Tensor] = []
    handle = wide_layers(model)["correction_0"].register_forward_pre_hook(lambda _, x: seen.append(x[0].flatten(0, -2)))
    layers = calibrated(model, [garment("tank")], BodySource(load_body(), device=torch.device("cpu")), poses)
    handle.remove()
    assert set(layers) == {f"correction_{i}" for i in range(len(model.corrections))}
    assert_allclose(layers["correction_0"].most, MARGIN * torch.cat(seen).abs().amax(dim=0).numpy(), rtol=1e-6)
    assert all(len(one.most) == len(one.weight) for one in layers.values())


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
    assert all(0.0 < moved < 5e-4 for moved in moved_m(tmp_path / "model", {}, {"half": True}))


@pytest.mark.slow
def test_a_model_folder_gets_the_graph_in_int8_and_processors_are_served_by_it(tmp_path: Path):
    model, folder, _ = exported()
    shutil.copytree(folder, tmp_path / "model")
    poses, source = random_motion(4, seed=6)[0], BodySource(load_body(), device=torch.device("cpu"))
    manifest = add_int8(tmp_path / "model", calibrated(model, [garment("tank"), garment("shorts")], source, poses))
    assert manifest == load_manifest(tmp_path / "model")
    assert manifest.graphs[ROUNDED].inputs == manifest.graphs[PACKED].inputs
    assert [Engine(tmp_path / "model", int8=int8).int8 for int8 in (False, True)] == [False, True]
    assert not Engine(folder).int8  # the graph is not there
    assert all(0.0 < moved < 5e-3 for moved in moved_m(tmp_path / "model", {"int8": False}, {"int8": True}))
