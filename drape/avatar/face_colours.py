"""The colour of each triangle of a character's file, as its materials and their pictures paint it."""

from __future__ import annotations

import numpy as np

from drape.avatar.character import Primitive
from drape.errors import MeshError
from drape.files.gltf import GltfFile
from drape.files.looks import replace_pictures
from drape.files.pictures import remake_picture
from drape.garment.files.gltf_looks import gltf_looks
from drape.garment.portrait import CLOTH, Sitter, paint_of

SIDE_PX = 256  # Pictures are made so small, since only a mean is taken.
# Barycentric coordinates of the points whose colours are averaged.
SHARES = np.array([[1 / 3, 1 / 3, 1 / 3], [0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]])


def face_colours(file: GltfFile, primitives: tuple[Primitive, ...]) -> np.ndarray:
    """Returns the mean colours (T, 3), sRGB in [0, 1], of the T triangles of ``primitives`` of ``file``, one primitive
    after the other. A triangle whose material has no look is light grey."""
    held = [texture_of(file, primitive) for primitive in primitives]
    used = sorted({material for _, material in held if material is not None})
    looks, _ = gltf_looks(file, list(used))
    looks = replace_pictures(looks, [_small(picture) for picture in looks.pictures])
    uv_faces = [uv for uv, _ in held]
    corners = np.concatenate(uv_faces).reshape(-1, 2)
    material = [used.index(one) if one is not None else len(used) for _, one in held]
    sitter = Sitter(
        np.zeros((0, 3)), np.zeros((0, 3), int), corners * [1.0, -1.0] + [0.0, 1.0],
        np.arange(len(corners)).reshape(-1, 3), np.repeat(material, [len(uv) for uv in uv_faces]), looks,
    )  # fmt: skip
    count = len(sitter.uv_faces)
    paint = paint_of(sitter)
    if paint is None:
        return np.tile(np.array(CLOTH), (count, 1))
    every = np.arange(count)
    return np.mean([paint(every, np.tile(share, (count, 1)))[0] for share in SHARES], axis=0)


def texture_of(file: GltfFile, primitive: Primitive) -> tuple[np.ndarray, int | None]:
    """Returns the texture coordinates (F, 3, 2) of the corners of a primitive's triangles, with the origin at the upper
    left, and the index of its material, None where it has none. The coordinates are zero where the file has none that
    fit."""
    mesh = file.item("meshes", file.document.nodes[primitive.node].mesh)
    part = mesh.primitives[primitive.primitive]
    count = primitive.triangles
    if "TEXCOORD_0" not in part.attributes:
        return np.zeros((count, 3, 2)), part.material
    uv = file.array(part.attributes["TEXCOORD_0"]).astype(np.float64)
    index = np.arange(3 * count) if part.indices is None else file.array(part.indices).reshape(-1)[: 3 * count]
    if uv.shape[1] != 2 or index.max(initial=0) >= len(uv):
        return np.zeros((count, 3, 2)), part.material
    return uv[index.astype(np.int64)].reshape(-1, 3, 2), part.material


def _small(picture: bytes) -> bytes | None:
    """``picture`` made small, None where it cannot be read."""
    try:
        return remake_picture(picture, label="picture", side=SIDE_PX)
    except MeshError:
        return None
