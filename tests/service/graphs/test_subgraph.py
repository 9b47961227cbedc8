"""Cutting a model: the same nodes as onnx's own extractor, the same numbers, and refusals."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnx.utils
import onnxruntime
import pytest
from numpy.testing import assert_array_equal
from onnx import TensorProto, helper, numpy_helper

from drape.errors import ArtifactError, Unavailable
from drape.inference.subgraph import cut

FLOAT, INT = TensorProto.FLOAT, TensorProto.INT32


def model() -> onnx.ModelProto:
    """rows = table[index]; double = 2 rows; big = rows @ matrix, turned = its transpose; other = -(second input)."""
    nodes = [
        helper.make_node("Gather", ["table", "index"], ["rows"], axis=0),
        helper.make_node("Mul", ["rows", "two"], ["double"]),
        helper.make_node("MatMul", ["rows", "matrix"], ["big"]),
        helper.make_node("Transpose", ["big"], ["turned"], perm=[1, 0]),
        helper.make_node("Gather", ["big", "index"], ["columns"], axis=1),
        helper.make_node("Neg", ["second"], ["other"]),
    ]
    shapes = {"table": ["n", 3], "index": ["m"], "second": ["k"]}
    inputs = [helper.make_tensor_value_info(n, INT if n == "index" else FLOAT, s) for n, s in shapes.items()]
    made = {"double": ["m", 3], "turned": [100, "m"], "columns": ["m", "m"], "other": ["k"]}
    outputs = [helper.make_tensor_value_info(n, FLOAT, s) for n, s in made.items()]
    constants = {"two": np.float32(2.0), "matrix": np.arange(300, dtype=np.float32).reshape(3, 100)}
    graph = helper.make_graph(
        nodes, "g", inputs, outputs, [numpy_helper.from_array(np.asarray(v), k) for k, v in constants.items()]
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


TWICE = model()
TWICE.graph.node.append(helper.make_node("Add", ["double", "double"], ["fourfold"]))
TWICE.graph.output.append(helper.make_tensor_value_info("fourfold", FLOAT, ["m", 3]))
TABLE = np.arange(12, dtype=np.float32).reshape(4, 3)
FEED = {"table": TABLE, "index": np.array([2, 0, 2], np.int32), "second": np.ones(2, np.float32)}


def run(data: bytes, outputs: list[str], feed: dict[str, np.ndarray]) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    return [np.asarray(value) for value in session.run(outputs, {t.name: feed[t.name] for t in session.get_inputs()})]


@pytest.mark.parametrize("outputs", [["double"], ["turned"], ["other", "double"], ["columns", "turned"]])
def test_it_keeps_what_onnx_keeps(outputs: list[str]):
    whole = model()
    made = onnx.load_from_string(cut(whole.SerializeToString(), outputs))
    onnx.checker.check_model(made)
    oracle = onnx.utils.Extractor(whole).extract_model([t.name for t in whole.graph.input], outputs)
    assert [n.SerializeToString() for n in made.graph.node] == [n.SerializeToString() for n in oracle.graph.node]
    assert {t.name for t in made.graph.initializer} == {t.name for t in oracle.graph.initializer}
    assert [t.name for t in made.graph.output] == outputs
    read = {name for node in made.graph.node for name in node.input}
    assert {t.name for t in made.graph.input} == read & set(FEED)
    assert made.opset_import[0].version == 20


def test_direct_uses_the_table_whole():
    data = cut(model().SerializeToString(), ["double", "turned"], direct=["index"])
    made = onnx.load_from_string(data)
    onnx.checker.check_model(made)
    assert [node.op_type for node in made.graph.node] == ["Mul", "MatMul", "Transpose"]
    assert [t.name for t in made.graph.input] == ["table"]
    everything = FEED | {"index": np.arange(len(TABLE), dtype=np.int32)}
    direct = run(data, ["double", "turned"], FEED)
    for got, want in zip(direct, run(model().SerializeToString(), ["double", "turned"], everything), strict=True):
        assert_array_equal(got, want)


def test_direct_leaves_gathers_on_other_axes():
    made = onnx.load_from_string(cut(model().SerializeToString(), ["columns"], direct=["index"]))
    assert [node.op_type for node in made.graph.node] == ["MatMul", "Gather"]
    assert {t.name for t in made.graph.input} == {"table", "index"}


def test_a_value_is_read_instead_of_another_and_what_only_made_that_is_gone():
    whole = model().SerializeToString()
    short = cut(whole, ["turned", "double"], instead={"big": "double"})
    made = onnx.load_from_string(short)
    assert [node.op_type for node in made.graph.node] == ["Gather", "Mul", "Transpose"]
    turned, double = run(short, ["turned", "double"], FEED)
    assert_array_equal(turned, double.T)
    assert_array_equal(double, run(whole, ["double"], FEED)[0])
    assert cut(whole, ["turned"], instead={}) == cut(whole, ["turned"])
    with pytest.raises(ArtifactError, match="model values: expected scaled"):
        cut(whole, ["turned"], instead={"big": "scaled"})
    with pytest.raises(ArtifactError, match="model values: expected table"):
        cut(whole, ["turned"], instead={"table": "double"})


def test_an_output_that_is_given_becomes_an_input():
    data = cut(TWICE.SerializeToString(), ["fourfold"], given=["double"])
    made = onnx.load_from_string(data)
    onnx.checker.check_model(made)
    assert [tensor.name for tensor in made.graph.input] == ["double"]
    assert [node.op_type for node in made.graph.node] == ["Add"]
    assert_array_equal(run(data, ["fourfold"], {"double": TABLE})[0], 2.0 * TABLE)
    with pytest.raises(ArtifactError, match="model outputs: expected rows"):
        cut(TWICE.SerializeToString(), ["fourfold"], given=["rows"])


def test_an_unknown_output_is_refused():
    with pytest.raises(ArtifactError, match="model outputs: expected triple, got double, turned"):
        cut(model().SerializeToString(), ["triple"])


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x3a\x7f", model().SerializeToString()[:60]])
def test_bytes_of_another_kind_are_refused(data: bytes):
    with pytest.raises(ArtifactError, match="an ONNX model"):
        cut(data, ["double"])


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(Unavailable, match="pip install onnx"):
        cut(b"", ["double"])


def test_control_flow_is_refused():
    inner = helper.make_graph(
        [helper.make_node("Identity", ["two"], ["y"])], "b", [], [helper.make_tensor_value_info("y", FLOAT, None)]
    )
    whole = model()
    whole.graph.node.append(helper.make_node("If", ["index"], ["chosen"], then_branch=inner, else_branch=inner))
    with pytest.raises(ArtifactError, match="no graphs inside"):
        cut(whole.SerializeToString(), ["double"])


def test_tensors_outside_the_model_stay_where_they_are(tmp_path: Path):
    onnx.save(model(), str(tmp_path / "m.onnx"), save_as_external_data=True, location="w.bin", size_threshold=1000)
    data = (tmp_path / "m.onnx").read_bytes()
    (outside,) = [t for t in onnx.load_from_string(data).graph.initializer if t.data_location == TensorProto.EXTERNAL]
    made = cut(data, ["columns"], direct=["index"])
    assert [t.SerializeToString() for t in onnx.load_from_string(made).graph.initializer] == [
        outside.SerializeToString()
    ]
    assert onnx.load_from_string(cut(data, ["double"])).graph.initializer[0].name == "two"
    options = onnxruntime.SessionOptions()
    content = (tmp_path / "w.bin").read_bytes()
    options.add_external_initializers_from_files_in_memory(["w.bin"], [content], [len(content)])
    session = onnxruntime.InferenceSession(cut(data, ["turned"]), options, providers=["CPUExecutionProvider"])
    got = np.asarray(session.run(None, {"table": TABLE, "index": FEED["index"]})[0])
    assert_array_equal(got, run(model().SerializeToString(), ["turned"], FEED)[0])


def test_onnxruntime_itself_would_run_everything(tmp_path: Path):
    """Why graphs are cut: should this fail, a newer runtime prunes by itself and its cutting can go."""
    values = {name: helper.make_tensor_value_info(name, FLOAT, [3]) for name in "xyz"}
    nodes = [helper.make_node("Neg", ["x"], ["y"]), helper.make_node("Sin", ["x"], ["z"])]
    graph = helper.make_graph(nodes, "two", [values["x"]], [values["y"], values["z"]])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    options = onnxruntime.SessionOptions()
    options.enable_profiling, options.profile_file_prefix = True, str(tmp_path / "profile")
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    run_options = onnxruntime.RunOptions()
    run_options.only_execute_path_to_fetches = True
    session.run(["y"], {"x": np.ones(3, np.float32)}, run_options)
    events = json.loads(Path(session.end_profiling()).read_text())
    assert [e for e in events if e.get("args", {}).get("op_name") == "Sin" and "_kernel" in e["name"]]
