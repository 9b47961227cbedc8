"""The message with which a client drapes by itself: records of the engine, sent once for a garment in a fabric.

It begins as every message does, with the number of arrays as count. The number of bytes of a document follows (u32),
then the document, JSON filled up with spaces, and the arrays that it counts, one after the other, little endian: of
each the first bytes of all elements, then the second ones, and so on, which compresses to less. The document and each
array fill a multiple of 4 bytes. What the document says: ``drape.engine.flat_records`` and docs/reference/wire.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drape.errors import InputError
from drape.wire import messages as wire

_HEADER = wire.record((*wire.PREFIX, ("document_bytes", "u32", 1)))


def with_hung(
    document: Mapping[str, Any], arrays: Sequence[np.ndarray], hung: Sequence[np.ndarray]
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Returns what ``pack_folds`` takes for a cloth on which a drawn mesh hangs. ``hung`` are ``bound.Drawer.arrays``
    of the mesh: their sizes join ``document`` under "hung", and the arrays themselves, flat, follow ``arrays``."""
    flat = [np.ascontiguousarray(array).reshape(-1) for array in hung]
    return {**document, "hung": [array.size for array in flat]}, [*arrays, *flat]


def pack_folds(document: Mapping[str, Any], arrays: Sequence[np.ndarray]) -> bytes:
    """Returns the FOLDS message of a ``document`` for JSON and of the ``arrays`` whose sizes it has."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    header = _HEADER.pack(wire.MAGIC, wire.WIRE_VERSION, wire.FOLDS, 0, 0, len(arrays), len(text))
    return b"".join([header, text, *(_planes(array) + b"\0" * (-array.nbytes % 4) for array in arrays)])


def _planes(array: np.ndarray) -> bytes:
    return array.view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def unpack_folds(message: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the document in the FOLDS ``message``, and the bytes of all its arrays as they lie there.

    Refuses (``InputError``) a message that is too short, another magic, version or kind, and a document that is no
    JSON.
    """
    wire.check_prefix("folds message", message, wire.FOLDS, least=_HEADER.size)
    end = _HEADER.size + _HEADER.unpack_from(message)[-1]
    try:
        return json.loads(message[_HEADER.size : end]), message[end:]
    except ValueError as error:
        cure = "See docs/reference/wire.md for the layout."
        raise InputError("folds message", expected="a document", got=f"{len(message)} bytes", cure=cure) from error
