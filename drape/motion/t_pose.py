"""A canonical T-pose of a 1.65 m person on the 24 SMPL joints.

y up, facing +z, left hand at +x. The canonical joints serve retargeting and the
generated sample clips; draping uses the joints of the body asset instead.
"""

from __future__ import annotations

import numpy as np

from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS

JOINT_INDEX = {name: index for index, name in enumerate(JOINT_NAMES)}

# Offsets from the parent joint [m]; the right side mirrors the left.
_OFFSETS = {
    "pelvis": (0.0, 0.0, 0.0),
    "left_hip": (0.085, -0.080, 0.0),
    "left_knee": (0.0, -0.380, 0.0),
    "left_ankle": (0.0, -0.400, 0.0),
    "left_foot": (0.0, -0.055, 0.120),
    "spine1": (0.0, 0.115, 0.0),
    "spine2": (0.0, 0.130, 0.0),
    "spine3": (0.0, 0.055, 0.0),
    "neck": (0.0, 0.205, 0.0),
    "head": (0.0, 0.090, 0.0),
    "left_collar": (0.070, 0.110, 0.0),
    "left_shoulder": (0.105, 0.035, 0.0),
    "left_elbow": (0.255, 0.0, 0.0),
    "left_wrist": (0.245, 0.0, 0.0),
    "left_hand": (0.080, 0.0, 0.0),
}


def _canonical_offsets() -> np.ndarray:
    offsets = np.empty((JOINT_COUNT, 3))
    for index, name in enumerate(JOINT_NAMES):
        side = -1.0 if name.startswith("right_") else 1.0
        x, y, z = _OFFSETS[name.replace("right_", "left_")]
        offsets[index] = side * x, y, z
    return offsets


def _canonical_joints() -> np.ndarray:
    joints = _canonical_offsets()
    for index, parent in enumerate(PARENTS):
        if parent >= 0:
            joints[index] += joints[parent]
    joints.setflags(write=False)
    return joints


CANONICAL_JOINTS = _canonical_joints()
"""Rest positions [m] (24, 3); the pelvis is at the origin."""

ANKLE_HEIGHT = 0.075
"""Height [m] of the ankle joint above the sole."""

CANONICAL_FLOOR = float(CANONICAL_JOINTS[JOINT_INDEX["left_ankle"], 1]) - ANKLE_HEIGHT
"""Height [m] of the soles of the canonical T-pose."""

# The child that a joint's bone points to; hands, feet and head point nowhere.
BONE_CHILD = {
    "pelvis": "spine1",
    "spine1": "spine2",
    "spine2": "spine3",
    "spine3": "neck",
    "neck": "head",
    **{f"{side}_{joint}": f"{side}_{child}" for side in ("left", "right") for joint, child in (
        ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"),
        ("collar", "shoulder"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"),
    )},
}  # fmt: skip

_UP, _DOWN, _FORWARD, _LEFT = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
_RIGHT = (-1.0, 0.0, 0.0)

BONE_DIRECTIONS = {
    **dict.fromkeys(("pelvis", "spine1", "spine2", "spine3", "neck", "head"), _UP),
    **{f"{side}_{joint}": _DOWN for side in ("left", "right") for joint in ("hip", "knee")},
    **{f"{side}_{joint}": _FORWARD for side in ("left", "right") for joint in ("ankle", "foot")},
    **{f"left_{joint}": _LEFT for joint in ("collar", "shoulder", "elbow", "wrist", "hand")},
    **{f"right_{joint}": _RIGHT for joint in ("collar", "shoulder", "elbow", "wrist", "hand")},
}
"""Anatomical T-pose direction of each joint's bone: what a bone of any file's rest pose is compared with.

A foot's direction is its heading: the sole is flat, whatever the height of the ankle over the toes.
"""
