"""Small skeletons, and writers of BVH and ASF/AMC files for them: the inverse of the readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drape.motion.skeleton import CANONICAL_JOINTS, JOINT_NAMES, PARENTS

# The 22 joints that motion capture has; every scheme names them in this order.
BODY = JOINT_NAMES[:22]
BODY_PARENTS = PARENTS[:22]

_LIMBS = {
    "mixamo": ("mixamorig:Left", "mixamorig:Right", "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand"),
    "lafan": ("Left", "Right", "UpLeg Leg Foot Toe Shoulder Arm ForeArm Hand"),
    "poser": ("Left", "Right", "Hip Knee Ankle Toe Collar Shoulder Elbow Wrist"),
    "smpl": ("left_", "right_", "hip knee ankle foot collar shoulder elbow wrist"),
}
_TRUNKS = {
    "mixamo": [f"mixamorig:{word}" for word in ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"]],
    "lafan": ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"],
    "poser": ["Hips", "Chest", "Chest2", "Chest3", "Neck", "Head"],
    "smpl": ["pelvis", "spine1", "spine2", "spine3", "neck", "head"],
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
) -> Path:
    """Write rotations relative to the parent (F, J, 3, 3) and root positions (F, 3)."""
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
            lines.extend([f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0 0 0", f"{pad}\t}}"])
        lines.append(f"{pad}}}")

    add(0, 0)
    values = np.concatenate(columns, axis=-1)
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {1.0 / fps:.12f}"]
    lines += [" ".join(f"{value:.9f}" for value in row) for row in values]
    path.write_text("\n".join(lines) + "\n")
    return path


# name: (parent, direction, length [m], dof, SMPL joint)
ASF_BONES = {
    "lhipjoint": ("root", (0.085, -0.08, 0.0), 0.117, "", None),
    "lfemur": ("lhipjoint", (0, -1, 0), 0.38, "rx ry rz", "left_hip"),
    "ltibia": ("lfemur", (0, -1, 0), 0.40, "rx", "left_knee"),
    "lfoot": ("ltibia", (0, -0.4, 0.9), 0.13, "rx rz", "left_ankle"),
    "ltoes": ("lfoot", (0, 0, 1), 0.06, "rx", "left_foot"),
    "rhipjoint": ("root", (-0.085, -0.08, 0.0), 0.117, "", None),
    "rfemur": ("rhipjoint", (0, -1, 0), 0.38, "rx ry rz", "right_hip"),
    "rtibia": ("rfemur", (0, -1, 0), 0.40, "rx", "right_knee"),
    "rfoot": ("rtibia", (0, -0.4, 0.9), 0.13, "rx rz", "right_ankle"),
    "rtoes": ("rfoot", (0, 0, 1), 0.06, "rx", "right_foot"),
    "lowerback": ("root", (0, 1, 0), 0.12, "rx ry rz", "spine1"),
    "upperback": ("lowerback", (0, 1, 0), 0.12, "rx ry rz", "spine2"),
    "thorax": ("upperback", (0, 1, 0), 0.12, "rx ry rz", "spine3"),
    "lowerneck": ("thorax", (0, 1, 0), 0.1, "rx ry rz", "neck"),
    "head": ("lowerneck", (0, 1, 0), 0.1, "rx ry rz", "head"),
    "lclavicle": ("thorax", (1, 0, 0), 0.15, "ry rz", "left_collar"),
    "lhumerus": ("lclavicle", (1, 0, 0), 0.25, "rx ry rz", "left_shoulder"),
    "lradius": ("lhumerus", (1, 0, 0), 0.24, "rx", "left_elbow"),
    "lwrist": ("lradius", (1, 0, 0), 0.08, "ry", "left_wrist"),
    "rclavicle": ("thorax", (-1, 0, 0), 0.15, "ry rz", "right_collar"),
    "rhumerus": ("rclavicle", (-1, 0, 0), 0.25, "rx ry rz", "right_shoulder"),
    "rradius": ("rhumerus", (-1, 0, 0), 0.24, "rx", "right_elbow"),
    "rwrist": ("rradius", (-1, 0, 0), 0.08, "ry", "right_wrist"),
}

# CMU's unit: 1/0.45 inch.
ASF_UNIT = 0.0254 / 0.45


def asf_text(axes_deg: dict[str, np.ndarray]) -> str:
    """A skeleton whose bones turn about axes given by fixed XYZ angles [degrees]."""
    lines = ["# made by a test", ":version 1.10", ":name test", ":units", "  mass 1.0", "  length 0.45", "  angle deg"]
    lines += [
        ":root",
        "  order TX TY TZ RX RY RZ",
        "  axis XYZ",
        "  position 0 0 0",
        "  orientation 0 0 0",
        ":bonedata",
    ]
    for index, (name, (_, direction, length, dof, _)) in enumerate(ASF_BONES.items(), 1):
        along = np.array(direction) / np.linalg.norm(direction)
        lines += ["  begin", f"    id {index}", f"    name {name}"]
        lines.append("    direction " + " ".join(f"{value:.9f}" for value in along))
        lines.append(f"    length {length / ASF_UNIT:.9f}")
        lines.append("    axis " + " ".join(f"{value:.9f}" for value in axes_deg[name]) + " XYZ")
        if dof:
            lines += [
                f"    dof {dof}",
                "    limits (-160.0 20.0)",
                *["           (-70.0 70.0)"] * (len(dof.split()) - 1),
            ]
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    for parent in ("root", *ASF_BONES):
        if children := [name for name, bone in ASF_BONES.items() if bone[0] == parent]:
            lines.append(f"    {parent} {' '.join(children)}")
    return "\n".join([*lines, "  end", ""])


def amc_text(root: np.ndarray, root_deg: np.ndarray, angles_deg: dict[str, np.ndarray]) -> str:
    """Frames of root positions [file units], root angles and each bone's angles (F, dof) [degrees]."""
    lines = ["#!OML:ASF test", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(len(root)):
        lines.append(str(frame + 1))
        lines.append("root " + " ".join(f"{value:.9f}" for value in [*root[frame], *root_deg[frame]]))
        lines += [f"{name} " + " ".join(f"{value:.9f}" for value in rows[frame]) for name, rows in angles_deg.items()]
    return "\n".join(lines) + "\n"
