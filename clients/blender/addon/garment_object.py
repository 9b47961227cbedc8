# SPDX-License-Identifier: Apache-2.0 OR GPL-3.0-or-later
# pyright: reportMissingImports=false
"""Draped frames as an object of the scene: a mesh with shape keys, or with a point cache."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .service_calls import Refusal

WORN = "drape_worn"  # the property of a garment's object that names wearer and garment
FORMS = (
    ("KEYS", "Shape keys", "A key for each frame, inside the file; other formats export them"),
    ("PC2", "Point cache", "A .pc2 beside the file, for long clips"),
)
_PC2_HEAD = struct.Struct("<12siiffi")


def check_form(form: str) -> None:
    """Refuses (``Refusal``) the form "PC2" where the .blend file was never saved, since a point cache lies beside that
    file."""
    if form == "PC2" and not bpy.data.filepath:
        cure = "Save the file first, or bake to shape keys."
        raise Refusal("point cache", expected="a file beside which it lies", got="one that was never saved", cure=cure)


def baked(context: Any, about: dict[str, Any], frames: np.ndarray, *, first: int, form: str, wearer: str) -> Any:
    """Returns the scene's object of a garment that moves through ``frames`` (F, V, 3), in the scene's axes and units,
    from the frame ``first`` on. ``about`` is the garment's mesh as the service describes it (``MeshDocument``),
    ``form`` one of ``FORMS``.

    The object of an earlier bake for the same ``wearer`` is used again, with its materials and modifiers.
    """
    mesh, worn = _mesh(about, frames[0]), f"{wearer}/{about['id']}"
    garment = next((thing for thing in context.scene.objects if thing.get(WORN) == worn), None)
    if garment is None:
        materials = [bpy.data.materials.get(name) or bpy.data.materials.new(name) for name in about["materials"]]
        garment = bpy.data.objects.new(about["id"], mesh)
        garment[WORN] = worn
        context.scene.collection.objects.link(garment)
    else:
        before, garment.data = garment.data, mesh
        materials = list(before.materials)
        if not before.users:
            bpy.data.meshes.remove(before)
        if old := garment.modifiers.get("Drape"):
            garment.modifiers.remove(old)
    for material in materials:
        mesh.materials.append(material)
    (_add_keys if form == "KEYS" else _add_cache)(garment, frames, first)
    return garment


def _mesh(about: dict[str, Any], vertices: np.ndarray) -> Any:
    """A new mesh of a garment at ``vertices`` (V, 3), with its texture coordinates."""
    mesh = bpy.data.meshes.new(about["id"])
    mesh.from_pydata(vertices.tolist(), [], about["faces"])
    if about["uv"]:
        corners = np.array(about["uv"], "f4")[np.array(about["uv_faces"]).reshape(-1)]
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", corners.reshape(-1))
    mesh.polygons.foreach_set("material_index", about["face_material"])
    mesh.shade_smooth()
    return mesh


def _add_keys(garment: Any, frames: np.ndarray, first: int) -> None:
    """Adds a shape key for each frame but the first, which is the basis. A key rises and falls between the frames
    beside its own, so that between two frames the cloth is their mean."""
    edit, last = bpy.context.preferences.edit, first + len(frames) - 1
    before, edit.keyframe_new_interpolation_type = edit.keyframe_new_interpolation_type, "LINEAR"
    try:
        garment.shape_key_add(name="Basis", from_mix=False)
        for number, vertices in enumerate(frames[1:], first + 1):
            key = garment.shape_key_add(name=f"Frame {number}", from_mix=False)
            key.data.foreach_set("co", vertices.reshape(-1))
            for frame in range(number - 1, min(number + 1, last) + 1):
                key.value = float(frame == number)
                key.keyframe_insert("value", frame=frame)
    finally:
        edit.keyframe_new_interpolation_type = before


def _add_cache(garment: Any, frames: np.ndarray, first: int) -> None:
    """Writes a point cache beside the .blend file, and adds the modifier that shows it."""
    path = bpy.path.abspath(f"//{bpy.path.clean_name(garment.name)}.pc2")
    head = _PC2_HEAD.pack(b"POINTCACHE2\0", 1, frames.shape[1], 0.0, 1.0, len(frames))
    try:
        Path(path).write_bytes(head + np.asarray(frames, "<f4").tobytes())
    except OSError as error:
        cure = "Make room, or save the file elsewhere."
        raise Refusal(path, expected="a file that can be written", got=str(error.strerror), cure=cure) from error
    cache = garment.modifiers.new("Drape", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.frame_start = "PC2", bpy.path.relpath(path), first
