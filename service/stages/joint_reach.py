"""The way by which a turn of each joint moves a garment: little for limbs that it does not hang on.

The network reads every joint, so no list and no skinning weight says what moves what: it is measured, once a garment.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drape.body.skeleton import JOINT_COUNT
from drape.geometry.rotations import quaternion_multiply, rotvec_to_quaternion

TURN_RAD = 0.2
ARMS_DOWN = ((16, -1.1), (17, 1.1))  # joint, turn about z [rad]: a body that stands, beside the T of the rest pose
AT_ONCE = 8  # frames

Draped = Callable[[np.ndarray], np.ndarray]


def reach_m(draped: Draped) -> np.ndarray:
    """The way [m] (24,) of the furthest vertex by each radian of a joint.

    It is the most of two poses and three axes, by turns of ``TURN_RAD``. ``draped`` gives the vertices [m] (F, V, 3) of
    poses (F, 24, 3) [rad].
    """
    standing = np.zeros((JOINT_COUNT, 3))
    for joint, turn in ARMS_DOWN:
        standing[joint, 2] = turn
    most = np.zeros(JOINT_COUNT)
    for pose in (np.zeros((JOINT_COUNT, 3)), standing):
        drape = draped(pose[None])[0]
        turned = np.repeat(pose[None], 3 * JOINT_COUNT, axis=0)
        for row in range(len(turned)):
            turned[row, row // 3, row % 3] += TURN_RAD
        ways = [
            np.linalg.norm(draped(turned[start : start + AT_ONCE]) - drape, axis=-1).max(axis=1)
            for start in range(0, len(turned), AT_ONCE)
        ]
        most = np.maximum(most, np.concatenate(ways).reshape(JOINT_COUNT, 3).max(axis=1))
    return most / TURN_RAD


def turns_rad(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Angles [rad] (24,) by which each joint turns from the pose ``before`` (24, 3) [rad] to ``after``."""
    inverse, to = rotvec_to_quaternion(-before), rotvec_to_quaternion(after)
    turn = np.asarray(quaternion_multiply(inverse, to))
    return 2.0 * np.arctan2(np.linalg.norm(turn[:, 1:], axis=1), np.abs(turn[:, 0]))
