"""Key points of a posed body: its joints, and points of its skin for nose, ears, heels and toes."""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from drape.geometry.rigid import bone_transforms
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.t_pose import JOINT_INDEX

SIDES = ("left", "right")
LEFT_POINTS = {
    "mediapipe": {"ear": 7, "shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27}
    | {"heel": 29, "toe": 31},
    "coco": {"ear": 3, "shoulder": 5, "elbow": 7, "wrist": 9, "hip": 11, "knee": 13, "ankle": 15},
}
INDEX = {
    layout: {"nose": 0} | {f"{side}_{name}": at + k for name, at in left.items() for k, side in enumerate(SIDES)}
    for layout, left in LEFT_POINTS.items()
}
COUNTS = {"mediapipe": 33, "coco": 17}
SIGNS = {"mediapipe": [1.0, -1.0, -1.0], "coco": [1.0, 1.0, 1.0]}


def skin_points(body: BodyModel) -> dict[str, tuple[int, np.ndarray]]:
    """The bone that carries each point, and its place [m] in the T-pose: the outermost vertices of head and feet."""
    rest, weights = body.v_template, body.weights

    def outermost(joints: list[str], axis: int, sign: float) -> np.ndarray:
        carried = np.flatnonzero(weights[:, [JOINT_INDEX[joint] for joint in joints]].sum(axis=1) > 0.9)
        return rest[carried[(sign * rest[carried, axis]).argmax()]]

    points = {"nose": (JOINT_INDEX["head"], outermost(["head"], 2, 1.0))}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        foot = [f"{side}_ankle", f"{side}_foot"]
        points[f"{side}_ear"] = JOINT_INDEX["head"], outermost(["head"], 0, sign)
        points[f"{side}_heel"] = JOINT_INDEX[foot[0]], outermost(foot, 2, -1.0)
        points[f"{side}_toe"] = JOINT_INDEX[foot[1]], outermost(foot, 2, 1.0)
    return points


def person(body: BodyModel, poses: np.ndarray, layout: str = "mediapipe") -> np.ndarray:
    """Points (F, N, 3) [m] of poses (F, 24, 3), in the layout's order and axes; those it does not name are zero."""
    joints = body.rest_joints()
    rotations, translations = bone_transforms(rotvec_to_matrix(poses), joints, PARENTS)
    skin = skin_points(body)
    points = np.zeros((len(poses), COUNTS[layout], 3))
    for name, at in INDEX[layout].items():
        bone, place = skin[name] if name in skin else (JOINT_INDEX[name], joints[JOINT_INDEX[name]])
        points[:, at] = (rotations[:, bone] @ place + translations[:, bone]) * SIGNS[layout]
    return points
