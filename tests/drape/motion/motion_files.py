"""Small skeletons, and a writer of BVH files for them: the inverse of the reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.motion.t_pose import CANONICAL_JOINTS

# The 22 joints that motion capture has; every scheme names them in this order.
BODY = JOINT_NAMES[:22]
BODY_PARENTS = PARENTS[:22]

_LIMBS = {
    "mixamo": ("mixamorig:Left", "mixamorig:Right", "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand"),
    "lafan": ("Left", "Right", "UpLeg Leg Foot Toe Shoulder Arm ForeArm Hand"),
    "poser": ("Left", "Right", "Hip Knee Ankle Toe Collar Shoulder Elbow Wrist"),
    "smpl": ("left_", "right_", "hip knee ankle foot collar shoulder elbow wrist"),
    "acclaim": ("l", "r", "femur tibia foot toes clavicle humerus radius wrist"),
}
_TRUNKS = {
    "mixamo": [f"mixamorig:{word}" for word in ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"]],
    "lafan": ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"],
    "poser": ["Hips", "Chest", "Chest2", "Chest3", "Neck", "Head"],
    "smpl": ["pelvis", "spine1", "spine2", "spine3", "neck", "head"],
    "acclaim": ["root", "lowerback", "upperback", "thorax", "lowerneck", "head"],
}
SCHEMES = tuple(_LIMBS)


def scheme_names(scheme: str) -> list[str]:
    """The scheme's names of ``BODY``."""
    left, right, words = _LIMBS[scheme]
    table = dict(zip(["pelvis", "spine1", "spine2", "spine3", "neck", "head"], _TRUNKS[scheme], strict=True))
    for joint, word in zip(
        ["hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist"], words.split(), strict=True
    ):
        table |= {f"left_{joint}": left + word, f"right_{joint}": right + word}
    return [table[joint] for joint in BODY]


def t_pose_offsets() -> np.ndarray:
    """Offsets [m] (22, 3) of a T-pose whose arms are exactly level."""
    joints = CANONICAL_JOINTS[:22]
    offsets = joints - joints[[max(parent, 0) for parent in BODY_PARENTS]]
    for joint in ("left_shoulder", "right_shoulder"):
        offsets[BODY.index(joint), 1] = 0.0
    return offsets


def write_bvh(
    path: Path,
    names: list[str],
    parents: tuple[int, ...],
    offsets: np.ndarray,
    local: np.ndarray,
    root: np.ndarray,
    *,
    fps: float = 60.0,
    order: str = "ZXY",
    positions_last: bool = False,
    tips: dict[int, np.ndarray] | None = None,
) -> Path:
    """Write rotations relative to the parent (F, J, 3, 3) and root positions (F, 3); ``tips``: end sites by joint."""
    columns: list[np.ndarray] = []
    lines = ["HIERARCHY"]

    def add(joint: int, depth: int) -> None:
        pad = "\t" * depth
        rotation = [f"{axis}rotation" for axis in order]
        place = ["Xposition", "Yposition", "Zposition"] if parents[joint] < 0 else []
        channels = rotation + place if positions_last else place + rotation
        angles = Rotation.from_matrix(local[:, joint]).as_euler(order, degrees=True)
        blocks = [root if parents[joint] < 0 else root[:, :0], angles]
        columns.extend(blocks[::-1] if positions_last else blocks)
        kind = "ROOT" if parents[joint] < 0 else "JOINT"
        lines.append(f"{pad}{kind} {names[joint]}")
        lines.append(f"{pad}{{")
        lines.append(f"{pad}\tOFFSET " + " ".join(f"{value:.9f}" for value in offsets[joint]))
        lines.append(f"{pad}\tCHANNELS {len(channels)} " + " ".join(channels))
        children = [child for child, parent in enumerate(parents) if parent == joint]
        for child in children:
            add(child, depth + 1)
        if not children:
            tip = " ".join(f"{value:.9f}" for value in (tips or {}).get(joint, np.zeros(3)))
            lines.extend([f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET {tip}", f"{pad}\t}}"])
        lines.append(f"{pad}}}")

    add(0, 0)
    values = np.concatenate(columns, axis=-1)
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {1.0 / fps:.12f}"]
    lines += [" ".join(f"{value:.9f}" for value in row) for row in values]
    path.write_text("\n".join(lines) + "\n")
    return path
