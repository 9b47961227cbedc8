"""Cuts from an ONNX model what some of its outputs need, so that a session computes nothing else.

ONNX Runtime runs every node of a graph whichever outputs are fetched (measured on 1.31: its run option
``only_execute_path_to_fetches`` changes nothing).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from drape.errors import ArtifactError, Unavailable

if TYPE_CHECKING:
    import onnx


def misexported(what: str, *, expected: str, got: str) -> ArtifactError:
    """Returns the refusal of a model whose export is not what this release reads: ``what`` should be ``expected`` and
    is ``got``."""
    return ArtifactError(what, expected=expected, got=got, cure="Export the model again.")


def cut(
    model: bytes,
    outputs: Sequence[str],
    *,
    direct: Collection[str] = (),
    instead: Mapping[str, str] | None = None,
    given: Collection[str] = (),
) -> bytes:
    """Returns the bytes of ``model``, an ONNX file, with only ``outputs``, in this order, and what they need.

    ``direct``: index inputs to leave out; what they pick rows from (on axis 0) is read whole, as if the index were
    0, 1, 2, ... ``instead`` maps the name of a value to that of the value which is read in its place; this must be
    computed before all that reads it. ``given``: outputs of the model that become inputs. Raises ``ArtifactError`` for
    an output or a value that the model lacks, bytes that are no ONNX model, and nodes with graphs of their own;
    ``Unavailable`` without the package onnx.
    """
    whole = _read(model)
    graph = whole.graph
    renamed = {node.output[0]: node.input[0] for node in graph.node if _picks(node, direct)}
    nodes = [node for node in graph.node if node.output[0] not in renamed and not {*node.output} & {*given}]
    instead = instead or {}
    if unknown := {*instead, *instead.values()} - {name for node in nodes for name in node.output}:
        raise misexported("model values", expected=", ".join(sorted(unknown)), got="none of these")
    renamed |= instead
    declared = {value.name: value for value in graph.output}
    if missing := [name for name in (*outputs, *sorted(given)) if name not in declared]:
        raise misexported("model outputs", expected=", ".join(missing), got=", ".join(declared))
    needed, kept = set(outputs), []
    for node in reversed(nodes):  # a graph's nodes are sorted: producers come first
        if needed.intersection(node.output):
            node.input[:] = [renamed.get(name, name) for name in node.input]
            kept.append(node)
            needed.update(node.input)
    parts = {
        "node": kept[::-1],
        "input": [*(declared[name] for name in sorted(needed.intersection(given))), *_named(graph.input, needed)],
        "initializer": _named(graph.initializer, needed),
        "output": [declared[name] for name in outputs],
        "value_info": [],  # shapes inside are inferred anew
    }
    smaller = type(graph)()
    smaller.CopyFrom(graph)
    for name, values in parts.items():
        smaller.ClearField(name)
        getattr(smaller, name).extend(values)
    graph.CopyFrom(smaller)
    return whole.SerializeToString()


def _read(model: bytes) -> onnx.ModelProto:
    try:
        import onnx
        from google.protobuf.message import DecodeError
    except ImportError as error:
        cure = "pip install onnx, which the extra gpu has."
        raise Unavailable("onnx", expected="the package onnx", got="none installed", cure=cure) from error
    whole = onnx.ModelProto()
    try:
        whole.ParseFromString(model)
    except DecodeError as error:
        raise misexported("model", expected="an ONNX model", got="bytes of another kind") from error
    if not whole.HasField("graph"):
        raise misexported("model", expected="an ONNX model", got="bytes of another kind")
    if any(attribute.HasField("g") or attribute.graphs for node in whole.graph.node for attribute in node.attribute):
        raise ArtifactError(
            "model nodes",
            expected="no graphs inside",
            got="an If, Loop or Scan",
            cure="Export the model without control flow.",
        )
    return whole


def _picks(node: onnx.NodeProto, direct: Collection[str]) -> bool:
    """Whether ``node`` picks rows by an index of ``direct``."""
    axis = next((attribute.i for attribute in node.attribute if attribute.name == "axis"), 0)
    return node.op_type == "Gather" and node.input[1] in direct and axis == 0


def _named(values: Sequence, names: Collection[str]) -> list:
    return [value for value in values if value.name in names]
