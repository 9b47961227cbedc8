"""Poses of the canonical skeleton with feet where they are wanted: two-bone inverse kinematics."""

from __future__ import annotations

import numpy as np

from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.geometry.rotations import matrix_to_rotvec
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX

SIDES = ("left", "right")


def unit_vector(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def leg_rotations(hip: np.ndarray, ankle: np.ndarray, forward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the world rotations (F, 3, 3) of thigh and shin of the canonical skeleton that bring the ankle from
    ``hip`` [m] (F, 3) to ``ankle`` [m] (F, 3).

    The knee bends towards ``forward`` (F, 3). Raises ``ValueError`` where the ankle is out of reach.
    """
    thigh, shin = _bone_length("left_knee"), _bone_length("left_ankle")
    line = ankle - hip
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    if distance.max() >= thigh + shin:
        raise ValueError(f"ankle {distance.max():.3f} m from the hip, but the leg is {thigh + shin:.3f} m long")
    line = line / distance
    side = unit_vector(np.cross(-line, forward))
    ahead = np.cross(side, -line)
    cosine = (thigh**2 + distance**2 - shin**2) / (2.0 * thigh * distance)
    knee_direction = cosine * line + np.sqrt(1.0 - cosine**2) * ahead
    shin_direction = unit_vector(ankle - (hip + thigh * knee_direction))
    return _frame(side, knee_direction), _frame(side, shin_direction)


def posed_clip(
    root: np.ndarray,
    pelvis: np.ndarray,
    upper: dict[str, np.ndarray],
    ankles: dict[str, np.ndarray],
    feet: dict[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Returns SMPL poses (F, 24, 3) [rad] and root translations [m] (F, 3) of the canonical skeleton with its feet
    where they are wanted.

    ``root`` [m] (F, 3) is the pelvis and ``pelvis`` (F, 3, 3) its world rotation. ``upper`` has the rotations (F, 3, 3)
    of joints that are no legs, relative to the parent, by their names. ``ankles`` [m] (F, 3) and ``feet`` (F, 3, 3)
    have, by side, the world positions of the ankles and the world rotations of the feet.
    """
    local = np.tile(np.eye(3), (len(root), JOINT_COUNT, 1, 1))
    local[:, 0] = pelvis
    for joint, rotation in upper.items():
        local[:, JOINT_INDEX[joint]] = rotation
    for side in SIDES:
        hip = root + pelvis @ CANONICAL_JOINTS[JOINT_INDEX[f"{side}_hip"]]
        # The knee points between the foot and the pelvis.
        forward = unit_vector(feet[side][..., 2] + pelvis[..., 2])
        thigh, shin = leg_rotations(hip, ankles[side], forward)
        local[:, JOINT_INDEX[f"{side}_hip"]] = np.swapaxes(pelvis, -1, -2) @ thigh
        local[:, JOINT_INDEX[f"{side}_knee"]] = np.swapaxes(thigh, -1, -2) @ shin
        local[:, JOINT_INDEX[f"{side}_ankle"]] = np.swapaxes(shin, -1, -2) @ feet[side]
    return matrix_to_rotvec(local), root


def _bone_length(joint: str) -> float:
    index = JOINT_INDEX[joint]
    return float(np.linalg.norm(CANONICAL_JOINTS[index] - CANONICAL_JOINTS[PARENTS[index]]))


def _frame(side: np.ndarray, down: np.ndarray) -> np.ndarray:
    return np.stack([side, -down, np.cross(side, -down)], axis=-1)
