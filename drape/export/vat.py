"""Vertex animation textures in OpenVAT's layout, which shaders of Unity, Unreal, Godot, Bevy and three.js play.

Three files: NAME.glb, one mesh in the first frame, whose second texture coordinates lead to a column of texels;
NAME_vat.exr in float32; NAME-remap_info.json. Vertex i of N has column i mod W and block i div W. A block is a row a
frame: in the upper half of the picture ways from the first frame, (way - Min) / (Max - Min), in the lower half normals,
(n + 1) / 2. Texels have z up and y to the back, as OpenVAT's have: (x, -z, y) of ours.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from drape.errors import InputError, Unavailable
from drape.export.glb import Corners, Shape, add_shape, split_seams, vertex_normals
from drape.export.glb_file import VERTEX_BUFFER, GlbFile
from drape.export.surface import MeshSurface, MovingGarment
from drape.files.looks import Looks, Material
from drape.geometry import meshes
from drape.wanted import go_on

SUFFIX, ENDING = ".exr", "_vat"
WIDTH = 8192  # Every engine takes textures of this width.
MOST_ROWS = 16384


def check_vat() -> None:
    """Raises ``Unavailable`` where the package OpenEXR is not installed."""
    _openexr()


def _openexr() -> Any:
    try:
        return import_module("OpenEXR")
    except ModuleNotFoundError as error:
        cure = "pip install 'patchdrape[vat]'."
        expected = "the package openexr, which writes the texture"
        raise Unavailable("vertex animation texture", expected=expected, got="none", cure=cure) from error


def vat_files(layers: Sequence[MovingGarment], fps: float, name: str) -> dict[str, bytes]:
    """Returns a vertex animation texture of ``layers`` as one mesh: the bytes of ``name``.glb, ``name``_vat.exr and
    ``name``-remap_info.json (this module says what they hold), by these names.

    Raises ``Unavailable`` without OpenEXR, and ``InputError`` for more frames than a texture has rows for.
    """
    check_vat()
    whole = merge_layers(layers, name)
    corners, frames = split_seams(whole.surface), whole.vertices
    most = MOST_ROWS // (2 * -(-len(corners.source) // WIDTH))
    if len(frames) > most:
        got, cure = f"{len(frames)} of {len(corners.source):,} vertices", "Cut the clip, or take fewer frames a second."
        raise InputError("vertex animation texture", expected=f"at most {most} frames", got=got, cure=cure)
    texels, reach, first_normals = _texels(whole, corners)
    remap = {
        "os-remap": {"Min": (-reach).tolist(), "Max": reach.tolist(), "Frames": len(frames)},
        "animations": {"clip": {"startFrame": 0, "endFrame": len(frames) - 1, "framerate": fps, "looping": False}},
        "about": {
            "unit": "metre",
            "mesh_up": "y",
            "texel_up": "z",
            "normals": "lower half",
            "vertices": len(corners.source),
        },
    }
    mesh = _mesh(whole, corners, first_normals, texels.shape[:2]).to_bytes()
    return {
        f"{name}.glb": mesh, f"{name}{ENDING}{SUFFIX}": _picture(texels),
        f"{name}-remap_info.json": json.dumps(remap, indent=1).encode(),
    }  # fmt: skip


def merge_layers(layers: Sequence[MovingGarment], name: str) -> MovingGarment:
    """Returns ``layers`` as one mesh called ``name``, with the materials of all."""
    surfaces = [layer.surface for layer in layers]
    starts = np.cumsum([0, *(surface.vertex_count for surface in surfaces)]).tolist()
    uv, uv_faces, parts = [np.zeros((1, 2))], list[np.ndarray](), list[np.ndarray]()
    names, materials, pictures = list[str](), list[Material | None](), list[bytes]()
    for layer, surface in zip(layers, surfaces, strict=True):
        has = surface.uv_faces.size > 0
        at = sum(map(len, uv))
        uv.append(surface.uv if has else np.zeros((0, 2)))
        uv_faces.append(surface.uv_faces + at if has else np.zeros((len(surface.faces), 3), np.int64))
        own = surface.material_names or (surface.name,)
        parts.append(len(names) + (surface.face_material if surface.material_names else np.zeros(len(surface.faces))))
        names += own
        for number in range(len(own)):
            look = surface.looks.material(number) or Material((*layer.colour[:3], 1.0))
            held = {slot: number + len(pictures) for slot, number in look.pictures.items()} if has else {}
            materials.append(replace(look, pictures=held))
        pictures += surface.looks.pictures
    faces = np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=False)])
    surface = MeshSurface(
        name, starts[-1], faces, np.concatenate(uv), np.concatenate(uv_faces), tuple(names),
        np.concatenate(parts).astype(np.int64), Looks(tuple(materials), tuple(pictures)),
    )  # fmt: skip
    return MovingGarment(surface, np.concatenate([layer.vertices for layer in layers], axis=1), layers[0].colour)


def _texels(whole: MovingGarment, corners: Corners) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The picture (H, W, 3), the greatest way (3,) along each of its axes, and the first frame's normals (V, 3)."""
    frames, faces, source = whole.vertices, whole.surface.faces, corners.source
    first, table = frames[0].astype(np.float64), meshes.face_table(faces, frames.shape[1])
    reach = np.full(3, 1e-3)
    for vertices in frames:
        reach = np.maximum(reach, np.abs(_turned(vertices - first)).max(axis=0))
    count, width = len(source), min(len(source), WIDTH)
    blocks = -(-count // width)
    texels = np.zeros((2, blocks, len(frames), width, 3), np.float32)
    normals = np.zeros((0, 3))
    for frame, vertices in enumerate(frames):
        go_on()
        turned = vertex_normals(vertices, faces, table=table)
        normals = normals if frame else turned
        for half, rows in enumerate((_turned(vertices - first) / (2.0 * reach) + 0.5, 0.5 * _turned(turned) + 0.5)):
            padded = np.zeros((blocks * width, 3))
            padded[:count] = rows[source]
            texels[half, :, frame] = padded.reshape(blocks, width, 3)
    return texels.reshape(-1, width, 3), reach, normals


def _turned(vectors: np.ndarray) -> np.ndarray:
    """``vectors`` (..., 3) of ours in the axes of texels."""
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def _mesh(whole: MovingGarment, corners: Corners, normals: np.ndarray, size: tuple[int, ...]) -> GlbFile:
    """The mesh in the first frame; the second texture coordinates are the middles of texels of a picture of ``size``
    (rows, columns), counted from its upper left."""
    file, (height, width), each = GlbFile(), size, np.arange(len(corners.source))
    at = np.stack([(each % width + 0.5) / width, (each // width * len(whole.vertices) + 0.5) / height], axis=1)
    rows = {"POSITION": whole.vertices[0], "NORMAL": normals}
    parts = {
        name: file.array(one[corners.source].astype(np.float32), target=VERTEX_BUFFER, bounds=name == "POSITION")
        for name, one in rows.items()
    }
    parts["TEXCOORD_1"] = file.array(at.astype(np.float32), target=VERTEX_BUFFER)
    add_shape(file, whole.surface, corners, Shape([parts]), 1, 1.0, (1.0, 1.0, 1.0, 1.0))
    return file


def _picture(texels: np.ndarray) -> bytes:
    exr, out = _openexr(), io.BytesIO()
    head = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(head, {"RGB": np.ascontiguousarray(texels)}).write(out)
    return out.getvalue()
