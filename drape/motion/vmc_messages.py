"""Poses of the Virtual Motion Capture protocol (VMC): the bones of a humanoid in Unity, one message each.

A message has a bone's rotation from its parent, on a skeleton that has the world's axes in its T-pose. Unity's axes are
left-handed, y up, and its person faces +z. With M = diag(-1, 1, 1) a rotation R is M R M in ours: a quaternion (w, x,
y, z) becomes (w, x, -y, -z), and a position (x, y, z) becomes (-x, y, z).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.geometry.rotations import quaternion_multiply, quaternion_to_matrix
from drape.motion.grounding import leg_length
from drape.motion.joint_names import ancestors, is_whole
from drape.motion.rig_poses import Rig, rig_to_poses
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX

BONE, ROOT = "/VMC/Ext/Bone/Pos", "/VMC/Ext/Root/Pos"
LEAST_LEG_M = 0.05  # A shorter leg is that of a sender that does not say where its bones are.

# Unity's bones in the order of SMPL's joints, which have the same parents. SMPL's hands have none.
_NAMES: tuple[str, ...] = (
    "Hips", "LeftUpperLeg", "RightUpperLeg", "Spine", "LeftLowerLeg", "RightLowerLeg", "Chest", "LeftFoot", "RightFoot",
    "UpperChest", "LeftToes", "RightToes", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftUpperArm",
    "RightUpperArm", "LeftLowerArm", "RightLowerArm", "LeftHand", "RightHand",
)  # fmt: skip
_BONES: dict[str, str] = dict(zip(_NAMES, JOINT_NAMES, strict=False))


class VmcPoses:
    """The newest pose of one sender of VMC messages. ``count`` is how many messages were used."""

    def __init__(self) -> None:
        self._turns: dict[str, np.ndarray] = {}
        self._places: dict[str, np.ndarray] = {}
        self._root = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
        self.count = 0

    def take(self, address: str, values: Sequence[object]) -> bool:
        """Keeps what a message to ``address`` says, if it is the transform of a bone or of the root. Returns whether it
        was."""
        name, *numbers = values[:8] or ("",)
        if len(numbers) != 7 or not all(isinstance(one, float) for one in numbers):
            return False
        x, y, z, *quaternion = np.array(numbers, dtype=np.float64)
        length = float(np.linalg.norm(quaternion))
        if not (np.isfinite([x, y, z]).all() and 0.5 < length < 2.0):
            return False
        turn = np.roll(quaternion, 1) * [1.0, 1.0, -1.0, -1.0] / length
        place = np.array([-x, y, z])
        if address == ROOT:
            self._root = turn, place
        elif address == BONE and isinstance(name, str) and name in _BONES:
            self._turns[name], self._places[name] = turn, place
        else:
            return False
        self.count += 1
        return True

    def pose(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Returns the SMPL pose (24, 3) [rad], and the position (3,) of the pelvis in the sender's world, y up from its
        ground, as multiples of the length of the sender's leg; None until all bones that a person needs have come."""
        bones = tuple(name for name in _BONES if name in self._turns)
        if not is_whole(dict.fromkeys(("spine2", "spine3", *(_BONES[name] for name in bones)), 0)):
            return None
        turn, place = self._root
        turns = np.array([self._turns[name] for name in bones])
        turns[0] = quaternion_multiply(turn, turns[0])
        pelvis = place + quaternion_to_matrix(turn) @ self._places["Hips"]
        leg_m = sum(float(np.linalg.norm(self._places[name])) for name in ("LeftLowerLeg", "LeftFoot"))
        leg_m = leg_m if leg_m > LEAST_LEG_M else leg_length(CANONICAL_JOINTS)
        return rig_to_poses(_rig(bones), turns[None])[0], pelvis / leg_m

    def placed(self, rest_joints: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Returns the SMPL pose (24, 3) [rad] and the root translation [m] (3,) for a body with the rest joints
        ``rest_joints`` [m] (24, 3) on the ground y = 0; None as ``pose``."""
        found = self.pose()
        return None if found is None else (found[0], found[1] * leg_length(rest_joints) - rest_joints[0])


@lru_cache(maxsize=16)
def _rig(bones: tuple[str, ...]) -> Rig:
    """The skeleton with the world's axes that has ``bones``, in the T-pose."""
    joints = [JOINT_INDEX[_BONES[name]] for name in bones]
    above = [next((up for up in ancestors(PARENTS, joint)[1:] if up in joints), -1) for joint in joints]
    parents = [joints.index(up) if up >= 0 else -1 for up in above]
    pairs = zip(joints, above, strict=True)
    offsets = [CANONICAL_JOINTS[joint] - (CANONICAL_JOINTS[up] if up >= 0 else 0.0) for joint, up in pairs]
    names = [name[0].lower() + name[1:] for name in bones]
    return Rig(names, parents, np.tile([1.0, 0.0, 0.0, 0.0], (len(bones), 1)), np.array(offsets), label="VMC")
