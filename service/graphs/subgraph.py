"""Cuts from an ONNX model what some of its outputs need, so that a session computes nothing else.

ONNX Runtime runs every node of a graph whichever outputs are fetched (measured on 1.31: its run option
``only_execute_path_to_fetches`` changes nothing), and the package ``onnx`` is too much to serve with. An ONNX file is a
protobuf message: this module walks its wire format, copies the fields that stay byte by byte, and writes the few that
change. Field numbers are those of onnx.proto, which never renumbers them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from drape.errors import ArtifactError

MODEL_GRAPH = 7
GRAPH_NODE, GRAPH_INITIALIZER, GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE_INFO = 1, 5, 11, 12, 13
NODE_INPUT, NODE_OUTPUT, NODE_TYPE, NODE_ATTRIBUTE = 1, 2, 4, 5
ATTRIBUTE_NAME, ATTRIBUTE_INT, ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS = 1, 3, 6, 11
VALUE_NAME, TENSOR_NAME = 1, 8
VARINT, EIGHT_BYTES, BYTES, FOUR_BYTES = 0, 1, 2, 5  # wire types


def misexported(what: str, *, expected: str, got: str) -> ArtifactError:
    """The refusal of a model whose export is not what this release reads."""
    return ArtifactError(what, expected=expected, got=got, cure="Export the model again.")


@dataclass(frozen=True)
class _Field:
    """One field: its number, the whole of it, and what it holds (a number, or the span of its bytes)."""

    number: int
    raw: bytes
    value: int | bytes

    def text(self) -> str:
        assert isinstance(self.value, bytes)
        return self.value.decode()


@dataclass(frozen=True)
class _Node:
    """A node: names it reads and writes, its operator, and its fields."""

    fields: tuple[_Field, ...]
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
    """``model`` with only ``outputs`` (in this order) and what they need of its inputs, nodes and initialisers.

    ``direct`` names index inputs whose Gathers (on axis 0) are left out: what they pick from is used
    whole, as if the index were 0, 1, 2, ... ``instead``: values that are read in place of others, by the
    names of these; each must be computed before what reads it. ``given``: outputs of the model that become inputs, with
    what only makes them left out. Raises ``ArtifactError`` for an output or
    a value that the model does not have, bytes that are no ONNX model, and nodes that hold graphs of their own.
    """
    try:
        fields = list(_fields(model))
        place = next(i for i, field in enumerate(fields) if field.number == MODEL_GRAPH)
        graph = fields[place].value
        assert isinstance(graph, bytes)
        made = _cut_graph(list(_fields(graph)), outputs, set(direct), dict(instead or {}), set(given))
    except (IndexError, StopIteration, AssertionError, UnicodeDecodeError) as error:
        raise misexported("model", expected="an ONNX model", got="bytes of another kind") from error
    parts = [field.raw for field in fields]
    parts[place] = _written(MODEL_GRAPH, made)
    return b"".join(parts)


def _cut_graph(
    fields: list[_Field], outputs: Sequence[str], direct: set[str], instead: dict[str, str], given: set[str]
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
    declared = {_name(field, VALUE_NAME): field for field in fields if field.number == GRAPH_OUTPUT}
    missing = [name for name in (*outputs, *sorted(given)) if name not in declared]
    if missing:
        raise misexported("model outputs", expected=", ".join(missing), got=", ".join(declared))
    result = [_written(GRAPH_NODE, _rewritten(node, renamed)) for node in reversed(kept)]
    result += [_written(GRAPH_INPUT, _content(declared[name])) for name in sorted(given & needed)]
    for field in fields:
        if field.number in (GRAPH_INPUT, GRAPH_INITIALIZER):
            if _name(field, VALUE_NAME if field.number == GRAPH_INPUT else TENSOR_NAME) in needed:
                result.append(field.raw)
        elif field.number not in (GRAPH_NODE, GRAPH_OUTPUT, GRAPH_VALUE_INFO):  # shapes inside are inferred anew
            result.append(field.raw)
    return b"".join(result + [declared[name].raw for name in outputs])


def _node(field: _Field) -> _Node:
    assert isinstance(field.value, bytes)
    fields = tuple(_fields(field.value))
    for attribute in fields:
        if attribute.number == NODE_ATTRIBUTE:
            assert isinstance(attribute.value, bytes)
            if any(part.number in (ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS) for part in _fields(attribute.value)):
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
            parts = {part.number: part for part in _fields(field.value)}
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
        parts.append(field.raw if name is None else _written(NODE_INPUT, name.encode()))
    return b"".join(parts)


def _name(field: _Field, number: int) -> str:
    assert isinstance(field.value, bytes)
    return next((part.text() for part in _fields(field.value) if part.number == number), "")


def _content(field: _Field) -> bytes:
    assert isinstance(field.value, bytes)
    return field.value


def _fields(data: bytes) -> Iterator[_Field]:
    """The fields of a message, one after the other."""
    position = 0
    while position < len(data):
        start = position
        key, position = _varint(data, position)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, position = _varint(data, position)
            yield _Field(number, data[start:position], value)
            continue
        if kind == BYTES:
            size, position = _varint(data, position)
        else:
            assert kind in (EIGHT_BYTES, FOUR_BYTES)
            size = 8 if kind == EIGHT_BYTES else 4
        assert position + size <= len(data)
        yield _Field(number, data[start : position + size], data[position : position + size])
        position += size


def _varint(data: bytes, position: int) -> tuple[int, int]:
    """A base-128 number, low digits first, and the position after it."""
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7


def _written(number: int, content: bytes) -> bytes:
    """A field that holds ``content``."""
    return _number(number << 3 | BYTES) + _number(len(content)) + content


def _number(value: int) -> bytes:
    digits = bytearray()
    while value >= 0x80:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*digits, value])
