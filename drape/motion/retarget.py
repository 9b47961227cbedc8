"""Any humanoid skeleton's rotations onto the 24 SMPL joints.

A file turns its bones from a rest pose of its own. Each SMPL joint j takes the
global rotation of its source joint after the rotation ``A_j`` that brings the
T-pose onto the file's rest pose (``drape.motion.alignment``): ``G_j = R_source A_j``.
Bone directions are then the file's, exactly; twist about a
bone is the file's when its rest pose is anatomical (T, A or arms down).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import matrix_to_quaternion, matrix_to_rotvec, quaternion_to_matrix, rotvec_to_matrix
from drape.motion.alignment import SLOPING_FOOT, joint_rotations, rest_alignment, rest_bone
from drape.motion.amass import Y_FROM_Z
from drape.motion.clip import MotionClip
from drape.motion.joint_names import match_joints
from drape.motion.t_pose import BONE_CHILD, BONE_DIRECTIONS

LEG_LENGTH_RANGE = (0.45, 1.30)
"""Hip to ankle [m] of people from about 1.0 m to 2.6 m; outside it the unit is wrong."""

# Units of motion files [m]; the last is CMU's (1/0.45 inch).
_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45)
_ADULT_LEG_LENGTH = 0.80

# A rest bone farther than this [rad] from its T-pose direction means that the
# rest pose is no human pose (LAFAN lays all bones along x).
_FOLDED_ANGLE = 2.0


@dataclass(frozen=True)
class SourceSkeleton:
    """A file's joints in parent-first order; ``offsets`` (J, 3) from the parent in the rest pose, file units."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray

    def rest_positions(self) -> np.ndarray:
        positions = np.array(self.offsets, dtype=np.float64)
        positions[0] = 0.0
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[joint] += positions[parent]
        return positions


def global_rotations(local_rotations: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """World rotations (F, J, 3, 3) of rotations relative to the parent."""
    rotations = np.array(local_rotations, dtype=np.float64)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            rotations[:, joint] = rotations[:, parent] @ rotations[:, joint]
    return rotations


def local_rotations(rotations: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Rotations relative to the parent (F, J, 3, 3) of world rotations: the inverse of ``global_rotations``."""
    local = np.array(rotations, dtype=np.float64)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = np.swapaxes(rotations[:, parent], -1, -2) @ rotations[:, joint]
    return local


def euler_to_matrix(angles_rad: np.ndarray, axes: str) -> np.ndarray:
    """``R_axes[0] R_axes[1] ...`` (..., 3, 3) of angles (..., n) about the axes, as "ZXY"."""
    matrix = np.broadcast_to(np.eye(3), (*angles_rad.shape[:-1], 3, 3))
    for column, axis in enumerate(axes):
        rotvec = np.zeros((*angles_rad.shape[:-1], 3))
        rotvec[..., "XYZ".index(axis)] = angles_rad[..., column]
        matrix = matrix @ rotvec_to_matrix(rotvec)
    return matrix


def retarget(
    skeleton: SourceSkeleton,
    rotations: np.ndarray,
    places: dict[int, np.ndarray],
    *,
    fps: float,
    name: str,
    metres_per_unit: float | None = None,
    up: str = "y",
) -> MotionClip:
    """The clip of world rotations (F, J, 3, 3) and of ``places``, in the file's unit.

    ``places`` holds the positions (F, 3), relative to the parent, of the joints that
    move; the root must be among them. ``metres_per_unit`` None guesses the unit from
    the length of the legs.
    """
    if up not in ("y", "z"):
        raise MotionError("up", expected="'y' or 'z'", got=repr(up), cure="Name the file's vertical axis.")
    sources = match_joints(skeleton.names, skeleton.parents, label=name)
    rest = skeleton.rest_positions()
    scale = _scale(rest, sources, metres_per_unit, name)
    alignment = rest_alignment(rest, sources, directions=BONE_DIRECTIONS, label=name)
    world = Y_FROM_Z if up == "z" else np.eye(3)
    turned = joint_rotations(world @ rotations, sources, alignment)
    if _is_folded(rest, sources, alignment[0]):
        _centre_twist(turned, sources)
    local = local_rotations(turned, PARENTS)
    pelvis = _path(skeleton, rotations, places, sources["pelvis"])
    return MotionClip(poses=matrix_to_rotvec(local), trans=scale * pelvis @ world.T, fps=fps, name=name)


def _path(skeleton: SourceSkeleton, rotations: np.ndarray, places: dict[int, np.ndarray], joint: int) -> np.ndarray:
    """World positions (F, 3) of a joint."""
    parent = skeleton.parents[joint]
    if parent < 0:
        return places[joint]
    offset = places[joint] if joint in places else skeleton.offsets[joint]
    turned = (rotations[:, parent] @ np.broadcast_to(offset, (len(rotations), 3))[..., None])[..., 0]
    return _path(skeleton, rotations, places, parent) + turned


def _scale(rest: np.ndarray, sources: dict[str, int], metres_per_unit: float | None, name: str) -> float:
    hip, knee, ankle = (rest[sources[f"left_{joint}"]] for joint in ("hip", "knee", "ankle"))
    leg = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
    units = _UNITS if metres_per_unit is None else (metres_per_unit,)
    scale = min(units, key=lambda unit: abs(np.log(max(leg * unit, 1e-12) / _ADULT_LEG_LENGTH)))
    low, high = LEG_LENGTH_RANGE
    if not low <= leg * scale <= high:
        raise MotionError(
            f"{name}: skeleton",
            expected=f"legs of {low} to {high} m",
            got=f"{leg * scale:.4g} m ({leg:.4g} units)",
            cure="Pass metres_per_unit, the length of the file's unit.",
        )
    return scale


def _is_folded(rest: np.ndarray, sources: dict[str, int], pelvis: np.ndarray) -> bool:
    for joint_name, direction in BONE_DIRECTIONS.items():
        bone = rest_bone(rest, sources, joint_name)
        if bone is not None and (pelvis @ np.array(direction)) @ bone < np.cos(_FOLDED_ANGLE):
            return True
    return False


def _centre_twist(turned: np.ndarray, sources: dict[str, int]) -> None:
    """Turn each limb about its own bone until its mean twist over the clip is zero.

    A folded rest pose does not say how a limb is twisted; people's limbs keep to
    the middle of their range.
    """
    for joint, joint_name in enumerate(JOINT_NAMES):
        limb = joint_name.startswith(("left_", "right_")) and joint_name in BONE_CHILD
        if not limb or joint_name not in sources:
            continue
        axis = SLOPING_FOOT if joint_name.endswith("ankle") else np.array(BONE_DIRECTIONS[joint_name])
        quaternions = matrix_to_quaternion(np.swapaxes(turned[:, PARENTS[joint]], -1, -2) @ turned[:, joint])
        twist = np.stack([quaternions[:, 0], quaternions[:, 1:] @ axis], axis=-1)
        # Twists are half angles of either sign: their mean is that of the doubled angles.
        doubled = (twist[:, 0] + 1j * twist[:, 1]) ** 2
        half = np.angle(doubled.sum()) / 2.0
        undo = quaternion_to_matrix(np.concatenate([[np.cos(half)], -np.sin(half) * axis]))
        turned[:, joint] = turned[:, joint] @ undo
        for leaf in range(joint + 1, JOINT_COUNT):
            if PARENTS[leaf] != joint:
                continue
            if JOINT_NAMES[leaf] not in sources:
                turned[:, leaf] = turned[:, joint]
            elif JOINT_NAMES[leaf] not in BONE_CHILD:
                turned[:, leaf] = turned[:, leaf] @ undo  # it shares its parent's alignment
