# SPDX-License-Identifier: Apache-2.0
"""A character as a GLB for the service: nodes, a skin, a surface.

Blender's exporter depends on the user's settings; this file has the bones that a bake turns and nothing else. Nodes
have no rotation at rest, so a node's rotation in a frame is the one by which its bone has turned since its rest.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence

import numpy as np

_NUMBERS = {"<f4": 5126, "<u2": 5123, "<u4": 5125}  # glTF's floats and unsigned integers


def character_glb(
    names: Sequence[str], parents: Sequence[int], places: np.ndarray, surface: Sequence[np.ndarray]
) -> bytes:
    """Returns the bytes of a GLB of N bones and a skinned surface, y up, in the unit of ``places``.

    ``names``: the bones' names. ``places`` (N, 3): their heads at rest. ``parents``: their parents' indices, -1 for
    none. ``surface``: vertices (V, 3), faces (F, 3), and for each vertex the indices (V, 4) of its bones and their
    weights (V, 4).
    """
    vertices, faces, joints, weights = surface
    nodes: list[dict] = [{"name": name} for name in names]
    for node, above in enumerate(parents):
        offset = places[node] - places[above] if above >= 0 else places[node]
        nodes[node]["translation"] = offset.tolist()
        if above >= 0:
            nodes[above].setdefault("children", []).append(node)
    roots = [node for node, above in enumerate(parents) if above < 0]
    nodes.append({"name": max(names, key=len) + " surface", "mesh": 0, "skin": 0})  # a name that no bone has
    binds = np.tile(np.eye(4), (len(names), 1, 1))
    binds[:, 3, :3] = -places  # column-major
    arrays = [
        ("<f4", "VEC3", vertices), ("<u2", "VEC4", joints), ("<f4", "VEC4", weights),
        ("<u4", "SCALAR", faces.reshape(-1)), ("<f4", "MAT4", binds.reshape(-1, 16)),
    ]  # fmt: skip
    views, accessors, payload = [], [], b""
    for number, (kind, shape, array) in enumerate(arrays):
        data = np.ascontiguousarray(array, kind)
        views.append({"buffer": 0, "byteOffset": len(payload), "byteLength": data.nbytes})
        accessors.append({"bufferView": number, "componentType": _NUMBERS[kind], "count": len(data), "type": shape})
        payload += data.tobytes()
    accessors[0] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [*roots, len(names)]}], "nodes": nodes,
        "skins": [{"joints": list(range(len(names))), "inverseBindMatrices": 4}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "buffers": [{"byteLength": len(payload)}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(payload), len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(payload), b"BIN\0") + payload
