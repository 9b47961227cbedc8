"""Rigid transforms as (rotation, translation) pairs, and forward kinematics."""

from __future__ import annotations

from collections.abc import Sequence

from drape.arrays import Array, namespace


def apply(rotation: Array, translation: Array, points: Array) -> Array:
    """Returns ``R x + t`` (..., n, 3) for ``points`` x (..., n, 3), rotations R (..., 3, 3) and translations t (...,
    3)."""
    xp = namespace(points)
    return points @ xp.matrix_transpose(rotation) + translation[..., None, :]


def forward_kinematics(local_rotations: Array, joints: Array, parents: Sequence[int]) -> tuple[Array, Array]:
    """Returns the world rotations (..., J, 3, 3) of joints and their world positions [m] (..., J, 3). The root stays at
    its rest position. ``local_rotations`` (..., J, 3, 3) turn each joint relative to its parent; ``joints`` [m] (...,
    J, 3) are rest positions; ``parents[j] < j``, the root's is -1. Batch axes broadcast."""
    xp = namespace(local_rotations)
    rotations: list[Array] = []
    positions: list[Array] = []
    for joint, parent in enumerate(parents):
        local = local_rotations[..., joint, :, :]
        if parent < 0:
            rotations.append(local)
            # The zeros give the root the batch axes that the rotations bring.
            positions.append(joints[..., joint, :] + xp.zeros_like(local[..., 0]))
            continue
        offset = joints[..., joint, :] - joints[..., parent, :]
        rotations.append(rotations[parent] @ local)
        positions.append(positions[parent] + (rotations[parent] @ offset[..., None])[..., 0])
    return xp.stack(rotations, axis=-3), xp.stack(positions, axis=-2)


def bone_transforms(local_rotations: Array, joints: Array, parents: Sequence[int]) -> tuple[Array, Array]:
    """Returns the rotations R (..., J, 3, 3) and translations t [m] (..., J, 3) that take each bone from its rest
    position to the posed one: ``x_posed = R_j x_rest + t_j``. The arguments are those of ``forward_kinematics``."""
    rotations, positions = forward_kinematics(local_rotations, joints, parents)
    return rotations, positions - (rotations @ joints[..., None])[..., 0]
