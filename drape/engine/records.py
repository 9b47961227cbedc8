"""Records: what the engine reads of a garment, a body or a frame, as structs of C++.

This table is the one home of their layout. ``build.py`` writes ``source/records.hpp`` of it, which is no part of the
repository, and a library that was compiled from another table is refused at load by its ``HASH``. A field has a kind:

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

import hashlib

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
        "colour_start": "int32s",
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
    # What a card alone reads; empty where a processor computes.
    "PanelLevels": dict.fromkeys(
        ("row_start", "row_panel", "row", "column_start", "column", "panel", "left", "to"), "int32s"
    ),
    "StiffnessFactor": {
        "place": "int32s",
        "column": "int32s",
        "size": "int32s",
        "start": "int32s",
        "member": "int32s",
        "entry": "int32s",
        "value": "numbers",
        "inverse": "numbers",
        "levels": "PanelLevels",
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
    "FineLevel": {"sheet": "Sheet", "near": "int32s", "weight": "numbers", "parent": "int32s", "tangles": "Tangles"},
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
        "fine": "numbers",
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
        "climb": "numbers",
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
    # ``drape.contact.projection.PushFeed``
    "PushFeed": {
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
    # One frame in one call: ``drape.network.frame``. ``Name[]`` is one of these or none; layers are one or more.
    "FrameParts": {
        "weights": "Weights[]",
        "kept": "KeptPoses[]",
        "patches": "PatchRows[]",
        "tiles": "Tiles[]",
        "swing": "SwingConstants[]",
        "cloth": "FoldConstants[]",
        "levels": "Levels[]",
        "laid": "LaidCloth[]",
        "effort": "FoldEffort[]",
        "novel_effort": "FoldEffort[]",
        "passes": "count",
        "share": "number",
        "read": "count",
    },
    "LayerCall": {
        "parts": "FrameParts[]",
        "lifts": "count",
        "swung_before": "SwingMemory[]",
        "swung": "SwingMemory[]",
        "folded_before": "FoldMemory[]",
        "folded": "FoldMemory[]",
        "vertices": "numbers",
    },
    "FrameCall": {
        "layers": "LayerCall[]",
        "body": "BodyFeed[]",
        "turns": "float64s",
        "colliders": "float64s",
        "shown": "numbers",
        "steps": "uint16s",
        "step_count": "number",
    },
    # Offline physics: ``drape.cloth.problem``, ``drape.exact.surroundings``, ``hessian`` and ``linear`` there.
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
ARRAYS = {
    "numbers": "T",
    "float32s": "float",
    "float64s": "double",
    "int32s": "int32_t",
    "uint32s": "uint32_t",
    "uint16s": "uint16_t",
    "bytes": "uint8_t",
}
HASH = int.from_bytes(hashlib.sha256(repr(RECORDS).encode()).digest()[:8], "little")


def header() -> str:
    """Returns the text of ``source/records.hpp``: the structs of all records in C++."""
    lines = [
        "// Written by drape/engine/build.py of the table in drape/engine/records.py: change that.",
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
    if kind in ARRAYS:
        return f"Array<{ARRAYS[kind]}>"
    if kind.endswith("[]"):
        return f"Array<{kind[:-2]}<T>>"
    return {"number": "double", "count": "int64_t"}.get(kind, f"{kind}<T>")


def size(name: str) -> int:
    """Returns the number of 64-bit words in the record ``name``."""
    kinds = RECORDS[name].values()
    return sum(size(kind) if kind in RECORDS else 1 if kind in ("number", "count") else 2 for kind in kinds)
