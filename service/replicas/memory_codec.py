"""Memories of stages as bytes, and back: ``encode_value`` and ``decode_value``.

A tree of JSON, then the arrays that it names. A class is written by its name and read only if the reader knows it, so
bytes can ask for nothing but values. Bits, types and the order of axes in memory stay: kernels are compiled for these.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from drape.errors import InputError

_LENGTH = struct.Struct("<I")
_ALIGNED = 16


def encode_value(value: Any, classes: Sequence[type], constants: Sequence[object] = ()) -> bytes:
    """Returns the bytes that encode ``value``: numbers, texts, bytes, arrays, tuples and instances of ``classes``
    (dataclasses, named tuples).

    A part that equals one of the ``constants`` is written as its place among them. Raises ``TypeError`` for another
    type.
    """
    arrays = bytearray()
    names = {kind: _name(kind) for kind in classes}

    def put(raw: bytes) -> int:
        start = len(arrays)
        arrays.extend(raw + b"\0" * (-len(raw) % _ALIGNED))
        return start

    def tree(one: Any) -> Any:
        if isinstance(one, np.ndarray | np.generic):
            array = np.asarray(one)
            transposed = array.flags.f_contiguous and not array.flags.c_contiguous
            kept = array.T if transposed else array
            return {"array": [array.dtype.str, kept.shape, put(kept.tobytes()), transposed]}
        if one is None or isinstance(one, bool | int | float | str):
            return one
        if isinstance(one, bytes):
            return {"bytes": [put(one), len(one)]}
        if type(one) is tuple:
            return {"tuple": [tree(item) for item in one]}
        for place, constant in enumerate(constants):
            if type(one) is type(constant) and one == constant:
                return {"constant": place}
        if type(one) in names:
            parts = {name: tree(getattr(one, name)) for name in _fields(type(one))}
            return {"class": names[type(one)], "fields": parts}
        raise TypeError(f"{type(one).__name__} is not among what can be kept")

    head = json.dumps(tree(value)).encode()
    head += b" " * (-(len(head) + _LENGTH.size) % _ALIGNED)
    return _LENGTH.pack(len(head)) + head + bytes(arrays)


def decode_value(raw: bytes, classes: Sequence[type], constants: Sequence[object] = ()) -> Any:
    """The value that ``encode_value`` made ``raw`` of; refuses (``InputError``) what names something unknown."""
    known = {_name(kind): kind for kind in classes}
    start = _LENGTH.size + _LENGTH.unpack_from(raw)[0]

    def value(one: Any) -> Any:
        if not isinstance(one, Mapping):
            return one
        match one:
            case {"array": [dtype, shape, at, transposed]}:
                found = np.ndarray(shape, np.dtype(dtype), raw, start + at).copy()
                return found.T if transposed else found[()] if not shape else found
            case {"bytes": [at, size]}:
                return raw[start + at : start + at + size]
            case {"tuple": items}:
                return tuple(value(item) for item in items)
            case {"constant": place}:
                return constants[place]
            case {"class": name, "fields": parts} if name in known and set(parts) == set(_fields(known[name])):
                return known[name](**{key: value(part) for key, part in parts.items()})
        raise InputError(
            "state",
            expected="what this release remembers of a stream",
            got=str(one.get("class", "something else"))[:120],
            cure="Open the stream without it.",
        )

    return value(json.loads(raw[_LENGTH.size : start]))


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _fields(kind: type) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind)) if is_dataclass(kind) else kind._fields
