"""Cuts from an ONNX model what some of its outputs need, so that a session computes nothing else.

ONNX Runtime runs every node of a graph whichever outputs are fetched (measured on 1.31: its run option
``only_execute_path_to_fetches`` changes nothing), and the package ``onnx`` is too much to serve with. An ONNX file is a
protobuf message: this module walks its wire format, copies the fields that stay byte by byte, and writes the few that
change (``drape.inference.onnx_bytes``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from drape.errors import ArtifactError
from drape.inference.onnx_bytes import (
    ATTRIBUTE_GRAPH,
    ATTRIBUTE_GRAPHS,
    ATTRIBUTE_INT,
    ATTRIBUTE_NAME,
    GRAPH_INITIALIZER,
    GRAPH_INPUT,
    GRAPH_NODE,
    GRAPH_OUTPUT,
    GRAPH_VALUE_INFO,
    MODEL_GRAPH,
    NODE_ATTRIBUTE,
    NODE_INPUT,
    NODE_OUTPUT,
    NODE_TYPE,
    TENSOR_NAME,
    VALUE_NAME,
    MessageField,
    fields_of,
    written,
)


def misexported(what: str, *, expected: str, got: str) -> ArtifactError:
    """Returns the refusal of a model whose export is not what this release reads: ``what`` should be ``expected`` and
    is ``got``."""
    return ArtifactError(what, expected=expected, got=got, cure="Export the model again.")


@dataclass(frozen=True)
class _Node:
    """A node: names it reads and writes, its operator, and its fields."""

    fields: tuple[MessageField, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    operator: str


def cut(
    model: bytes,
    outputs: Sequence[str],
    *,
    direct: Collection[str] = (),
    instead: Mapping[str, str] | None = None,
    given: Collection[str] = (),
) -> bytes:
    """Returns ``model`` with only ``outputs`` (in this order) and what they need of its inputs, nodes and initialisers.

    ``direct`` names index inputs whose Gathers (on axis 0) are left out: what they pick from is used whole, as if the
    index were 0, 1, 2, ... ``instead``: values that are read in place of others, by the names of these; each must be
    computed before what reads it. ``given``: outputs of the model that become inputs, with what only makes them left
    out. Raises ``ArtifactError`` for an output or a value that the model does not have, bytes that are no ONNX model,
    and nodes that hold graphs of their own.
    """
    try:
        fields = list(fields_of(model))
        place = next(i for i, field in enumerate(fields) if field.number == MODEL_GRAPH)
        graph = fields[place].value
        assert isinstance(graph, bytes)
        part = _cut_graph(list(fields_of(graph)), outputs, set(direct), dict(instead or {}), set(given))
    except (IndexError, StopIteration, AssertionError, UnicodeDecodeError) as error:
        raise misexported("model", expected="an ONNX model", got="bytes of another kind") from error
    parts = [field.raw for field in fields]
    parts[place] = written(MODEL_GRAPH, part)
    return b"".join(parts)


def _cut_graph(
    fields: list[MessageField], outputs: Sequence[str], direct: set[str], instead: dict[str, str], given: set[str]
) -> bytes:
    nodes = [_node(field) for field in fields if field.number == GRAPH_NODE]
    renamed = {
        node.outputs[0]: node.inputs[0]
        for node in nodes
        if node.operator == "Gather" and node.inputs[1] in direct and _axis(node) == 0
    }
    nodes = [node for node in nodes if node.outputs[0] not in renamed and given.isdisjoint(node.outputs)]
    computed = {name for node in nodes for name in node.outputs}
    unknown = (instead.keys() | set(instead.values())) - computed
    if unknown:
        raise misexported("model values", expected=", ".join(sorted(unknown)), got="none of these")
    renamed |= instead
    needed, kept = set(outputs), []
    for node in reversed(nodes):  # a graph's nodes are sorted: producers come first
        if needed.intersection(node.outputs):
            kept.append(node)
            needed.update(renamed.get(name, name) for name in node.inputs)
    declared = {field.named(VALUE_NAME): field for field in fields if field.number == GRAPH_OUTPUT}
    missing = [name for name in (*outputs, *sorted(given)) if name not in declared]
    if missing:
        raise misexported("model outputs", expected=", ".join(missing), got=", ".join(declared))
    result = [written(GRAPH_NODE, _rewritten(node, renamed)) for node in reversed(kept)]
    result += [written(GRAPH_INPUT, declared[name].content) for name in sorted(given & needed)]
    for field in fields:
        if field.number in (GRAPH_INPUT, GRAPH_INITIALIZER):
            if field.named(VALUE_NAME if field.number == GRAPH_INPUT else TENSOR_NAME) in needed:
                result.append(field.raw)
        elif field.number not in (GRAPH_NODE, GRAPH_OUTPUT, GRAPH_VALUE_INFO):  # shapes inside are inferred anew
            result.append(field.raw)
    return b"".join(result + [declared[name].raw for name in outputs])


def _node(field: MessageField) -> _Node:
    assert isinstance(field.value, bytes)
    fields = tuple(fields_of(field.value))
    for attribute in fields:
        if attribute.number == NODE_ATTRIBUTE:
            assert isinstance(attribute.value, bytes)
            if any(part.number in (ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS) for part in fields_of(attribute.value)):
                raise ArtifactError(
                    "model nodes",
                    expected="no graphs inside",
                    got="an If, Loop or Scan",
                    cure="Export the model without control flow.",
                )
    return _Node(
        fields,
        tuple(part.text() for part in fields if part.number == NODE_INPUT),
        tuple(part.text() for part in fields if part.number == NODE_OUTPUT),
        next(part.text() for part in fields if part.number == NODE_TYPE),
    )


def _axis(node: _Node) -> int:
    """The attribute "axis", 0 where there is none."""
    for field in node.fields:
        if field.number == NODE_ATTRIBUTE:
            assert isinstance(field.value, bytes)
            parts = {part.number: part for part in fields_of(field.value)}
            if parts[ATTRIBUTE_NAME].text() == "axis" and ATTRIBUTE_INT in parts:
                value = parts[ATTRIBUTE_INT].value
                assert isinstance(value, int)
                return value
    return 0


def _rewritten(node: _Node, renamed: dict[str, str]) -> bytes:
    if not renamed.keys() & set(node.inputs):
        return b"".join(field.raw for field in node.fields)
    parts = []
    for field in node.fields:
        is_input = field.number == NODE_INPUT
        name = renamed.get(field.text()) if is_input else None
        parts.append(field.raw if name is None else written(NODE_INPUT, name.encode()))
    return b"".join(parts)
