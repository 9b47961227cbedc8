"""Clips for a body other than the recorded one: the same poses, with the soles where they were over the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.errors import MotionError
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip
from drape.motion.t_pose import CANONICAL_FLOOR, CANONICAL_JOINTS, JOINT_INDEX

# Heel behind the ankle and tip before the joint of the toes [m], for a foot of average size.
HEEL_BEHIND = 0.045
TIP_AHEAD = 0.065
NOTED_M = 0.15  # A lowest sole so near to the ground needs no note: a jump lands, and a floor may have a step.


def place_on_ground(clip: MotionClip, rest_joints: np.ndarray, *, floor: float) -> MotionClip:
    """Returns the clip for a body of ``rest_joints`` [m] (24, 3) whose soles rest at height ``floor`` [m] in its rest
    frame. The result's ``trans`` is SMPL's: what to add to this posed body.

    The clip's ``trans`` is taken for the path of a pelvis that rests at the origin, as in the sample clips and in
    readers' results. It is scaled by the length of the legs, and each frame's height is chosen so that the lower sole
    keeps the distance from the ground y = 0 that the clip gives it on a canonical body.
    """
    rest_joints = np.asarray(rest_joints, dtype=np.float64)
    check_shape("rest_joints", rest_joints, (JOINT_COUNT, 3), error=MotionError)
    check_finite("rest_joints", rest_joints, error=MotionError)
    scale = leg_length(rest_joints) / leg_length(CANONICAL_JOINTS)
    local = rotvec_to_matrix(clip.poses)
    canonical = sole_heights(local, CANONICAL_JOINTS, floor=CANONICAL_FLOOR).min(axis=(1, 2)) + clip.trans[:, 1]
    trans = scale * clip.trans - rest_joints[0]
    trans[:, 1] = scale * canonical - sole_heights(local, rest_joints, floor=floor).min(axis=(1, 2))
    return replace(clip, trans=trans)


def sole_heights(local_rotations: np.ndarray, rest_joints: np.ndarray, *, floor: float) -> np.ndarray:
    """Returns the heights y [m] (F, 2, 3) of heel, ball and tip of the left and right soles, before any root
    translation.

    ``local_rotations`` (F, 24, 3, 3) are relative to the parent, and ``rest_joints`` [m] (24, 3) those of a body whose
    soles rest at height ``floor`` [m].
    """
    rotations, joints = forward_kinematics(local_rotations, rest_joints, PARENTS)
    heights = np.empty((len(joints), 2, 3))
    for index, side in enumerate(("left", "right")):
        ankle, toes = JOINT_INDEX[f"{side}_ankle"], JOINT_INDEX[f"{side}_foot"]
        heel, ball, tip = (rest_joints[joint].copy() for joint in (ankle, toes, toes))
        heel[2] -= HEEL_BEHIND
        tip[2] += TIP_AHEAD
        # The tip lies past the joint of the toes and turns with it.
        for point, (place, joint) in enumerate(((heel, ankle), (ball, ankle), (tip, toes))):
            place[1] = floor
            offset = place - rest_joints[joint]
            heights[:, index, point] = (joints[:, joint] + rotations[:, joint] @ offset)[:, 1]
    return heights


def floor_note(poses: np.ndarray, trans: np.ndarray, rest_joints: np.ndarray, *, floor: float) -> str:
    """Returns a sentence for the caller if the lowest sole of ``poses`` (F, 24, 3) [rad] at ``trans`` [m] (F, 3) is
    more than ``NOTED_M`` above or below the ground y = 0; otherwise an empty string. ``rest_joints`` and ``floor`` are
    those of ``place_on_ground``."""
    heights = sole_heights(rotvec_to_matrix(poses), rest_joints, floor=floor).min(axis=(1, 2)) + trans[:, 1]
    lowest = float(heights.min())
    if abs(lowest) <= NOTED_M:
        return ""
    where = "above" if lowest > 0.0 else "below"
    return f"feet: the lowest sole is {abs(lowest):.2f} m {where} the floor; place the clip for the body that moves"


def leg_length(joints: np.ndarray) -> float:
    hip, knee, ankle = (joints[JOINT_INDEX[f"left_{joint}"]] for joint in ("hip", "knee", "ankle"))
    return float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
