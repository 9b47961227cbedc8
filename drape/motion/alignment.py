"""How a skeleton's rest pose differs from the T-pose: the rotations that bring the T-pose onto it.

Skeletons rest in a T-pose, an A-pose, or in a frame of their own. Joint j's rotation
``A_j`` is the least turn, seen from the parent's ``A``, that lays j's T-pose bone on
the skeleton's rest bone. A world rotation ``D_j`` from the rest pose on is then
``D_j A_j`` from the T-pose on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import cross, rotvec_to_matrix
from drape.motion.t_pose import BONE_CHILD

# The direction from the ankle to the ball of a foot that stands flat.
SLOPING_FOOT = np.array([0.0, -0.416, 0.909])

# A foot whose rest direction is this steep (horizontal share) has no heading.
_STEEP_FOOT = 0.3

# Pelvis and shin that stand farther [rad] apart do not stand on one floor; a foot that is turned farther turns its leg.
_FLOOR_ANGLE = 0.7

# Arms whose line is this steep on the chest (share across) do not tell where its left is.
_STEEP_ARMS = 0.3

# Below this sine [rad] two directions count as one line: a turn has no axis there.
_ON_ONE_LINE = 1e-9


def rest_alignment(
    rest: np.ndarray,
    sources: Mapping[str, int],
    *,
    directions: Mapping[str, Sequence[float] | np.ndarray],
    label: str,
    ends: Mapping[str, str] = BONE_CHILD,
    up: np.ndarray | None = None,
    across: np.ndarray | None = None,
) -> np.ndarray:
    """Returns the rotations ``A`` (24, 3, 3) that bring the T-pose onto the rest pose with the joints' positions
    ``rest`` (J, 3), joint by joint.

    ``sources`` has the index of each SMPL joint that the skeleton has, ``ends`` the name of the joint that its bone
    points to, and ``directions`` the bone's direction in the T-pose. A joint without one of them keeps its parent's
    ``A``.

    The pelvis follows the line of the hips and ``up`` (3,), which is the trunk's line if it is not given. Hips on that
    line are refused (``MotionError``, which names ``label``). The chest turns about its own bone until its left lies
    along ``across`` (3,), the line from right to left arm. A leg whose foot does not point ahead turns about its own
    bone with the foot.
    """
    alignment = np.empty((JOINT_COUNT, 3, 3))
    alignment[0] = _pelvis_frame(rest, sources, up, label)
    for joint, joint_name in enumerate(JOINT_NAMES[1:], 1):
        from_parent = alignment[PARENTS[joint]]
        bone = rest_bone(rest, sources, joint_name, ends)
        if bone is None or joint_name not in directions:
            alignment[joint] = from_parent
            continue
        direction = np.array(directions[joint_name])
        if joint_name.endswith("ankle"):
            floor, toes = alignment[0], from_parent.T @ bone
            if _STEEP_FOOT < np.hypot(toes[0], toes[2]) > toes[2] / np.cos(_FLOOR_ANGLE):
                leg = [PARENTS[PARENTS[joint]], PARENTS[joint]]
                alignment[leg] = alignment[leg] @ rotvec_to_matrix(np.arctan2(toes[0], toes[2]) * np.eye(3)[1])
                floor = from_parent = alignment[leg[1]]
            from_parent, direction, bone = _foot(floor, from_parent, direction, bone)
        alignment[joint] = least_turn(from_parent @ direction, bone, from_parent) @ from_parent
        if joint_name == "spine3" and across is not None:
            chest = alignment[joint][:, 1]
            left = across - (across @ chest) * chest
            if np.linalg.norm(left) > _STEEP_ARMS * np.linalg.norm(across):
                alignment[joint] = _frame(left, chest)
    for joint_name in ("spine1", "spine2"):  # A trunk of one node turns as one, with the twist of the chest.
        if "spine3" in sources and sources.get(joint_name) == sources["spine3"]:
            alignment[JOINT_NAMES.index(joint_name)] = alignment[JOINT_NAMES.index("spine3")]
    return alignment


def world_joint_rotations(rotations: np.ndarray, sources: Mapping[str, int], alignment: np.ndarray) -> np.ndarray:
    """Returns the world rotations (F, 24, 3, 3) that turn the SMPL joints from the T-pose to each frame. ``rotations``
    (F, J, 3, 3) are those that turn the skeleton's J joints from its rest pose to each frame. ``sources`` and
    ``alignment`` (24, 3, 3) are those of ``rest_alignment``.

    A joint that is not in ``sources`` goes with its parent.
    """
    turned = np.empty((len(rotations), JOINT_COUNT, 3, 3))
    for joint, joint_name in enumerate(JOINT_NAMES):
        if joint_name in sources:
            turned[:, joint] = rotations[:, sources[joint_name]] @ alignment[joint]
        else:
            turned[:, joint] = turned[:, PARENTS[joint]]
    return turned


def rest_bone(
    rest: np.ndarray, sources: Mapping[str, int], joint_name: str, ends: Mapping[str, str] = BONE_CHILD
) -> np.ndarray | None:
    """Returns the unit direction (3,) of the bone of joint ``joint_name`` at the positions ``rest`` (J, 3); None where
    the skeleton has no such bone, or it has no length."""
    child = ends.get(joint_name)
    if child is None or joint_name not in sources or child not in sources:
        return None
    bone = rest[sources[child]] - rest[sources[joint_name]]
    length = np.linalg.norm(bone)
    return bone / length if length > 1e-9 else None


def least_turn(start: np.ndarray, end: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Returns the smallest rotations (..., 3, 3) that turn unit vectors ``start`` (..., 3) to ``end`` (..., 3).

    A half turn may have any axis square to ``start``. It gets the one nearest to the first column of ``frame`` (..., 3,
    3), or to the third where the first is nearly parallel to ``start``.
    """
    axis = cross(start, end)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = np.sum(start * end, axis=-1, keepdims=True)
    lined = sine < _ON_ONE_LINE
    turn = np.arctan2(sine, cosine) * axis / np.where(lined, 1.0, sine)
    first, third = frame[..., :, 0], frame[..., :, 2]
    beside = np.abs(np.sum(first * start, axis=-1, keepdims=True)) < 0.9
    side = np.where(beside, first, third)
    side = side - np.sum(side * start, axis=-1, keepdims=True) * start
    half_turn = np.pi * side / np.linalg.norm(side, axis=-1, keepdims=True)
    return rotvec_to_matrix(np.where(lined, np.where(cosine > 0.0, 0.0, half_turn), turn))


def _pelvis_frame(rest: np.ndarray, sources: Mapping[str, int], up: np.ndarray | None, label: str) -> np.ndarray:
    """Left, up and forward of the hips and the trunk, as columns (3, 3)."""
    left = rest[sources["left_hip"]] - rest[sources["right_hip"]]
    trunk = rest[sources["neck" if "neck" in sources else "spine3"]] - rest[sources["pelvis"]] if up is None else up
    area = np.cross(left, trunk)
    if np.linalg.norm(area) < 1e-6 * np.linalg.norm(left) * np.linalg.norm(trunk) or not area.any():
        raise MotionError(
            f"{label}: skeleton",
            expected="hips beside a trunk",
            got="hips and trunk on one line",
            cure="Export the skeleton with its rest offsets.",
        )
    return _frame(left, trunk)


def _frame(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Columns (3, 3): ``left``, what is up beside it, and forward."""
    forward = np.cross(left, up)
    left, forward = left / np.linalg.norm(left), forward / np.linalg.norm(forward)
    return np.stack([left, np.cross(forward, left), forward], axis=-1)


def _foot(
    pelvis: np.ndarray, shin: np.ndarray, direction: np.ndarray, bone: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame, direction and bone to compare for a foot: its heading, the sole being flat in both rest poses."""
    floor = pelvis if pelvis[:, 1] @ shin[:, 1] > np.cos(_FLOOR_ANGLE) else shin
    level = bone - (bone @ floor[:, 1]) * floor[:, 1]
    length = np.linalg.norm(level)
    if length > _STEEP_FOOT:
        heading = direction * [1.0, 0.0, 1.0]
        return floor, heading / np.linalg.norm(heading), level / length
    return shin, SLOPING_FOOT, bone
