"""Encodes memories of stages as bytes and decodes them: ``encode_value`` and ``decode_value``.

The bytes are a tree of JSON, and then the arrays that it names. A class is written by its name and read only if the
reader knows it, so foreign bytes can make nothing but values. Bits, types and the order of axes in memory stay, because
kernels read them.
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
    """Returns bytes that encode ``value``: None, numbers, texts, bytes, arrays, tuples, and instances of ``classes``,
    which are dataclasses or named tuples.

    A part that equals one of the ``constants`` is written as its index among them. Raises ``TypeError`` for a part of
    another type.
    """
    arrays = bytearray()
    names = {kind: _name(kind) for kind in classes}

    def append(raw: bytes) -> int:
        start = len(arrays)
        arrays.extend(raw + b"\0" * (-len(raw) % _ALIGNED))
        return start

    def tree(part: Any) -> Any:
        if isinstance(part, np.ndarray | np.generic):
            array = np.asarray(part)
            transposed = array.flags.f_contiguous and not array.flags.c_contiguous
            rows = array.T if transposed else array
            return {"array": [array.dtype.str, rows.shape, append(rows.tobytes()), transposed]}
        if part is None or isinstance(part, bool | int | float | str):
            return part
        if isinstance(part, bytes):
            return {"bytes": [append(part), len(part)]}
        if type(part) is tuple:
            return {"tuple": [tree(item) for item in part]}
        for place, constant in enumerate(constants):
            if type(part) is type(constant) and part == constant:
                return {"constant": place}
        if type(part) in names:
            fields = {name: tree(getattr(part, name)) for name in _fields(type(part))}
            return {"class": names[type(part)], "fields": fields}
        raise TypeError(f"{type(part).__name__} cannot be encoded")

    head = json.dumps(tree(value)).encode()
    head += b" " * (-(len(head) + _LENGTH.size) % _ALIGNED)
    return _LENGTH.pack(len(head)) + head + bytes(arrays)


def decode_value(raw: bytes, classes: Sequence[type], constants: Sequence[object] = ()) -> Any:
    """Returns the value that ``encode_value`` encoded as ``raw`` with equal ``constants``. Refuses (``InputError``) a
    class that is not among ``classes``, or one with other fields."""
    known = {_name(kind): kind for kind in classes}
    start = _LENGTH.size + _LENGTH.unpack_from(raw)[0]

    def value(part: Any) -> Any:
        if not isinstance(part, Mapping):
            return part
        match part:
            case {"array": [dtype, shape, at, transposed]}:
                array = np.ndarray(shape, np.dtype(dtype), raw, start + at).copy()
                return array.T if transposed else array[()] if not shape else array
            case {"bytes": [at, size]}:
                return raw[start + at : start + at + size]
            case {"tuple": items}:
                return tuple(value(item) for item in items)
            case {"constant": place}:
                return constants[place]
            case {"class": name, "fields": parts} if name in known and set(parts) == set(_fields(known[name])):
                return known[name](**{key: value(field) for key, field in parts.items()})
        raise InputError(
            "state",
            expected="the memories of a stream of this release",
            got=str(part.get("class", "something else"))[:120],
            cure="Open the stream without it.",
        )

    return value(json.loads(raw[_LENGTH.size : start]))


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _fields(kind: type) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind)) if is_dataclass(kind) else kind._fields
