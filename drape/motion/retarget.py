"""Any humanoid skeleton's rotations onto the 24 SMPL joints.

A file turns its bones from a rest pose of its own. Each SMPL joint j takes the
global rotation of its source joint after the rotation ``A_j`` that brings the
T-pose onto the file's rest pose (``drape.motion.alignment``): ``G_j = R_source A_j``.
Bone directions are then the file's, exactly; twist about a
bone is the file's when its rest pose is anatomical (T, A or arms down), and else
what ``drape.motion.odd_rest`` finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.body.skeleton import PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.alignment import least_turn, rest_alignment, world_joint_rotations
from drape.motion.clip import MotionClip
from drape.motion.joint_names import match_joints
from drape.motion.odd_rest import arms_across, keep_mean_twists, odd_limbs, tips_of, trunk_ends, turn_tips
from drape.motion.t_pose import BONE_CHILD, BONE_DIRECTIONS, JOINT_INDEX

LEG_LENGTH_RANGE = (0.45, 1.30)
"""Hip to ankle [m] of people from about 1.0 m to 2.6 m; outside it the unit is wrong."""

# Units of motion files [m]; the last is CMU's (1/0.45 inch).
_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45)
_ADULT_LEG_LENGTH = 0.80

_AXES = {sign + axis: np.eye(3)["xyz".index(axis)] * float(f"{sign}1") for sign in ("", "-") for axis in "yzx"}
# What speaks for an axis to be up beside people's standing along it: that it is y, that the skeleton rests along it,
# that feet stand at its zero. Feet outweigh either of the others, since a lying person has them there by chance only.
_HABIT, _RESTS, _STANDS = 1.0, 1.1, 1.3
_NEAR_FLOOR = 0.2  # Ankles that stand are at most so high [m].


@dataclass(frozen=True)
class SourceSkeleton:
    """A file's joints, parents before children. ``parents`` are indices, -1 for the root, and ``offsets`` (J, 3) are
    from the parent in the rest pose, in the file's unit."""

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
    """Returns the world rotations (F, J, 3, 3) of joints whose rotations relative to the parent are ``local_rotations``
    (F, J, 3, 3). ``parents`` come before their children."""
    rotations = np.array(local_rotations, dtype=np.float64)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            rotations[:, joint] = rotations[:, parent] @ rotations[:, joint]
    return rotations


def local_rotations(rotations: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Returns the rotations relative to the parent (F, J, 3, 3) of joints whose world rotations are ``rotations``
    (F, J, 3, 3): the inverse of ``global_rotations``."""
    local = np.array(rotations, dtype=np.float64)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = np.swapaxes(rotations[:, parent], -1, -2) @ rotations[:, joint]
    return local


def euler_to_matrix(angles_rad: np.ndarray, axes: str) -> np.ndarray:
    """Returns the products ``R_axes[0] R_axes[1] ...`` (..., 3, 3) of rotations by ``angles_rad`` (..., n) about n
    ``axes``, such as "ZXY"."""
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
    up: str | None = None,
    any_size: bool = False,
) -> MotionClip:
    """Returns the clip, on the 24 SMPL joints and in metres, of a ``skeleton`` whose joints have the world
    ``rotations`` (F, J, 3, 3) from its rest pose on.

    ``places`` has the positions (F, 3), relative to the parent and in the file's unit, of the joints that move, by
    their indices; the root must be among them. ``metres_per_unit`` None guesses the unit from the length of the legs,
    ``up`` None the vertical axis by how the person stands. Where no unit makes the legs a person's, a figure of
    ``any_size`` walks as far as an adult whose legs turn so. Raises ``MotionError`` for any other figure, and for
    joints of no person.
    """
    if up is not None and up not in _AXES:
        raise MotionError("up", expected=f"one of {', '.join(_AXES)}", got=repr(up), cure="Name the vertical axis.")
    sources = match_joints(skeleton.names, skeleton.parents, label=name)
    rest = skeleton.rest_positions()
    scale = _scale(rest, sources, metres_per_unit, name, any_size=any_size)
    ends, pelvis_up = trunk_ends(rest, skeleton.parents, sources)
    alignment = rest_alignment(
        rest,
        {**sources, **{f"{joint} end": end for joint, end in ends.items()}},
        directions=BONE_DIRECTIONS,
        label=name,
        ends={**BONE_CHILD, **{joint: f"{joint} end" for joint in ends}},
        up=pelvis_up,
        across=arms_across(rest, sources),
    )
    pelvis, *feet, top = (
        _path(skeleton, rotations, places, sources[joint])
        for joint in ("pelvis", "left_ankle", "right_ankle", "neck" if "neck" in sources else "spine3")
    )
    vertical = _AXES[up] if up else _find_up(0.5 * scale * (feet[0] + feet[1]), scale * top, alignment)
    world = least_turn(vertical, _AXES["y"], np.eye(3))
    turned = world_joint_rotations(world @ rotations, sources, alignment)
    odd = odd_limbs(rest, sources, alignment)
    tips = turn_tips(turned, tips_of(rest, skeleton.parents, sources), alignment, odd)
    keep_mean_twists(turned, sources, alignment, odd, tips)
    local = local_rotations(turned, PARENTS)
    return MotionClip(poses=matrix_to_rotvec(local), trans=scale * pelvis @ world.T, fps=fps, name=name)


def _find_up(feet: np.ndarray, top: np.ndarray, alignment: np.ndarray) -> np.ndarray:
    """The file's axis (3,) that is up, by the places (F, 3) [m] between the feet and of the neck, and by the rest."""
    lines = top - feet
    standing = np.mean(lines / np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-9), axis=0)
    resting = alignment[[0, JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]], :, 1]

    def weight(axis: np.ndarray) -> float:
        stands = standing @ axis > 0.8 and np.abs(np.median(feet @ axis)) < _NEAR_FLOOR
        rests = (resting @ axis > 0.8).all()
        return standing @ axis + _HABIT * axis[1] + _RESTS * rests + _STANDS * stands

    return max(_AXES.values(), key=weight)


def _path(skeleton: SourceSkeleton, rotations: np.ndarray, places: dict[int, np.ndarray], joint: int) -> np.ndarray:
    """World positions (F, 3) of a joint."""
    parent = skeleton.parents[joint]
    if parent < 0:
        return places[joint]
    offset = places[joint] if joint in places else skeleton.offsets[joint]
    turned = (rotations[:, parent] @ np.broadcast_to(offset, (len(rotations), 3))[..., None])[..., 0]
    return _path(skeleton, rotations, places, parent) + turned


def _scale(
    rest: np.ndarray, sources: dict[str, int], metres_per_unit: float | None, name: str, *, any_size: bool
) -> float:
    hip, knee, ankle = (rest[sources[f"left_{joint}"]] for joint in ("hip", "knee", "ankle"))
    leg = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
    units = _UNITS if metres_per_unit is None else (metres_per_unit,)
    scale = min(units, key=lambda unit: abs(np.log(max(leg * unit, 1e-12) / _ADULT_LEG_LENGTH)))
    low, high = LEG_LENGTH_RANGE
    if not low <= leg * scale <= high:
        if any_size and leg > 0.0:
            return _ADULT_LEG_LENGTH / leg
        raise MotionError(
            f"{name}: skeleton",
            expected=f"legs of {low} to {high} m",
            got=f"{leg * scale:.4g} m ({leg:.4g} units)",
            cure="Pass metres_per_unit, the length of the file's unit.",
        )
    return scale
