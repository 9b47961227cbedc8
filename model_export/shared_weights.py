"""Large tensors of a model's graphs in one file beside them, each once: ONNX external data.

The drape graph and the packed graph compute one network, so most matrices of theirs are the same numbers. A tensor of
at least ``LEAST_BYTES`` goes to ``weights.bin``; tensors of equal content have one place there. The packed graph also
takes matrices that another graph holds transposed: a Gemm says with ``transB`` which way its matrix lies. No bit of a
result changes, because the runtime brings constant matrices into a layout of its own before the first frame. The
exporter notes call stacks on every node, with folders of its machine; they are left out.

Matrices that the packed graph holds with rows in another order are stored twice. A Gather of two constants would make
one of the other, but ONNX Runtime 1.31 does not fold it when it opens the graph, and results then differ in last bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from onnx.external_data_helper import set_external_data

from drape.artifacts import GraphSpec, ParameterSpec, WeightsSpec, file_digest

WEIGHTS_FILE = "weights.bin"
ALIGNMENT = 64  # bytes: a cache line, and the widest vector register
LEAST_BYTES = 1024
BORROWER = "packed"


@dataclass
class _Store:
    """The bytes of the file so far, and the offset of each content."""

    data: bytearray = field(default_factory=bytearray)
    places: dict[bytes, int] = field(default_factory=dict)

    def place(self, content: bytes) -> int:
        """The offset of ``content``, which is written now if it is new."""
        if content not in self.places:
            self.data.extend(bytes(-len(self.data) % ALIGNMENT))
            self.places[content] = len(self.data)
            self.data.extend(content)
        return self.places[content]


def share_weights(
    folder: Path, graphs: dict[str, GraphSpec], parameters: Mapping[str, np.ndarray] | None = None
) -> tuple[dict[str, GraphSpec], WeightsSpec | None]:
    """Moves the large tensors of ``graphs``, which are files in ``folder``, into one file ``weights.bin`` there.
    Returns the manifest's entries of the graphs and of that file; None where there is nothing to put into it.

    The float32 ``parameters`` of the network by name have their places in that file too, so that training can go on
    from it. ``folder`` may have a ``weights.bin`` already, which is then written anew.
    """
    store, protos = _Store(), {}
    for key in sorted(graphs, key=lambda key: (key == BORROWER, key)):  # whoever borrows comes last
        proto = onnx.load(str(folder / graphs[key].file))
        forget_origin(proto)
        if key == BORROWER:
            _borrow(proto.graph, store)
        for tensor in proto.graph.initializer:
            _move(tensor, store)
        protos[key] = proto
    for key, proto in protos.items():
        onnx.save(proto, str(folder / graphs[key].file))
    specs = {key: replace(spec, sha256=file_digest(folder / spec.file)) for key, spec in graphs.items()}
    places = {name: _find(value, store) for name, value in (parameters or {}).items()}
    path = folder / WEIGHTS_FILE
    path.unlink(missing_ok=True)
    if not store.data:
        return specs, None
    path.write_bytes(store.data)
    return specs, WeightsSpec(path.name, file_digest(path), places)


def _find(value: np.ndarray, store: _Store) -> ParameterSpec:
    """The place of ``value`` in the file, written at its end if neither ``value`` nor its transpose is there."""
    assert value.dtype == np.float32
    turned = np.ascontiguousarray(value.T).tobytes()
    if value.ndim == 2 and value.tobytes() not in store.places and turned in store.places:
        return ParameterSpec(store.places[turned], value.shape, turned=True)
    return ParameterSpec(store.place(value.tobytes()), value.shape)


def forget_origin(proto: onnx.ModelProto) -> None:
    """Drops the exporter's notes: the Python code behind the graph and its nodes, and shapes that a runtime infers."""
    proto.graph.ClearField("value_info")
    for part in (proto.graph, *proto.graph.node):
        part.ClearField("doc_string")
        part.ClearField("metadata_props")


def _move(tensor: onnx.TensorProto, store: _Store) -> None:
    """Puts the content of a large ``tensor`` into the file; the tensor keeps its place there."""
    content = _content(tensor)
    if len(content) < LEAST_BYTES:
        return
    moved = TensorProto(name=tensor.name, dims=tensor.dims, data_type=tensor.data_type, raw_data=b"")
    set_external_data(moved, WEIGHTS_FILE, offset=store.place(content), length=len(content))
    moved.ClearField("raw_data")
    tensor.CopyFrom(moved)


def _borrow(graph: onnx.GraphProto, store: _Store) -> None:
    """Transposes matrices of Gemms in ``graph`` whose transposes the file has."""
    for tensor in graph.initializer:
        users = [node for node in graph.node if tensor.name in node.input]
        of_gemms = all(node.op_type == "Gemm" and list(node.input).index(tensor.name) == 1 for node in users)
        if len(tensor.dims) != 2 or not of_gemms or _content(tensor) in store.places:
            continue
        turned = numpy_helper.from_array(np.ascontiguousarray(numpy_helper.to_array(tensor).T), tensor.name)
        if _content(turned) in store.places:
            tensor.CopyFrom(turned)
            for node in users:
                _turn(node)


def _turn(gemm: onnx.NodeProto) -> None:
    """Makes ``gemm`` take its matrix the other way round."""
    turned = next((attribute.i for attribute in gemm.attribute if attribute.name == "transB"), 0)
    kept = [attribute for attribute in gemm.attribute if attribute.name != "transB"]
    del gemm.attribute[:]
    gemm.attribute.extend([*kept, helper.make_attribute("transB", 1 - turned)])


def _content(tensor: onnx.TensorProto) -> bytes:
    return numpy_helper.to_array(tensor).tobytes()
