"""Bodies of the packed graph: bones, features and patch frames from quaternions and rest joints, in a few products.

``drape.geometry.rigid``, ``drape.body.features`` and ``drape.geometry.skinning`` take some three hundred calls for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.body.features import STATIC_PER_JOINT
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.graph.packed_inputs import Indices, PackedBodies, StoredPatches
from model_export.packed.operators import WithTables, rows

# Entries of q q^T (wxyz, row by row) in each entry of the rotation matrix less the identity, and in |q|^2.
_ROTATION = (
    ((10, -2), (15, -2)), ((6, 2), (3, -2)), ((7, 2), (2, 2)),
    ((6, 2), (3, 2)), ((5, -2), (15, -2)), ((11, 2), (1, -2)),
    ((7, 2), (2, -2)), ((11, 2), (1, 2)), ((5, -2), (10, -2)),
    ((0, 1), (5, 1), (10, 1), (15, 1)),
)  # fmt: skip
_SIXD = (0, 3, 6, 1, 4, 7)  # entries of the rotation matrix in the 6D descriptor: its first two columns
# (entry of q, sign) in the matrix L with L(a) b = a b, row by row.
_LEFT = (
    (0, 1), (1, -1), (2, -1), (3, -1),
    (1, 1), (0, 1), (3, -1), (2, 1),
    (2, 1), (3, 1), (0, 1), (1, -1),
    (3, 1), (2, -1), (1, 1), (0, 1),
)  # fmt: skip


@dataclass(frozen=True)
class PosedBones:
    """The bones of B posed bodies in the axes of the world, relative to the root joint: quaternions wxyz (B, 24, 4) and
    rotations (B, 24, 3, 3), translations [m] (B, 24, 3) that take rest places to posed ones, and joints [m] (B, 24, 3).
    """

    quaternion: Tensor
    rotation: Tensor
    translation: Tensor
    joints: Tensor


@dataclass(frozen=True)
class PatchFrames:
    """Posed frames of P patches: ``rotation`` (P, 3, 3), ``centre`` [m] (P, 3, 1), ``scale`` [m] (P, 1, 1).

    Frames turn and move into the axes of the world, relative to the root joint. ``out`` (P, 3, 4) takes a place
    [patch scales] and 1 to a place [m]; the transpose of ``into`` (P, 3, 3) takes a vector [m] to patch scales.
    """

    rotation: Tensor
    centre: Tensor
    scale: Tensor
    out: Tensor
    into: Tensor


class PatchKinematics(WithTables):
    """A module without weights that computes the bones and features of bodies, and the posed frames of patches."""

    def __init__(self) -> None:
        jumps = {f"jump_{i}": jump for i, jump in enumerate(ancestor_jumps())}
        super().__init__(_kinematic_tables() | jumps)
        self.jumps = list(jumps)

    def forward(self, bodies: PackedBodies) -> tuple[PosedBones, Tensor]:
        """Returns the bones of ``bodies``, and the inputs (B, 226) of the body encoder: of each joint the nine numbers
        of ``drape.body.features.static_features``, then the ten of the shape."""
        quaternion, rotation, joints = self._posed_joints(bodies.quaternion, bodies.rest)
        translation = joints - (rotation @ bodies.rest[..., None])[..., 0]
        features = self._features(bodies.quaternion, rotation, bodies.betas)
        return PosedBones(quaternion, rotation, translation, joints), features

    def frames(self, bodies: PackedBodies, bones: PosedBones, patches: StoredPatches, index: Indices) -> PatchFrames:
        """Returns the posed frames of P ``patches``; ``index`` says on which of the ``bodies`` each is."""
        blended = self._blended_rotation(bones.quaternion, patches.weights, index)
        rotation = blended @ patches.rotation
        # Rest centres moved by the shape, then by the blended bones.
        rest = patches.centre[:, :, None] + patches.shapedirs @ rows(bodies.betas, index.body)[:, :, None]
        moves = torch.cat([bones.rotation, bones.translation[..., None]], dim=-1).reshape(-1, JOINT_COUNT, 12)
        move = patches.weights[:, None, :] @ rows(moves, index.body)
        centre, scale = move.reshape(-1, 3, 4) @ rest, patches.scale[:, :, None]
        out = torch.cat([rotation * scale, centre], dim=-1)
        return PatchFrames(rotation, centre, scale, out, into=rotation / scale)

    def _posed_joints(self, local: Tensor, rest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """World quaternions (B, 24, 4), rotations (B, 24, 3, 3) and joints [m] (B, 24, 3) of bodies.

        ``rigid.bone_transforms`` by doubling: four rounds of products reach the root of a tree nine joints deep.
        Row 24 of ``local`` is the identity, the ancestor of those that have none left.
        """
        product = (local @ self.left_terms).reshape(-1, JOINT_COUNT + 1, 4, 4)
        for name in self.jumps:
            product = torch.index_select(product, 1, getattr(self, name)) @ product
        quaternion = product[:, :JOINT_COUNT, :, 0]
        rotation = self._matrices(quaternion.reshape(-1, 4)).reshape(-1, JOINT_COUNT, 3, 3)
        # A joint moves with its parent's rotation: the sum of all offsets between it and the root.
        offset = (self.offsets @ rest)[..., None]
        turned = (torch.index_select(rotation, 1, self.parents) @ offset).reshape(-1, JOINT_COUNT, 3)
        return quaternion, rotation, self.descent @ turned

    def _features(self, local: Tensor, rotation: Tensor, betas: Tensor) -> Tensor:
        """``drape.body.features.static_features`` and the shape (B, 226)."""
        # The identity in place of the root's rotation: the network sees of it only the direction of gravity.
        relative = torch.index_select(local, 1, self.without_root)
        outer = (relative[..., :, None] * relative[..., None, :]).reshape(-1, JOINT_COUNT, 16)
        parts = [self.neutral + outer @ self.sixd_terms, -rotation[:, :, 1, :]]
        static = torch.cat(parts, dim=-1).reshape(-1, JOINT_COUNT * STATIC_PER_JOINT)
        return torch.cat([static, betas], dim=-1)

    def _matrices(self, quaternion: Tensor) -> Tensor:
        """Rotation matrices (n, 9) of quaternions (n, 4) of any length: of q q^T over |q|^2."""
        outer = (quaternion[:, :, None] * quaternion[:, None, :]).reshape(-1, 16)
        terms = outer @ self.rotation_terms
        return self.identity + terms[:, :9] / terms[:, 9:]

    def _blended_rotation(self, quaternion: Tensor, weights: Tensor, index: Indices) -> Tensor:
        """Rotations (P, 3, 3) of ``drape.geometry.skinning.blend_frames``, signs taken once per pair of bones."""
        agreement = quaternion @ quaternion.mT  # (B, 24, 24)
        sign = torch.where(agreement < 0.0, -1.0, 1.0).reshape(-1, JOINT_COUNT)
        signed = weights * rows(sign, index.bone)
        reference = rows(quaternion.reshape(-1, 4), index.bone)
        mixed = (signed[:, None, :] @ rows(quaternion, index.body)).reshape(-1, 4) + 1e-6 * reference
        return self._matrices(mixed).reshape(-1, 3, 3)


def _kinematic_tables() -> dict[str, Tensor]:
    """Returns the constant tensors that ``PatchKinematics`` computes with, by the names of its buffers."""
    rotation = torch.zeros(16, 10)
    for column, entries in enumerate(_ROTATION):
        for row, factor in entries:
            rotation[row, column] = factor
    product = torch.zeros(4, 16)
    for column, (row, sign) in enumerate(_LEFT):
        product[row, column] = sign
    offsets, descent = torch.eye(JOINT_COUNT), torch.zeros(JOINT_COUNT, JOINT_COUNT)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            offsets[joint, parent] -= 1.0
            descent[joint] = descent[parent]
            descent[joint, joint] = 1.0
    return {
        "rotation_terms": rotation,
        "sixd_terms": rotation[:, list(_SIXD)],
        "neutral": torch.eye(3).reshape(9)[list(_SIXD)],
        "left_terms": product,
        "identity": torch.eye(3).reshape(1, 9),
        "offsets": offsets,
        "descent": descent,
        "parents": torch.tensor([max(parent, 0) for parent in PARENTS]),
        "without_root": torch.tensor([JOINT_COUNT, *range(1, JOINT_COUNT)]),
    }


def ancestor_jumps() -> list[Tensor]:
    """Returns index tensors (25,): the ancestor of each joint one step up, then two, four, ... as long as any has one.
    24 stands for no ancestor, and row 24 holds 24."""
    above = [parent if parent >= 0 else JOINT_COUNT for parent in PARENTS] + [JOINT_COUNT]
    jumps = []
    while any(joint != JOINT_COUNT for joint in above):
        jumps.append(torch.tensor(above))
        above = [above[joint] for joint in above]
    return jumps
