"""A character's own surface over a clip of its rig, with its materials, for formats of files that know no skinning.

A vertex v of a skinned mesh is at sum_j w_j W_j B_j v, by the world transforms W of its joints and the inverse bind
matrices B of its skin. What hangs on a bone is at W v.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drape.avatar.character import Primitive, listed_primitives, skin_of, skin_weights, tree_of, triangles_of
from drape.avatar.face_colours import texture_of
from drape.avatar.rig_motion import RigMotion
from drape.export.surface import MeshSurface, MovingGarment
from drape.files.gltf import GltfFile
from drape.files.looks import Material
from drape.files.pictures import remake_pictures
from drape.garment.files.gltf_looks import gltf_looks
from drape.geometry.skinning import skin_points
from drape.wanted import go_on

PLAIN = (0.8, 0.8, 0.8, 1.0)


def moving_character(payload: bytes, motion: RigMotion, scale: float) -> list[MovingGarment]:
    """Returns each primitive of the character in the file ``payload`` as a mesh that moves, with its materials: float32
    vertices (F + 1, V, 3) [m] in the world, in the T-pose and then in the F frames of ``motion``.

    ``motion`` is on the skeleton of this file, or of the file that this one was made from. ``scale``: metres per unit
    of the file. A primitive is left out where each of its triangles has one vertex at all three corners.
    """
    file, garments = GltfFile(payload), list[MovingGarment]()
    place = {node: number for number, node in enumerate(tree_of(file)[0])}
    nodes = file.document.nodes
    drawn = [node for node in place if nodes[node].mesh is not None]
    for node, index, primitive in listed_primitives(file, drawn, set()):
        go_on()
        points, faces = triangles_of(file, primitive)
        if (faces == faces[:, :1]).all():  # A primitive that was taken out as a whole has such a triangle left.
            continue
        skin = nodes[node].skin
        if skin is None:
            moved = _along(motion.world[:, place[node]], points)
        else:
            joints, binds = skin_of(file, skin)
            moves = motion.world[:, [place[joint] for joint in joints]] @ binds
            weights: Any = skin_weights(file, primitive, len(points), len(joints))
            moved = np.stack([skin_points(points, weights, one[:, :3, :3], one[:, :3, 3]) for one in moves])
        surface = _surface(file, node, index, faces, len(points))
        if "COLOR_0" in primitive.attributes:
            surface = _tinted(surface, file.array(primitive.attributes["COLOR_0"]).mean(axis=0)[:3])
        garments.append(MovingGarment(surface, (scale * moved).astype(np.float32), PLAIN))
    return garments


def _along(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ places[:, :3, :3].swapaxes(-1, -2) + places[:, None, :3, 3]


def _surface(file: GltfFile, node: int, index: int, faces: np.ndarray, count: int) -> MeshSurface:
    """The primitive ``index`` of the mesh of ``node``, with its material."""
    held = file.document.nodes[node]
    uv, material = texture_of(file, Primitive(node, "", index, len(faces)))
    looks, _ = remake_pictures(gltf_looks(file, [material])[0])
    corners, uv_faces = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    name = f"{held.name or 'mesh'}_{index}"
    told = {} if material is None else file.item("materials", material, "primitives.material")
    called = told.get("name")
    return MeshSurface(
        name, count, faces, np.column_stack([corners[:, 0], 1.0 - corners[:, 1]]), uv_faces.reshape(-1, 3),
        (called if isinstance(called, str) and called else name,), np.zeros(len(faces), np.int64), looks,
    )  # fmt: skip


def _tinted(surface: MeshSurface, colour: np.ndarray) -> MeshSurface:
    """``surface`` in the mean ``colour`` (3,) of its vertices, since what it is for reads materials."""
    look = surface.looks.material(0) or Material()
    red, green, blue, alpha = look.base_colour
    mixed = np.clip(np.array([red, green, blue]) * colour, 0.0, 1.0).tolist()
    looks = replace(surface.looks, materials=(replace(look, base_colour=(*mixed, alpha)),))
    return replace(surface, looks=looks)
