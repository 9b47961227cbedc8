"""Graphs that a GPU captures: no number read off a shape goes into a product of data, which would be a copy."""

from __future__ import annotations

import onnx
import pytest

from drape.artifacts import MODELS_DIR, load_manifest

FOLDER = MODELS_DIR / "onefit"
CAPTURED = ("packed", "packed_half", "push_out", "push_over")
# Operands that ONNX Runtime's kernels for CUDA read on the host: shapes, axes, bounds.
ON_HOST = {
    "Reshape": (1,), "Expand": (1,), "Range": (0, 1, 2), "Slice": (1, 2, 3, 4), "ConstantOfShape": (0,),
    "Unsqueeze": (1,), "Squeeze": (1,), "Tile": (1,), "Pad": (1,), "Split": (1,), "TopK": (1,), "ReduceSum": (1,),
    "CumSum": (1,),
}  # fmt: skip
ARITHMETIC = ("Squeeze", "Unsqueeze", "Mul", "Div", "Add", "Sub", "Concat", "Reshape", "Gather", "Slice", "Max", "Min",
              "Cast")  # fmt: skip


def copied(graph: onnx.GraphProto) -> list[str]:
    """Nodes of ``graph`` that take a number read off a shape as data."""
    constant = {tensor.name for tensor in graph.initializer} | {""}
    of_shapes: set[str] = set()
    found = []
    for node in graph.node:
        read = [name in of_shapes for name in node.input]
        if node.op_type == "Constant":
            constant.update(node.output)
        elif node.op_type == "Shape" or (
            node.op_type in ARITHMETIC and any(read) and of_shapes | constant >= set(node.input)
        ):
            of_shapes.update(node.output)
        else:
            hosted = ON_HOST.get(node.op_type, ())
            found += [node.name for place, shape in enumerate(read) if shape and place not in hosted]
    return found


@pytest.mark.parametrize("name", CAPTURED)
def test_sizes_are_data_in_what_a_gpu_captures(name: str):
    file = load_manifest(FOLDER).graphs[name].file
    assert copied(onnx.load(str(FOLDER / file), load_external_data=False).graph) == []


def test_a_product_with_a_size_is_found():
    node = onnx.helper.make_node
    nodes = [
        node("Shape", ["x"], ["shape"], name="shape"),
        node("Squeeze", ["shape"], ["count"], name="count"),
        node("Expand", ["x", "shape"], ["as_shape"], name="as_shape"),
        node("Mul", ["x", "count"], ["y"], name="product"),
    ]
    values = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.INT64, ["n"]) for name in ("x", "y")]
    assert copied(onnx.helper.make_graph(nodes, "products", values[:1], values[1:])) == ["product"]
