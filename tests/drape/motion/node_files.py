"""A person who walks, in files of every kind whose nodes move: GLB and FBX, on rigs with axes of their own."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from drape.export.glb_file import GlbFile
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.rig_poses import Rig
from drape.motion.samples import SAMPLES
from tests.drape.motion.motion_files import BODY_PARENTS, t_pose_offsets
from tests.drape.motion.rigs import a_pose, rig_and_motion
from tests.fixtures.fbx_writer import fbx_motion

FPS = 30.0
CLIP = SAMPLES["walk"]().resampled(FPS).window(0, 40)
T_POSE = np.tile(np.eye(3), (22, 1, 1))


def level_joints() -> np.ndarray:
    """The rest joints (24, 3) of a person whose arms are exactly level."""
    places = np.zeros((24, 3))
    places[:22] = t_pose_offsets()
    for joint in range(1, 22):
        places[joint] += places[BODY_PARENTS[joint]]
    return places


JOINTS = level_joints()


def moved(scheme: str, rest: np.ndarray, unit: float = 1.0) -> tuple[Rig, np.ndarray, np.ndarray]:
    """A rig with axes of its own, its local quaternions (F, J, 4) wxyz and its root's places (F, 3) in its unit."""
    joints = JOINTS
    rig, quaternions = rig_and_motion(joints, rotvec_to_matrix(CLIP.poses), scheme=scheme, rest=rest, seed=3)
    places = (CLIP.trans + joints[0]) / unit
    return Rig(rig.names, rig.parents, rig.rest_rotations, rig.rest_translations / unit), quaternions, places


def glb(
    rig: Rig,
    quaternions: np.ndarray,
    places: np.ndarray,
    *,
    extensions=None,
    interpolation="LINEAR",
    scale=1.0,
    clips=("walk",),
) -> bytes:
    """A GLB of the rig's nodes below an armature that has a ``scale``, and an animation of them by each name of
    ``clips``."""
    file = GlbFile()
    armature = file.node({"name": "Armature", "scale": [scale] * 3})
    first = armature + 1
    for number, name in enumerate(rig.names):
        children = [first + k for k, parent in enumerate(rig.parents) if parent == number]
        node = {"name": name, "translation": rig.rest_translations[number].tolist()}
        node["rotation"] = np.roll(rig.rest_rotations[number], -1).tolist()
        file.add("nodes", node | ({"children": children} if children else {}))
    file.json["nodes"][armature]["children"] = [first]
    times = file.array(np.arange(len(places), dtype=np.float32) / np.float32(FPS), bounds=True)
    channels, samplers = [], []
    rows = [(number, "rotation", np.roll(quaternions[:, number], -1, axis=1)) for number in range(len(rig.names))]
    for number, path, values in [*rows, (0, "translation", places)]:
        if interpolation == "CUBICSPLINE":
            slope = np.gradient(values, 1.0 / FPS, axis=0)
            values = np.stack([slope, values, slope], axis=1).reshape(-1, values.shape[1])
        samplers.append(
            {"input": times, "output": file.array(values.astype(np.float32)), "interpolation": interpolation}
        )
        channels.append({"sampler": len(samplers) - 1, "target": {"node": first + number, "path": path}})
    for name in clips:
        file.add("animations", {"name": name, "channels": channels, "samplers": samplers})
    if extensions:
        file.json["extensions"] = extensions(first)
    return file.to_bytes()


def fbx(up: str = "y") -> bytes:
    """An FBX of the clip in centimetres, in an A-pose, with the axis ``up``, "y" or "z"."""
    joints = JOINTS
    rig, quaternions = rig_and_motion(joints, rotvec_to_matrix(CLIP.poses), scheme="mixamo", rest=a_pose(30.0, 4.0))
    places, rest = 100.0 * (CLIP.trans + joints[0]), 100.0 * rig.rest_translations
    turns = Rotation.from_quat(np.roll(quaternions, -1, axis=2).reshape(-1, 4))
    if up == "z":  # the file's root stands on its side
        side = Rotation.from_euler("x", 90, degrees=True)
        first = side * Rotation.from_quat(np.roll(quaternions[:, 0], -1, axis=1))
        quaternions = quaternions.copy()
        quaternions[:, 0] = np.roll(first.as_quat(), 1, axis=1)
        turns = Rotation.from_quat(np.roll(quaternions, -1, axis=2).reshape(-1, 4))
        places, rest[0] = side.apply(places), side.apply(rest[0])
        still = side * Rotation.from_quat(np.roll(rig.rest_rotations[0], -1))
        rig.rest_rotations[0] = np.roll(still.as_quat(), 1)
    angles = turns.as_euler("xyz", degrees=True).reshape(*quaternions.shape[:2], 3)
    still = Rotation.from_quat(np.roll(rig.rest_rotations, -1, axis=1)).as_euler("xyz", degrees=True)
    return fbx_motion(rig.names, rig.parents, rest, still, places, angles, fps=FPS, up=2 if up == "z" else 1)
