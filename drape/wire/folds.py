"""The message with which a client makes folds by itself: the constants of a garment in a fabric on a body, sent once.

It begins as every message does, with the number of arrays as count. For each array follow the number of its elements
and of its bytes (u32 each), and then the arrays in the order of ``ARRAYS``, little endian, each padded to a multiple of
4. What they mean is said where they are made (``drape.live.fold_arrays``) and in docs/reference/wire.md. The step that
reads them is ``clients/web/lib/folds``; ``scripts/sync_wire.py`` writes the numbers of the names there.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from drape.arrays import check_shape
from drape.errors import InputError
from drape.wire import messages as wire

# Of the array "numbers": those of the cloth (``drape.kernels.problem.KernelConstants``), and friction with the skin.
NUMBERS = ("warp", "cross", "weft", "shear", "gap", "slack", "per_edge", "degenerate", "least", "reach", "friction")
ARRAYS: dict[str, str] = {
    "numbers": "<f4",
    "vertex": "<i4", "place": "<i4",
    "fan_start": "<i4", "fan_other": "<i4", "fan_slope": "<f4",
    "bend_start": "<i4", "bend_other": "<i4", "bend_value": "<f4", "own": "<f4",
    "crease_corner": "<i4", "crease_stiffness": "<f4", "crease_cosine": "<f4", "crease_sine": "<f4",
    "crease_start": "<i4", "crease_lane": "<i4", "crease_member": "<i4",
    "factor_place": "<i4", "factor_column": "<i4", "factor_size": "<i4", "factor_start": "<i4", "factor_member": "<i4",
    "factor_entry": "<i4", "factor_value": "<f4", "factor_inverse": "<f4",
    "neighbour": "<i4", "reach_m2": "<f4", "rest": "<f4",
    "near_start": "<i4", "near_vertex": "<i4", "near_square": "<f4",
    "clusters": "<i4", "other_start": "<i4", "other": "<i4", "bound": "<u1",
    "index": "<i4", "hem": "<i4",
    "tangle_corner": "<i4", "tangle_across": "<i4", "tangle_start": "<i4", "tangle_beside": "<i4",
    "skin_bones": "<i4", "skin_rows": "<f4", "joints": "<f4", "parents": "<i4",
}  # fmt: skip
_HEADER = wire.record(wire.PREFIX)
_ENTRY = struct.Struct("<2I")


def pack_folds(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The FOLDS message of ``arrays``, which have the names of ``ARRAYS``."""
    flat = [np.ascontiguousarray(arrays[name], dtype=kind).reshape(-1) for name, kind in ARRAYS.items()]
    check_shape("numbers", flat[0], (len(NUMBERS),))
    parts = [_HEADER.pack(wire.MAGIC, wire.WIRE_VERSION, wire.FOLDS, 0, 0, len(flat))]
    parts += [_ENTRY.pack(len(one), one.nbytes) for one in flat]
    parts += [one.tobytes() + b"\0" * (-one.nbytes % 4) for one in flat]
    return b"".join(parts)


def unpack_folds(message: bytes) -> dict[str, np.ndarray]:
    """The flat arrays in ``message`` by name; refuses another size, version or kind."""
    wire.check_prefix("folds message", message, wire.FOLDS, least=_HEADER.size + _ENTRY.size * len(ARRAYS))
    *_, count = _HEADER.unpack_from(message)
    if count != len(ARRAYS):
        raise InputError(
            "folds message",
            expected=f"{len(ARRAYS)} arrays",
            got=str(count),
            cure="Use the client of the service's version.",
        )
    found, start = {}, _HEADER.size + _ENTRY.size * count
    sizes = [_ENTRY.unpack_from(message, _HEADER.size + _ENTRY.size * i) for i in range(count)]
    wire.check_length(
        "folds message", message, start + sum(size + -size % 4 for _, size in sizes), f"for {count} arrays"
    )
    for (name, kind), (number, size) in zip(ARRAYS.items(), sizes, strict=True):
        found[name] = np.frombuffer(message, kind, number, start)
        start += size + -size % 4
    return found
