"""A character's own file with the garments that it wears: as a GLB with tracks of a clip, or as a VRM with springs.

What the file had stays as it is: meshes, materials, humanoid, licence, clips. Garments, their joints, and capsules on
the legs are added to it.
"""

from __future__ import annotations

import copy
import json
import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drape.avatar.character import tree_of, triangles_of
from drape.avatar.file_skeleton import FileRig
from drape.avatar.joint_file import Jointed, add_clip, add_jointed
from drape.avatar.joint_springs import JointSprings, Limb
from drape.avatar.own_garments import Undressed
from drape.avatar.rig_file import Dressed, add_bare, add_dressed
from drape.avatar.rig_motion import RigClip, RigMotion
from drape.avatar.wearer import Wearer
from drape.errors import InputError
from drape.export.glb import flat_indices
from drape.export.glb_file import INDEX_BUFFER, VERTEX_BUFFER, GlbFile
from drape.files.gltf import GltfFile
from drape.files.gltf_compressed import DRACO
from drape.files.gltf_json import Primitive

SPRINGS = "VRMC_springBone"
PLAIN = {  # VRM 0 says this of a material that is glTF's own.
    "shader": "VRM_USE_GLTFSHADER", "renderQueue": 2000, "floatProperties": {}, "vectorProperties": {},
    "textureProperties": {}, "keywordMap": {}, "tagMap": {},
}  # fmt: skip


def worn_glb(
    payload: bytes, layers: Sequence[Jointed], draped: Sequence[np.ndarray], motion: RigMotion, scale: float
) -> GlbFile:
    """Returns the character's file ``payload`` with the garments ``layers`` in it, on joints of their own, and an
    animation of ``motion``.

    ``draped`` are the vertices [m] (F, V, 3) of each garment in the world. ``scale``: metres per unit of the file.
    Raises ``InputError`` for a file that is not one GLB with one buffer.
    """
    file, nodes = _opened(payload)
    add_clip(file, layers, draped, motion, nodes, scale)
    _complete(file)
    return file


def worn_vrm(payload: bytes, layers: Sequence[tuple[Jointed, JointSprings]]) -> GlbFile:
    """Returns the character's VRM ``payload`` with the garments ``layers`` in it, whose own joints are springs. Raises
    ``InputError`` for a GLB that is no VRM."""
    file, nodes = _opened(payload)
    extensions = file.json.get("extensions", {})
    if not {"VRM", "VRMC_vrm"} & extensions.keys():
        cure = "Write a .glb, or give the character as VRM."
        raise InputError("vrm", expected="a character in a VRM file", got="a plain GLB", cure=cure)
    for layer, springs in layers:
        own = add_jointed(file, replace(layer, distilled=springs.distilled), nodes)
        ends = []
        for number, node in enumerate(own):
            way = springs.tails[number] - springs.distilled.pivots[number]
            ends.append(
                file.add("nodes", {"name": f"{file.json['nodes'][node]['name']}_end", "translation": way.tolist()})
            )
            file.json["nodes"][node]["children"] = [ends[-1]]
        add = _add_springs_0 if "VRM" in extensions else _add_springs_1
        if own:
            add(file, springs, nodes, own, ends, layer.surface.name)
    _complete(file)
    return file


def worn_on_rig(
    payload: bytes, layers: Sequence[Dressed], clip: RigClip, wearer: Wearer, rig: FileRig, *, quantised: bool = True
) -> GlbFile:
    """Returns the character's file ``payload``, whose rig is ``rig``, with the garments ``layers`` in it and an
    animation of ``clip``. Each garment has a morph target for each frame, which is its drape. ``quantised`` is that of
    ``add_dressed``."""
    file, nodes = _opened(payload)
    add_dressed(file, nodes, layers, clip, wearer, rig, quantised=quantised)
    _complete(file)
    return file


def undressed_file(payload: bytes, wearer: Wearer, rig: FileRig, left: Undressed) -> bytes:
    """Returns the bytes of the character's file ``payload`` without the faces that ``left`` says are off, and with what
    is seen instead. ``rig`` is that of the file of ``wearer``.

    Meshes that lose faces keep their numbers, so that blend shapes and the like still find them.
    """
    file, nodes = _opened(payload)
    read, gone = GltfFile(payload), np.zeros(sum(primitive.triangles for primitive in rig.primitives), dtype=bool)
    gone[rig.triangle[left.off]] = True
    ends, own = np.cumsum([primitive.triangles for primitive in rig.primitives])[:-1], dict[int, dict[str, Any]]()
    for primitive, off in zip(rig.primitives, np.split(gone, ends), strict=True):
        if off.any():
            mesh = own[primitive.node] if primitive.node in own else _own_mesh(file, primitive.node)
            own[primitive.node] = mesh
            held = read.item("meshes", read.document.nodes[primitive.node].mesh).primitives[primitive.primitive]
            _without(file, read, held, mesh["primitives"][primitive.primitive], off)
    if left.added:
        add_bare(file, nodes, wearer, rig, left)
    _complete(file)
    return file.to_bytes()


def _own_mesh(file: GlbFile, node: int) -> dict[str, Any]:
    """The mesh of ``node`` in ``file``; a copy of one that other nodes have too."""
    nodes = file.json["nodes"]
    number = nodes[node]["mesh"]
    if sum(one.get("mesh") == number for one in nodes) > 1:
        number = nodes[node]["mesh"] = file.add("meshes", copy.deepcopy(file.json["meshes"][number]))
    return file.json["meshes"][number]


def _without(file: GlbFile, read: GltfFile, primitive: Primitive, held: dict[str, Any], off: np.ndarray) -> None:
    """Takes the triangles that are ``off`` (F,) out of a ``primitive``, which is ``held`` in ``file``; of one without
    others a triangle without area stays, for no primitive may be empty."""
    points, faces = triangles_of(read, primitive)
    if held.get("extensions", {}).pop(DRACO, None) is not None:  # Packed geometry has triangles of its own.
        for name, number in primitive.attributes.items():
            rows = read.array(number)
            rows = rows.astype(np.float32) if rows.dtype == np.float64 else rows
            held["attributes"][name] = file.array(rows, target=VERTEX_BUFFER, bounds=name == "POSITION")
    kept = np.zeros((1, 3), dtype=np.int64) if off.all() else faces[~off]
    held["indices"] = file.array(flat_indices(kept, len(points)), target=INDEX_BUFFER)


def _opened(payload: bytes) -> tuple[GlbFile, dict[int, int]]:
    """The file to go on with, and its nodes by their places in the skeleton."""
    order, _ = tree_of(GltfFile(payload))
    (length,) = struct.unpack_from("<I", payload, 12)
    document = json.loads(payload[20 : 20 + length]) if payload[:4] == b"glTF" else {"buffers": []}
    buffers = document.get("buffers", [])
    if len(buffers) != 1 or "uri" in buffers[0]:
        cure = "Export it as one GLB file."
        raise InputError(
            "character", expected="a GLB with one buffer of its own", got=f"{len(buffers)} buffers", cure=cure
        )
    file = GlbFile(document, payload[28 + length : 28 + length + buffers[0]["byteLength"]])
    return file, dict(enumerate(order))


def _complete(file: GlbFile) -> None:
    """Tells VRM 0 of the materials that were added."""
    vrm = file.json.get("extensions", {}).get("VRM")
    if vrm is not None:
        told = vrm.setdefault("materialProperties", [])
        told += [{"name": one["name"]} | PLAIN for one in file.json["materials"][len(told) :]]


def _add_springs_1(
    file: GlbFile, springs: JointSprings, nodes: dict[int, int], own: Sequence[int], ends: Sequence[int], name: str
) -> None:
    """The springs in VRMC_springBone 1.0."""
    file.uses(SPRINGS)
    told = file.json["extensions"].setdefault(SPRINGS, {"specVersion": "1.0"})
    colliders, groups, listed = (told.setdefault(key, []) for key in ("colliders", "colliderGroups", "springs"))
    groups.append(
        {"name": f"{name} legs", "colliders": list(range(len(colliders), len(colliders) + len(springs.limbs)))}
    )
    for limb in springs.limbs:
        capsule = {"offset": limb.start.tolist(), "tail": limb.end.tolist(), "radius": limb.radius}
        colliders.append({"node": nodes[limb.node], "shape": {"capsule": capsule}})
    for number in range(len(own)):
        one = _numbers(springs, number)
        joint = {"node": own[number], "stiffness": one["stiffness"], "gravityPower": one["gravity"]}
        joint |= {"gravityDir": [0.0, -1.0, 0.0], "dragForce": one["drag"], "hitRadius": one["radius"]}
        felt = {"colliderGroups": [len(groups) - 1]} if springs.felt[number].any() else {}
        said = {"name": file.json["nodes"][own[number]]["name"], "joints": [joint, {"node": ends[number]}]}
        listed.append(said | felt)


def _add_springs_0(
    file: GlbFile, springs: JointSprings, nodes: dict[int, int], own: Sequence[int], ends: Sequence[int], name: str
) -> None:
    """The springs in VRM 0's secondaryAnimation, whose colliders are spheres and whose z points the other way."""
    told = file.json["extensions"]["VRM"].setdefault("secondaryAnimation", {})
    groups, listed = told.setdefault("colliderGroups", []), told.setdefault("boneGroups", [])
    first = len(groups)
    groups += [{"node": nodes[limb.node], "colliders": _spheres(limb)} for limb in springs.limbs]
    for number in range(len(own)):
        spring = _numbers(springs, number)
        listed.append(
            {
                "comment": file.json["nodes"][own[number]]["name"], "stiffiness": spring["stiffness"],
                "gravityPower": spring["gravity"], "gravityDir": {"x": 0.0, "y": -1.0, "z": 0.0},
                "dragForce": spring["drag"], "center": -1, "hitRadius": spring["radius"], "bones": [own[number]],
                "colliderGroups": [first + limb for limb in np.flatnonzero(springs.felt[number]).tolist()],
            }
        )  # fmt: skip


def _numbers(springs: JointSprings, number: int) -> dict[str, float]:
    return {name: round(float(one[number]), 5) for name, one in vars(springs.numbers).items()}


def _spheres(limb: Limb) -> list[dict[str, Any]]:
    """Spheres along ``limb``, a radius apart at most."""
    count = 1 + math.ceil(float(np.linalg.norm(limb.end - limb.start)) / limb.radius)
    points = limb.start + np.linspace(0.0, 1.0, count)[:, None] * (limb.end - limb.start)
    return [{"offset": {"x": x, "y": y, "z": -z}, "radius": limb.radius} for x, y, z in points.tolist()]
