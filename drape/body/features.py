"""What the network is told about the body: joint descriptors of a pose, for numpy or torch.

Per joint, as in Neural Cloth Simulation (Bertiche et al. 2022): the 6D descriptor of its
rotation relative to the parent, and the direction of gravity in the joint's frame.
The root's own rotation is left out: gravity already says how it leans, and the drape
must not depend on which way the body faces.
"""

from __future__ import annotations

from drape.arrays import Array, like, namespace
from drape.body.skeleton import JOINT_COUNT
from drape.geometry.rotations import matrix_to_sixd

STATIC_PER_JOINT = 9
DYNAMIC_PER_JOINT = 12
GRAVITY_DIRECTION = (0.0, -1.0, 0.0)


def static_features(local_rotations: Array, world_rotations: Array) -> Array:
    """Static descriptors (..., 24, 9): 6D local rotation, gravity [unit] in the joint's frame.

    ``local_rotations`` and ``world_rotations`` are (..., 24, 3, 3).
    """
    xp = namespace(local_rotations)
    sixd = matrix_to_sixd(local_rotations)
    neutral = xp.zeros_like(sixd[..., :1, :]) + like(sixd, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    sixd = xp.concat([neutral, sixd[..., 1:, :]], axis=-2)
    gravity = xp.matrix_transpose(world_rotations) @ like(world_rotations, GRAVITY_DIRECTION)
    return xp.concat([sixd, gravity], axis=-1)


def dynamic_features(
    static_now: Array, static_before: Array, joints: tuple[Array, Array, Array], world_rotations: Array, dt_s: Array
) -> Array:
    """Dynamic descriptors (..., 24, 12): rate of the static ones [1/s], joint acceleration [m/s^2] in its frame.

    ``joints`` are world joint positions [m] (..., 24, 3) at t, t - dt, t - 2 dt;
    ``dt_s`` broadcasts over (..., 24, 1). Zero for a still body.
    """
    xp = namespace(static_now)
    rate = (static_now - static_before) / dt_s
    now, before, earlier = joints
    acceleration = (now - 2.0 * before + earlier) / (dt_s * dt_s)
    local = (xp.matrix_transpose(world_rotations) @ acceleration[..., None])[..., 0]
    return xp.concat([rate, local], axis=-1)


def feature_count() -> int:
    """Length of the flattened static descriptors."""
    return JOINT_COUNT * STATIC_PER_JOINT
