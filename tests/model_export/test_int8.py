"""The packed graph in int8: the arithmetic of one layer, what it is calibrated on, and the graph in a model folder."""

from __future__ import annotations

import shutil
from pathlib import Path

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
from model_export.folder import add_int8
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
from service.graphs.engine import PACKED, ROUNDED, Engine
from service.graphs.packing import Packer, ScenePlan
from tests.fixtures.packed import exported, garment
from tests.fixtures.poses import random_motion
from training.data import BodySource

INPUTS, OUTPUTS = 24, 40


@pytest.fixture(scope="module")
def layer() -> Wide:
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(INPUTS, OUTPUTS)).astype(np.float32)
    return Wide(weight, rng.uniform(0.5, 2.0, size=INPUTS).astype(np.float32))


def gemm(layer: Wide, *, turned: bool) -> onnx.ModelProto:
    """x @ weight + bias as a graph."""
    bias = np.random.default_rng(1).normal(size=OUTPUTS).astype(np.float32)
    matrix = np.ascontiguousarray(layer.weight.T) if turned else layer.weight
    node = helper.make_node("Gemm", ["x", "matrix", "bias"], ["y"], transB=int(turned))
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])
        for name, size in (("x", INPUTS), ("y", OUTPUTS))
    ]
    tensors = [numpy_helper.from_array(matrix, "matrix"), numpy_helper.from_array(bias, "bias")]
    graph = helper.make_graph([node], "layer", values[:1], values[1:], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def answer(proto: onnx.ModelProto, x: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["y"], {"x": x})[0])


@pytest.mark.parametrize("turned", [False, True])
def test_a_layer_in_int8_is_its_formula_alone_and_in_a_batch(layer: Wide, turned: bool):
    proto = gemm(layer, turned=turned)
    x = (np.random.default_rng(2).uniform(-1.4, 1.4, size=(9, INPUTS)) * layer.most).astype(np.float32)
    exact = answer(proto, np.clip(x, -layer.most, layer.most))
    bias = exact[:1] - np.clip(x, -layer.most, layer.most)[:1] @ layer.weight
    round_matrices(proto, {"layer": layer})
    onnx.checker.check_model(proto)
    assert [node.op_type for node in proto.graph.node].count("MatMulInteger") == 1
    got = answer(proto, x)

    steps = np.clip(np.rint(STEPS * x / layer.most), -MIDDLE, STEPS)
    scaled = layer.weight * (layer.most / STEPS)[:, None]
    scale = np.abs(scaled).max(axis=0) / WEIGHT_STEPS
    assert_allclose(got, scale * (steps @ np.rint(scaled / scale)) + bias, rtol=0, atol=1e-4)
    assert 0.0 < np.abs(got - exact).max() < 0.02 * INPUTS
    for row in range(len(x)):
        assert_array_equal(answer(proto, x[row : row + 1])[0], got[row])


def test_a_graph_without_the_layer_is_refused(layer: Wide):
    other = Wide(layer.weight + 1.0, layer.most)
    with pytest.raises(ArtifactError, match="expected a Gemm with the weights of other"):
        round_matrices(gemm(layer, turned=False), {"layer": layer, "other": other})


def test_it_is_calibrated_on_what_the_layers_see():
    model, _, _ = exported()
    source = BodySource(load_body(), device=torch.device("cpu"))
    poses, _ = random_motion(3, seed=5)
    seen: list[torch.Tensor] = []
    handle = wide_layers(model)["correction_0"].register_forward_pre_hook(lambda _, x: seen.append(x[0].flatten(0, -2)))
    layers = calibrated(model, [garment("tank")], source, poses)
    handle.remove()
    assert set(layers) == {f"correction_{i}" for i in range(len(model.corrections))}
    assert_allclose(layers["correction_0"].most, MARGIN * torch.cat(seen).abs().amax(dim=0).numpy(), rtol=1e-6)
    assert all(len(one.most) == len(one.weight) for one in layers.values())


@pytest.mark.slow
def test_a_model_folder_gets_the_graph_and_processors_are_served_by_it(tmp_path: Path):
    model, folder, _ = exported()
    shutil.copytree(folder, tmp_path / "model")
    body = load_body()
    poses, _ = random_motion(4, seed=6)
    layers = calibrated(
        model, [garment("tank"), garment("shorts")], BodySource(body, device=torch.device("cpu")), poses
    )
    manifest = add_int8(tmp_path / "model", layers)
    assert manifest == load_manifest(tmp_path / "model")
    assert manifest.graphs[ROUNDED].inputs == manifest.graphs[PACKED].inputs

    packers = []
    for int8 in (False, True):
        engine = Engine(tmp_path / "model", int8=int8)
        assert engine.int8 == int8
        packers.append(Packer(engine, body))
        for kind in ("tank", "shorts"):
            packers[-1].add(kind, garment(kind))
    assert not Engine(folder).int8  # the graph is not there
    rows, items = pack_body(body).rows(poses), [("tank", 0), ("shorts", 3), ("tank", 2)]
    exact, rounded = (
        [result.arrays["vertices"] for result in packer.run(ScenePlan(), rows, items)] for packer in packers
    )
    for item, want, got in zip(items, exact, rounded, strict=True):
        assert 0.0 < np.linalg.norm(got - want, axis=-1).mean() < 5e-3
        assert_array_equal(packers[1].run(ScenePlan(), rows, [item])[0].arrays["vertices"], got)
