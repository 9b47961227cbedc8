# SPDX-License-Identifier: Apache-2.0 OR GPL-3.0-or-later
# pyright: reportMissingImports=false
"""A character of the scene: its file for the service, and the rotations of its bones in a frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from mathutils import Matrix

from .character_file import character_glb
from .service_calls import Refusal

BODY = "drape_body"  # the property of an armature that is the service's own body: its id there
# SMPL's joints in the order of poses, which are its bones.
JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
    "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
Y_UP = Matrix(((1, 0, 0), (0, 0, 1), (0, -1, 0)))  # the service's axes of Blender's: (x, y, z) is its (x, z, -y)
SCALE_TOLERANCE = 0.01
HEAVIEST = 4  # bones of a vertex that are kept


class SceneCharacter:
    """The character of ``armature``, an object of the scene. ``bones`` are the names of its bones, ``units`` the length
    in the scene of a unit of the armature, and ``body`` is its id if it is the service's body, else empty.

    Refuses (``Refusal``) an object that is not an armature, and one that is stretched or mirrored.
    """

    def __init__(self, armature: Any) -> None:
        if armature is None or armature.type != "ARMATURE" or not armature.users_scene:
            got = "none" if armature is None else f"{armature.name}, of type {armature.type.lower()}"
            raise Refusal("character", expected="an armature", got=got, cure="Choose one, or add our body.")
        world = armature.matrix_world.to_3x3()
        scale = [axis.length for axis in world.col]
        if world.determinant() <= 0.0 or max(scale) - min(scale) > SCALE_TOLERANCE * max(scale):
            got = ", ".join(f"{factor:.3g}" for factor in armature.matrix_world.to_scale())
            cure = "Apply the scale (Object > Apply > Scale) of the armature, its parents and its meshes."
            raise Refusal(f"scale of {armature.name}", expected="one and the same, above 0", got=got, cure=cure)
        self.armature, self.units, self.body = armature, sum(scale) / 3.0, armature.get(BODY, "")
        bones = armature.data.bones
        if missing := [name for name in JOINTS if self.body and name not in bones]:
            cure = "Undo what was done to its bones, or add our body anew."
            raise Refusal(armature.name, expected="the bones of our body", got=f"no {missing[0]}", cure=cure)
        self._upright = Y_UP if self.body else Y_UP @ upright(world)
        self._name(JOINTS if self.body else tuple(bone.name for bone in bones))

    def _name(self, names: tuple[str, ...]) -> None:
        """Makes ``names``, parents included, its bones; finds their parents, and the inverse of each rest rotation."""
        bones, row = self.armature.data.bones, {name: number for number, name in enumerate(names)}
        self.bones = names
        self._parents = [row[bones[name].parent.name] if bones[name].parent else -1 for name in names]
        self._undo = [(self._upright @ bones[name].matrix_local.to_3x3()).inverted() for name in names]

    def stands(self, depsgraph: Any, pelvis: str) -> tuple[list[Any], Any]:
        """Returns two things, both y up: for each of ``bones`` the quaternion (mathutils, wxyz) by which it has turned
        since its rest, relative to its parent; and the position in the scene of the head of the bone ``pelvis``."""
        armature = self.armature.evaluated_get(depsgraph)
        world, posed = armature.matrix_world, armature.pose.bones
        moved = zip((posed[name].matrix.to_3x3() for name in self.bones), self._undo, strict=True)
        turned = [(Y_UP @ world.to_3x3() @ matrix @ undo).to_quaternion() for matrix, undo in moved]
        pairs = zip(turned, self._parents, strict=True)
        local = [turned[above].conjugated() @ turn if above >= 0 else turn for turn, above in pairs]
        return local, Y_UP @ (world @ posed[pelvis].head)

    def file(self, context: Any) -> bytes:
        """Returns the bytes of a GLB of the character at rest, in units of the scene, with all visible meshes that its
        bones move. Leaves in ``bones`` only those that move a vertex, and their parents. Refuses (``Refusal``) a
        character without such a mesh."""
        data = self.armature.data
        before, data.pose_position = data.pose_position, "REST"
        try:
            depsgraph = context.evaluated_depsgraph_get()
            parts = [self._surface(mesh, depsgraph) for mesh in context.view_layer.objects if self._moves(mesh)]
        finally:
            data.pose_position = before
        if not parts:
            cure = "Show its mesh, with an armature modifier and vertex groups named as its bones."
            expected = "a visible mesh that its bones move"
            raise Refusal(self.armature.name, expected=expected, got="none", cure=cure)
        starts = np.cumsum([0, *(len(part[0]) for part in parts[:-1])])
        faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=True)])
        vertices, joints, weights = (np.concatenate([part[column] for part in parts]) for column in (0, 2, 3))
        moves = np.zeros(len(self.bones), bool)
        for bone in np.unique(joints[weights > 0.0]):
            while bone >= 0 and not moves[bone]:
                moves[bone], bone = True, self._parents[bone]
        self._name(tuple(name for name, keeps in zip(self.bones, moves, strict=True) if keeps))
        stand = self.units * np.array(self._upright).T
        places = np.array([data.bones[name].head_local for name in self.bones]) @ stand
        joints = np.where(weights > 0.0, (np.cumsum(moves) - 1)[joints], 0)
        return character_glb(self.bones, self._parents, places, (vertices @ stand, faces, joints, weights))

    def _moves(self, mesh: Any) -> bool:
        """Whether ``mesh`` is a mesh, is visible, and bones of the armature move it."""
        modified = any(step.type == "ARMATURE" and step.object == self.armature for step in mesh.modifiers)
        parented = mesh.parent == self.armature and mesh.parent_type in ("BONE", "ARMATURE")
        return mesh.type == "MESH" and mesh.visible_get() and (modified or parented)

    def _surface(self, mesh: Any, depsgraph: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (V, 3) of ``mesh`` at rest in the armature's axes and units, triangles (F, 3), the heaviest bones of
        each vertex (V, 4) and their weights (V, 4)."""
        evaluated = mesh.evaluated_get(depsgraph)
        surface = evaluated.to_mesh()
        surface.calc_loop_triangles()
        vertices, faces = np.empty(3 * len(surface.vertices), "f4"), np.empty(3 * len(surface.loop_triangles), "i4")
        surface.vertices.foreach_get("co", vertices)
        surface.loop_triangles.foreach_get("vertices", faces)
        row = {name: number for number, name in enumerate(self.bones)}
        shape = len(surface.vertices), HEAVIEST
        joints, weights = np.zeros(shape, int), np.zeros(shape)
        if mesh.parent_type == "BONE":
            joints[:, 0], weights[:, 0] = row[mesh.parent_bone], 1.0
        bone_of = {group.index: row[group.name] for group in mesh.vertex_groups if group.name in row}
        for number, vertex in enumerate(surface.vertices):
            pairs = [(entry.weight, bone_of[entry.group]) for entry in vertex.groups if entry.group in bone_of]
            for column, (weight, bone) in enumerate(sorted(pairs, reverse=True)[:HEAVIEST]):
                joints[number, column], weights[number, column] = bone, weight
        evaluated.to_mesh_clear()
        move = np.array(self.armature.matrix_world.inverted() @ evaluated.matrix_world)
        return vertices.reshape(-1, 3) @ move[:3, :3].T + move[:3, 3], faces.reshape(-1, 3), joints, weights


def upright(world: Any) -> Any:
    """Returns a rotation (3x3 Matrix) by right angles. It turns to z that axis of an object, or its opposite, which
    points most nearly along the world's z. ``world`` is the object's rotation and scale."""
    axis = max(range(3), key=lambda column: abs(world[2][column]))
    sign = 1 if world[2][axis] > 0 else -1
    turn = Matrix.Diagonal((0, 0, 0))
    turn[2][axis], turn[0][(axis + 1) % 3], turn[1][(axis + 2) % 3] = sign, 1, sign
    return turn
