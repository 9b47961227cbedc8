"""Fields of protobuf messages, read and written: what is needed to change an ONNX file without the package ``onnx``.

Field numbers are those of onnx.proto, which never renumbers them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

VARINT, EIGHT_BYTES, BYTES, FOUR_BYTES = 0, 1, 2, 5  # wire types
MODEL_GRAPH = 7
GRAPH_NODE, GRAPH_INITIALIZER, GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE_INFO = 1, 5, 11, 12, 13
NODE_INPUT, NODE_OUTPUT, NODE_TYPE, NODE_ATTRIBUTE = 1, 2, 4, 5
ATTRIBUTE_NAME, ATTRIBUTE_INT, ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS = 1, 3, 6, 11
VALUE_NAME = 1
TENSOR_NAME = 8


@dataclass(frozen=True)
class MessageField:
    """One field: its number, the whole of it, and what it holds (a number, or the span of its bytes)."""

    number: int
    raw: bytes
    value: int | bytes

    @property
    def content(self) -> bytes:
        assert isinstance(self.value, bytes)
        return self.value

    def text(self) -> str:
        return self.content.decode()

    def named(self, number: int) -> str:
        """Returns the text of the field ``number`` of the message that this field holds; empty if that has none."""
        return next((part.text() for part in fields_of(self.content) if part.number == number), "")


def fields_of(data: bytes) -> Iterator[MessageField]:
    """The fields of a message, one after the other."""
    position = 0
    while position < len(data):
        start = position
        key, position = read_varint(data, position)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, position = read_varint(data, position)
            yield MessageField(number, data[start:position], value)
            continue
        if kind == BYTES:
            size, position = read_varint(data, position)
        else:
            assert kind in (EIGHT_BYTES, FOUR_BYTES)
            size = 8 if kind == EIGHT_BYTES else 4
        assert position + size <= len(data)
        yield MessageField(number, data[start : position + size], data[position : position + size])
        position += size


def read_varint(data: bytes, position: int) -> tuple[int, int]:
    """Returns the base-128 number, low digits first, at ``position`` of ``data``, and the position after it."""
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7


def written(number: int, content: bytes) -> bytes:
    """Returns the bytes of a field ``number`` that holds ``content``."""
    return varint(number << 3 | BYTES) + varint(len(content)) + content


def varint(value: int) -> bytes:
    """Returns ``value`` as a base-128 number, low digits first."""
    digits = bytearray()
    while value >= 0x80:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*digits, value])
