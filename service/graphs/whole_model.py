"""An ONNX model that needs nothing else: inputs as constants, and weights inside in place of in a file beside it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from service.graphs.onnx_bytes import (
    ENTRY_KEY,
    ENTRY_VALUE,
    GRAPH_INITIALIZER,
    GRAPH_INPUT,
    MODEL_GRAPH,
    TENSOR_DIMS,
    TENSOR_EXTERNAL,
    TENSOR_LOCATION,
    TENSOR_NAME,
    TENSOR_RAW,
    TENSOR_TYPE,
    VALUE_NAME,
    Field,
    fields_of,
    written,
    written_number,
)

# ONNX's numbers of element types.
TYPES = {"float32": 1, "uint8": 2, "int8": 3, "uint16": 4, "int16": 5, "int32": 6, "int64": 7, "float16": 10}


def whole_model(model: bytes, constants: Mapping[str, np.ndarray], weights: Mapping[str, bytes]) -> bytes:
    """``model`` with the inputs that ``constants`` name as initialisers, and those of its initialisers that lie in
    files, by name in ``weights``, inside. Constants that are no input are left out."""
    parts = []
    for field in fields_of(model):
        if field.number == MODEL_GRAPH:
            graph = b"".join(_part(part, constants, weights) for part in fields_of(field.content))
            parts.append(written(MODEL_GRAPH, graph))
        else:
            parts.append(field.raw)
    return b"".join(parts)


def _part(field: Field, constants: Mapping[str, np.ndarray], weights: Mapping[str, bytes]) -> bytes:
    """A field of the graph as it stays, or the initialiser in its place."""
    if field.number == GRAPH_INPUT and (name := field.named(VALUE_NAME)) in constants:
        return written(GRAPH_INITIALIZER, _tensor(name, constants[name]))
    if field.number == GRAPH_INITIALIZER:
        return written(GRAPH_INITIALIZER, _inside(field.content, weights))
    return field.raw


def _tensor(name: str, array: np.ndarray) -> bytes:
    """A TensorProto."""
    dims = b"".join(written_number(TENSOR_DIMS, length) for length in array.shape)
    kind = written_number(TENSOR_TYPE, TYPES[array.dtype.name])
    return (
        dims + kind + written(TENSOR_NAME, name.encode()) + written(TENSOR_RAW, np.ascontiguousarray(array).tobytes())
    )


def _inside(tensor: bytes, weights: Mapping[str, bytes]) -> bytes:
    """A TensorProto whose content lies in it, wherever that of ``tensor`` does."""
    fields = list(fields_of(tensor))
    entries = [field for field in fields if field.number == TENSOR_EXTERNAL]
    if not entries:
        return tensor
    said = {entry.named(ENTRY_KEY): entry.named(ENTRY_VALUE) for entry in entries}
    start = int(said["offset"])
    content = weights[said["location"]][start : start + int(said["length"])]
    kept = b"".join(field.raw for field in fields if field.number not in (TENSOR_EXTERNAL, TENSOR_LOCATION))
    return kept + written(TENSOR_RAW, content)
