"""A model that needs nothing else computes what the model with inputs and a file of weights does."""

from __future__ import annotations

import numpy as np
import onnx
from numpy.testing import assert_array_equal
from onnx import TensorProto, numpy_helper
from onnx.external_data_helper import set_external_data

from service.graphs.subgraph import cut
from service.graphs.whole_model import TYPES, whole_model
from tests.service.graphs.test_subgraph import FEED, TABLE, model, run

OUTPUTS = ["turned", "other"]


def beside() -> tuple[bytes, dict[str, bytes]]:
    """The model of ``test_subgraph`` whose matrix lies in a file, after 8 bytes of another, and that file."""
    made = model()
    (matrix,) = (tensor for tensor in made.graph.initializer if tensor.name == "matrix")
    content = numpy_helper.to_array(matrix).tobytes()
    set_external_data(matrix, "weights.bin", offset=8, length=len(content))
    matrix.ClearField("raw_data")
    return made.SerializeToString(), {"weights.bin": b"\1" * 8 + content + b"\2" * 8}


def test_constants_and_weights_are_inside():
    data, weights = beside()
    constants = {"table": TABLE, "index": FEED["index"], "unknown": TABLE}
    whole = whole_model(cut(data, OUTPUTS), constants, weights)
    read = onnx.load_from_string(whole)
    onnx.checker.check_model(read, full_check=True)
    assert [value.name for value in read.graph.input] == ["second"]
    assert {tensor.name for tensor in read.graph.initializer} == {"table", "index", "matrix"}
    expected = run(cut(model().SerializeToString(), OUTPUTS), OUTPUTS, FEED)
    for got, array in zip(run(whole, OUTPUTS, FEED), expected, strict=True):
        assert_array_equal(got, array)


def test_types_are_those_of_onnx():
    for name, number in TYPES.items():
        assert TensorProto.DataType.Name(number) == {"float32": "FLOAT"}.get(name, name.upper())
        one = np.ones((2, 0, 3), name)
        made = onnx.load_from_string(whole_model(cut(model().SerializeToString(), ["other"]), {"second": one}, {}))
        assert_array_equal(numpy_helper.to_array(made.graph.initializer[0]), one)
