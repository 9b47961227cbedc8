"""A sender of VMC: the canonical person in Unity's axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.motion.t_pose import CANONICAL_JOINTS

UNITY = {
    "Hips": "pelvis", "LeftUpperLeg": "left_hip", "RightUpperLeg": "right_hip", "Spine": "spine1",
    "LeftLowerLeg": "left_knee", "RightLowerLeg": "right_knee", "Chest": "spine2", "LeftFoot": "left_ankle",
    "RightFoot": "right_ankle", "UpperChest": "spine3", "LeftToes": "left_foot", "RightToes": "right_foot",
    "Neck": "neck", "LeftShoulder": "left_collar", "RightShoulder": "right_collar", "Head": "head",
    "LeftUpperArm": "left_shoulder", "RightUpperArm": "right_shoulder", "LeftLowerArm": "left_elbow",
    "RightLowerArm": "right_elbow", "LeftHand": "left_wrist", "RightHand": "right_wrist",
}  # fmt: skip
OPTIONAL = ("Chest", "UpperChest", "Neck", "LeftShoulder", "RightShoulder", "LeftToes", "RightToes")
MIRROR = np.diag([-1.0, 1.0, 1.0])


def _values(name: str, turn: Rotation, place: np.ndarray) -> list:
    mirrored = Rotation.from_matrix(MIRROR @ turn.as_matrix() @ MIRROR)
    return [name, *(MIRROR @ place).tolist(), *mirrored.as_quat().tolist()]


def messages(
    pose: np.ndarray, trans: np.ndarray, *, root: tuple[Rotation, np.ndarray] | None = None, missing: Sequence[str] = ()
) -> Iterator[tuple[str, list]]:
    """Address and values of a root and of each bone but the ``missing`` ones, for a pose (24, 3) [rad] and the pelvis's
    place (3,) [m]."""
    turn, place = root or (Rotation.identity(), np.zeros(3))
    yield "/VMC/Ext/Root/Pos", _values("root", turn, place)
    for bone, joint in UNITY.items():
        if bone in missing:
            continue
        number = JOINT_NAMES.index(joint)
        offset = trans if number == 0 else CANONICAL_JOINTS[number] - CANONICAL_JOINTS[PARENTS[number]]
        yield "/VMC/Ext/Bone/Pos", _values(bone, Rotation.from_rotvec(np.array(pose[number])), offset)
