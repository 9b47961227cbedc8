"""Records: what the engine reads of a garment, a body or a frame, as structs of C++.

This table is the one home of their layout. ``source/records.hpp`` is generated from it (``python -m
drape.engine.records``), and a library that was compiled from another table is refused at load by its ``HASH``. A field
has a kind:

| kind | in C++ | size |
|---|---|---|
| ``number`` | ``double`` | 8 bytes |
| ``count`` | ``int64_t`` | 8 bytes |
| ``numbers``, ``int32s``, ``bytes``, ... | ``Array<T>``, ``Array<int32_t>``, ...: begin and number | 16 bytes |
| the name of a record | that struct | its own |
| such a name with ``[]`` | ``Array`` of such structs, one after the other, or of one that is made already | 16 bytes |

Every size is a multiple of eight bytes on every processor, WebAssembly included, so that a record is a flat array of
64-bit words. T is float or double, that of the kernel which reads the record.
"""

from __future__ import annotations

import ctypes
import dataclasses
import hashlib
import struct
from array import array
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

HEADER = Path(__file__).parent / "source" / "records.hpp"

RECORDS: dict[str, dict[str, str]] = {
    "Constants": dict.fromkeys(
        ("warp", "cross", "weft", "shear", "gap", "slack", "per_edge", "degenerate", "least", "reach"), "number"
    ),
    "Creases": {"corner": "int32s", "stiffness": "numbers", "cosine": "numbers", "sine": "numbers"},
    "Sheet": {
        "constants": "Constants",
        "vertex": "int32s",
        "place": "int32s",
        "fan_start": "int32s",
        "fan_other": "int32s",
        "fan_slope": "numbers",
        "bend_start": "int32s",
        "bend_other": "int32s",
        "bend_value": "numbers",
        "own": "numbers",
        "creases": "Creases",
        "crease_start": "int32s",
        "crease_lane": "int32s",
        "crease_member": "int32s",
    },
    "SkinGraph": {"neighbour": "int32s", "reach_m2": "numbers", "rest": "numbers"},
    "SheetNeighbours": {
        "start": "int32s",
        "vertex": "int32s",
        "square": "float32s",
        "clusters": "int32s",
        "other_start": "int32s",
        "other": "int32s",
        "bound": "bytes",
    },
    "Tangles": dict.fromkeys(("corner", "across", "start", "beside"), "int32s"),
    "StiffnessFactor": {
        "place": "int32s",
        "column": "int32s",
        "size": "int32s",
        "start": "int32s",
        "member": "int32s",
        "entry": "int32s",
        "value": "numbers",
        "inverse": "numbers",
    },
    "FoldConstants": {
        "sheet": "Sheet",
        "factor": "StiffnessFactor",
        "graph": "SkinGraph",
        "neighbours": "SheetNeighbours",
        "index": "int32s",
        "friction": "number",
        "hem": "int32s",
        "tangles": "Tangles",
    },
    # ``drape.live.fold_constants.LaidCloth``: what garments over and below a cloth read of it.
    "LaidCloth": {"sheet": "Sheet", "graph": "SkinGraph", "index": "int32s"},
    "FineLevel": {
        "sheet": "Sheet",
        "near": "int32s",
        "weight": "numbers",
        "parent": "int32s",
        "tangles": "Tangles",
    },
    "Levels": {"coarse": "FoldConstants", "kept": "int32s", "fine": "FineLevel"},
    "Surroundings": {"skin": "numbers", "colliders": "float64s"},
    "FoldEffort": {"steps": "count", "settle": "count", "cloth_contact": "count", "clearance_m": "number"},
    # What a frame goes on from, and what it leaves in the same arrays' likes: ``drape.live.fold_step.FoldArrays``.
    "FoldMemory": {
        "network": "numbers",
        "residual": "numbers",
        "velocity": "numbers",
        "grip": "numbers",
        "own": "int32s",
        "other": "int32s",
        "added": "numbers",
        "turn": "count",
        "step_s": "number",
    },
    "SwingRows": {
        "moving": "count",
        "node": "int32s",
        "place": "int32s",
        "start": "int32s",
        "other": "int32s",
        "slope": "numbers",
    },
    "SwingMesh": {
        "vertex": "int32s",
        "mass_kg": "numbers",
        "area_m2": "numbers",
        "order": "int32s",
        "start": "int32s",
        "other": "int32s",
        "slope": "numbers",
        "weight_node": "int32s",
        "weight": "numbers",
        "pull_start": "int32s",
        "pull_node": "int32s",
        "pull": "numbers",
        "rows": "SwingRows",
    },
    "SwingConstants": {
        "mesh": "SwingMesh",
        "graph": "SkinGraph",
        "index": "int32s",
        "young_n_per_m": "number",
        "damping_per_s": "number",
        "held": "numbers",
    },
    # ``drape.live.swing_step.SwingMemory``, seen from the frame's own origin.
    "SwingMemory": {
        "network": "numbers",
        "swung": "numbers",
        "speed": "numbers",
        "touched": "int32s",
        "colliders": "float64s",
        "origin": "float64s",
        "time_s": "number",
        "still_since_s": "float64s",
    },
    "Layer": {"weight": "numbers", "bias": "numbers", "slope": "number", "tiles": "uint32s"},
    # ``drape.network.weights.Weights``; ``first`` and ``second`` have a layer for every correction.
    "Weights": {
        "mean": "numbers",
        "inverse_deviation": "numbers",
        "body": "Layer[]",
        "from_body": "Layer",
        "surroundings": "Layer",
        "trunk": "Layer[]",
        "heads": "Layer[]",
        "first": "Layer[]",
        "second": "Layer[]",
        "basis": "numbers",
        "basis_u": "numbers",
        "basis_v": "numbers",
        "logs": "numbers",
    },
    # ``drape.network.motion.MotionEncoder``
    "MotionEncoder": {
        "scale": "numbers",
        "joint": "Layer[]",
        "body": "Layer[]",
        "input": "Layer",
        "state": "Layer",
        "out": "Layer",
        "decay_s": "number",
        "offset": "number",
    },
    # ``drape.network.novelty.KeptPoses``
    "KeptPoses": {"parts": "Layer[]", "counts": "int32s", "entry": "int32s", "over": "numbers"},
    "PatchRows": {
        "first": "numbers",
        "weights": "numbers",
        "heaviest": "int32s",
        "rotation": "numbers",
        "centre": "numbers",
        "scale": "numbers",
        "slopes": "numbers",
        "columns": "numbers",
        "fit": "numbers",
        "rest": "numbers",
        "anchor": "uint32s",
        "member": "int32s",
        "tangent": "numbers",
        "unit": "numbers",
        "place": "numbers",
        "sample": "int32s",
        "bias": "numbers",
        "region": "numbers",
        "other": "bytes",
    },
    "BodyFeed": {
        "local": "numbers",
        "rest": "numbers",
        "betas": "numbers",
        "motion": "numbers",
        "skin_rows": "numbers",
        "skin_bones": "int32s",
        "skin_counts": "int32s",
    },
    "PosedBody": {
        "quaternion": "numbers",
        "rotation": "numbers",
        "translation": "numbers",
        "place": "numbers",
        "code": "numbers",
        "betas": "numbers",
        "skin": "numbers",
        "region": "numbers",
    },
    # ``drape.graph.blend.Tiles``: a garment's charts are 16 or 32 bits wide, the others are empty.
    "Tiles": {
        "scale": "numbers",
        "columns": "numbers",
        "patch": "int32s",
        "charts": "uint16s",
        "wide_charts": "int32s",
    },
    "PosedJets": {"jet": "numbers", "rotation": "numbers", "centre": "numbers"},
    # ``drape.graph.push.PushConstants``
    "PushConstants": {
        "patches": "count",
        "block_vertex": "int32s",
        "vertex_slot": "int32s",
        "own_cluster": "int32s",
        "own_bias": "numbers",
        "other": "bytes",
        "region_bias": "numbers",
        "patch_block": "int32s",
        "patch_fit": "numbers",
        "tile_basis": "numbers",
        "tile_patch": "int32s",
        "slot_charts": "int32s",
    },
    # One frame in one call: ``drape.network.frame``. ``Name[]`` is one of these or none.
    "FrameParts": {
        "weights": "Weights[]",
        "kept": "KeptPoses[]",
        "patches": "PatchRows[]",
        "tiles": "Tiles[]",
        "swing": "SwingConstants[]",
        "cloth": "FoldConstants[]",
        "levels": "Levels[]",
        "effort": "FoldEffort[]",
        "novel_effort": "FoldEffort[]",
        "passes": "count",
        "share": "number",
        "step_count": "number",
    },
    "FrameCall": {
        "parts": "FrameParts[]",
        "body": "BodyFeed[]",
        "lifts": "count",
        "turns": "float64s",
        "colliders": "float64s",
        "swung_before": "SwingMemory[]",
        "swung": "SwingMemory[]",
        "folded_before": "FoldMemory[]",
        "folded": "FoldMemory[]",
        "vertices": "numbers",
        "steps": "uint16s",
    },
    # Offline physics: ``drape.kernels.problem``, ``drape.exact.surroundings``, ``hessian`` and ``linear`` there.
    "Triangles": {
        "corner": "int32s",
        "inverse": "numbers",
        "area": "numbers",
        "start": "int32s",
        "other": "int32s",
        "slope": "numbers",
    },
    "Hinges": {
        "corner": "int32s",
        "stiffness": "numbers",
        "cosine": "numbers",
        "sine": "numbers",
        "start": "int32s",
        "member": "int32s",
    },
    "Problem": {
        "constants": "Constants",
        "triangles": "Triangles",
        "hinges": "Hinges",
        "weight_n": "numbers",
        "contact_n_per_m": "numbers",
    },
    "Around": {
        "point": "numbers",
        "normal": "numbers",
        "target": "numbers",
        "target_n_per_m": "numbers",
        "band": "numbers",
        "band_n_per_m": "numbers",
    },
    "Pattern": dict.fromkeys(("start", "column", "diagonal", "face", "hinge"), "int32s"),
    "Charts": {"patch": "int32s", "weight": "numbers"},
    "System": {
        "pattern": "Pattern",
        "blocks": "numbers",
        "inverse": "numbers",
        "charts": "Charts",
        "coarse": "numbers",
    },
}
_ARRAYS = {
    "numbers": "T",
    "float32s": "float",
    "float64s": "double",
    "int32s": "int32_t",
    "uint32s": "uint32_t",
    "uint16s": "uint16_t",
    "bytes": "uint8_t",
}
_TYPES = {
    "float32s": np.dtype(np.float32),
    "float64s": np.dtype(np.float64),
    "int32s": np.dtype(np.int32),
    "uint32s": np.dtype(np.uint32),
    "uint16s": np.dtype(np.uint16),
    "bytes": np.dtype(np.uint8),
}
_WORD, _WORDS = struct.Struct("<Q"), {"number": struct.Struct("<d"), "count": struct.Struct("<q")}
HASH = int.from_bytes(hashlib.sha256(repr(RECORDS).encode()).digest()[:8], "little")


def header() -> str:
    """The text of ``source/records.hpp``."""
    lines = [
        "// Generated from drape/engine/records.py by `python -m drape.engine.records`: change the table there.",
        "#pragma once",
        '#include "arrays.hpp"',
        "",
        f"constexpr uint64_t RECORDS_HASH = 0x{HASH:016x}u;",
    ]
    for name, fields in RECORDS.items():
        lines += ["", f"template <class T> struct {name} {{"]
        lines += [f"  {_declared(kind)} {field};" for field, kind in fields.items()]
        lines += ["};", f'static_assert(sizeof({name}<float>) == {8 * size(name)}, "{name}");']
    return "\n".join(lines) + "\n"


def _declared(kind: str) -> str:
    if kind in _ARRAYS:
        return f"Array<{_ARRAYS[kind]}>"
    if kind.endswith("[]"):
        return f"Array<{kind[:-2]}<T>>"
    return {"number": "double", "count": "int64_t"}.get(kind, f"{kind}<T>")


def size(name: str) -> int:
    """The 64-bit words of a record."""
    kinds = RECORDS[name].values()
    return sum(size(kind) if kind in RECORDS else 1 if kind in ("number", "count") else 2 for kind in kinds)


class Record:
    """The words of a record, and the ``arrays`` that they point to.

    ``address`` [bytes] is where the words are.
    """

    __slots__ = ("_words", "address", "arrays")

    def __init__(self, name: str, value: Any, dtype: Any = None) -> None:
        """The record ``name`` of ``value``, which has its fields as attributes. Numbers in arrays are of ``dtype``, or
        else of the first such array's.

        Raises ``TypeError`` where an array has another type or is not contiguous: that is our own mistake.
        """
        self.arrays: list[np.ndarray] = []
        dtype = np.dtype(dtype or _numbers_type(name, value) or np.float32)
        self._set(self._filled(name, value, dtype))

    @classmethod
    def of_rows(cls, blocks: Sequence[np.ndarray], *numbers: float) -> Record:
        """The record whose fields are the rows of ``blocks``, one after the other, and then ``numbers``: addresses of
        arrays that were made in one piece are not asked for one by one. Types are not checked."""
        made, words = object.__new__(cls), []
        for block in blocks:
            first, size = address_of(block), block[0].size
            step = size * block.itemsize
            words += [word for i in range(len(block)) for word in ((first + i * step) if size else 0, size)]
        made.arrays = list(blocks)
        made._set(words + _number_words(numbers))
        return made

    def ending(self, *numbers: float) -> Record:
        """The same with other ``numbers`` in its last fields."""
        made = object.__new__(Record)
        made.arrays = self.arrays
        made._set([*self._words[: -len(numbers)], *_number_words(numbers)])
        return made

    def _set(self, words: list[int]) -> None:
        self._words = array("Q", words)
        self.address = self._words.buffer_info()[0]

    def _filled(self, name: str, value: Any, dtype: np.dtype) -> list[int]:
        words: list[int] = []
        for field, kind in RECORDS[name].items():
            own = getattr(value, field)
            if kind in _ARRAYS:
                wanted = _TYPES.get(kind, dtype)
                if own.dtype != wanted or not own.flags.c_contiguous:
                    raise TypeError(f"{name}.{field}: expected contiguous {wanted}, got {own.dtype}, {own.strides}")
                self.arrays.append(own)
                words += (address_of(own), own.size)
            elif kind in RECORDS:
                words += self._filled(kind, own, dtype)
            elif kind in _WORDS:
                words += _WORD.unpack(_WORDS[kind].pack(own))
            elif own is None or isinstance(own, Record | Recorded):
                made = own.record if isinstance(own, Recorded) else own  # whose maker keeps it
                words += (made.address, 1) if made else (0, 0)
            else:
                parts = np.array([word for one in own for word in self._filled(kind[:-2], one, dtype)], np.uint64)
                self.arrays.append(parts)
                words += (address_of(parts), len(own))
        return words


def _number_words(numbers: Sequence[float]) -> list[int]:
    """``numbers`` as words: whole ones as a ``count``, others as a ``number``."""
    kinds = ("count" if isinstance(one, int) else "number" for one in numbers)
    return [_WORD.unpack(_WORDS[kind].pack(one))[0] for kind, one in zip(kinds, numbers, strict=True)]


def address_of(numbers: np.ndarray) -> int:
    """Where contiguous ``numbers`` begin, 0 if there are none; by a buffer, which takes a third of the time that
    ``ctypes`` of the array does. Raises ``TypeError`` for an array that is not contiguous."""
    if numbers.size == 0:
        return 0
    if not numbers.flags.writeable and numbers.flags.c_contiguous:
        return numbers.ctypes.data
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers))  # pyright: ignore[reportArgumentType]


class Recorded:
    """Constants that the engine reads as the record of their class's name; such a class has its fields."""

    @cached_property
    def record(self) -> Record:
        """Themselves as the engine reads them."""
        return Record(type(self).__name__, self)

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle has of them: not what was made from them, which holds addresses."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]


def _numbers_type(name: str, value: Any) -> np.dtype | None:
    """The type of the first numbers in ``value``, which has the fields of the record ``name``."""
    for field, kind in RECORDS[name].items():
        own, inner = getattr(value, field), kind.removesuffix("[]")
        if kind == "numbers":
            return own.dtype
        for one in (own[:1] if kind.endswith("[]") else [own]) if inner in RECORDS else []:
            if found := _numbers_type(inner, one):
                return found
    return None


if __name__ == "__main__":
    HEADER.write_text(header())
