"""Inputs of the network that describe the body: joint descriptors of a pose, for numpy or torch.

Per joint, as in Neural Cloth Simulation (Bertiche et al. 2022): the 6D descriptor of its
rotation relative to the parent, and the direction of gravity in the joint's frame.
The root's own rotation is left out: gravity already says how it leans, and the drape
must not depend on which way the body faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import Array, like, namespace
from drape.body.skeleton import JOINT_COUNT
from drape.engine.calls import call
from drape.geometry.rotations import matrix_to_sixd

STATIC_PER_JOINT = 9
DYNAMIC_PER_JOINT = 12
GRAVITY_DIRECTION = (0.0, -1.0, 0.0)
STILL = 1e-6
"""Dynamic descriptors [1/s, m/s^2] smaller than this are rounding and count as zero: a still body is still exactly."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Posed bodies in float64: ``static`` descriptors (..., 24, 9) of ``static_features``, positions ``joints`` [m]
    (..., 24, 3) in the world, and world ``rotations`` (..., 24, 3, 3) of the bones."""

    static: np.ndarray
    joints: np.ndarray
    rotations: np.ndarray

    def __getitem__(self, index: int | slice | tuple) -> Kinematics:
        """The bodies at ``index`` of the leading axes."""
        return Kinematics(self.static[index], self.joints[index], self.rotations[index])


def joint_rotations(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns ``poses`` (F, 24, 3) [rad] as unit quaternions wxyz (F, 24, 4) and matrices (F, 24, 3, 3), float64.

    The formulas are those of ``drape.geometry.rotations``. The engine computes them in one call, where NumPy takes
    fifty.
    """
    turns = np.ascontiguousarray(poses, np.float64)
    quaternions, matrices = np.empty((*turns.shape[:2], 4)), np.empty((*turns.shape, 3))
    call("turns", np.float64, turns, turns.size // 3, quaternions, matrices)
    return quaternions, matrices


def static_features(local_rotations: Array, world_rotations: Array) -> Array:
    """Returns the static descriptors (..., 24, 9) of posed joints: the 6D form of the rotation from the parent, then
    the unit direction of gravity in the joint's frame. The root's 6D form is that of no rotation.

    ``local_rotations``, from the parent, and ``world_rotations`` are (..., 24, 3, 3).
    """
    xp = namespace(local_rotations)
    sixd = matrix_to_sixd(local_rotations)
    neutral = xp.zeros_like(sixd[..., :1, :]) + like(sixd, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    sixd = xp.concat([neutral, sixd[..., 1:, :]], axis=-2)
    gravity = xp.matrix_transpose(world_rotations) @ like(world_rotations, GRAVITY_DIRECTION)
    return xp.concat([sixd, gravity], axis=-1)


def dynamic_features(
    static_now: Array,
    static_before: Array,
    joints: tuple[Array, Array, Array],
    world_rotations: Array,
    dt_s: Array,
    dt_before_s: Array | None = None,
) -> Array:
    """Returns the dynamic descriptors (..., 24, 12) of joints: the rate of the static ones [1/s], then the acceleration
    [m/s^2] in the joint's frame. They are zero for a still body.

    ``static_now`` and ``static_before`` are (..., 24, 9). ``joints`` are world positions [m] (..., 24, 3) in this
    frame, the one before and the one before that. ``world_rotations`` (..., 24, 3, 3) are those of this frame. ``dt_s``
    is the time since the frame before, ``dt_before_s`` that between the two others (the same if left out); both
    broadcast over (..., 24, 1).
    """
    xp = namespace(static_now)
    dt_before_s = dt_s if dt_before_s is None else dt_before_s
    rate = (static_now - static_before) / dt_s
    now, before, earlier = joints
    acceleration = ((now - before) / dt_s - (before - earlier) / dt_before_s) / (0.5 * (dt_s + dt_before_s))
    local = (xp.matrix_transpose(world_rotations) @ acceleration[..., None])[..., 0]
    return xp.concat([rate, local], axis=-1)


def motion_features(
    now: Kinematics, before: Kinematics, earlier: Kinematics, dt_s: np.ndarray, dt_before_s: np.ndarray
) -> np.ndarray:
    """Returns the dynamic descriptors (..., 24, 12), as ``dynamic_features`` makes them, of the bodies ``now``. Numbers
    smaller than ``STILL`` are zero.

    ``before`` are these bodies ``dt_s`` (...) [s] ago, and ``earlier`` ``dt_before_s`` (...) [s] before that.
    """
    dt_s, dt_before_s = (np.asarray(dt, dtype=np.float64)[..., None, None] for dt in (dt_s, dt_before_s))
    joints = (now.joints, before.joints, earlier.joints)
    found = dynamic_features(now.static, before.static, joints, now.rotations, dt_s, dt_before_s)
    return np.where(np.abs(found) < STILL, 0.0, found)


def feature_count() -> int:
    """Returns the number of a body's static descriptors, all joints together."""
    return JOINT_COUNT * STATIC_PER_JOINT
