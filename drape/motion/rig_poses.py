"""Poses of any avatar's rig as SMPL poses, and SMPL poses on any rig.

A node's local rotation is relative to its parent, in axes that its maker chose. With ``W`` the world rotations of the
rest pose, ``P`` that of the parent and ``R_rest`` the node's own local rest rotation, ``q_local = P^-1 q_norm P
R_rest``: ``q_norm`` is what the joint turns by in the world's axes, zero in the rest pose. A rig that rests in an
A-pose has a ``q_norm`` of zero there, so the turns from the T-pose to its rest pose are measured on its bones and taken
out (``drape.motion.alignment``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import (
    matrix_to_quaternion,
    matrix_to_rotvec,
    quaternion_slerp,
    quaternion_to_matrix,
    rotvec_to_matrix,
)
from drape.motion.alignment import rest_alignment, rest_bone, world_joint_rotations
from drape.motion.joint_names import ancestors, is_whole, match_joints
from drape.motion.legs import SIDES
from drape.motion.retarget import global_rotations, local_rotations
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX

# A quaternion may be off unit length by float32's rounding and by a file's decimals.
UNIT_TOLERANCE = 1e-3

# The bones that are measured, by the joints at their ends. Only limbs are: where a rig puts the joints of its trunk
# tells how its bones lean, and not how the person stands. So do knees a little before the line from hip to ankle.
_MEASURED = {
    f"{side}_{start}": f"{side}_{end}"
    for side in SIDES
    for start, end in (("hip", "ankle"), ("ankle", "foot"), ("shoulder", "elbow"), ("elbow", "wrist"))
}

# A trunk that leans farther [rad] than this from every axis of the world does not stand in its rest pose.
_LEANING_TRUNK = 0.35

# Joints that a rig may merge or lack: what lies between the ends is spread evenly over them.
_SPREAD = (("pelvis", "spine1", "spine2", "spine3"), ("spine3", "neck", "head"))


@dataclass(frozen=True, eq=False)
class Rig:
    """A skeleton of J nodes, parents before children; its rest pose is a T-pose or an A-pose.

    ``parents`` (J,) are indices, -1 for a root. ``rest_rotations`` (J, 4), unit quaternions wxyz, and
    ``rest_translations`` (J, 3), in any unit of length, are relative to the parent. ``names`` are those that
    ``match_joints`` reads; other nodes keep their rest pose. ``nodes`` has indices of nodes by the SMPL names of their
    joints, which go before ``names``; where it has all joints that a person needs, no name is read. ``t_pose_joints``
    [m] (24, 3) are the rest joints of the body that the SMPL poses are for.

    The rig's world is the poses' world: y up, whatever way the rig faces. Raises ``MotionError`` for arrays that do not
    fit, and for names of no person.
    """

    names: Sequence[str]
    parents: Sequence[int]
    rest_rotations: np.ndarray
    rest_translations: np.ndarray
    t_pose_joints: np.ndarray = field(default_factory=lambda: CANONICAL_JOINTS)
    label: str = "rig"
    nodes: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.names)
        if len(self.parents) != count or any(not -1 <= parent < node for node, parent in enumerate(self.parents)):
            raise MotionError(
                f"{self.label}: parents",
                expected=f"{count} indices, each below its own node's, or -1",
                got=f"{len(self.parents)}: {list(self.parents)[:40]}",
                cure="Sort the nodes so that parents come before their children.",
            )
        object.__setattr__(self, "parents", tuple(int(parent) for parent in self.parents))
        object.__setattr__(self, "rest_rotations", _unit_quaternions("rest_rotations", self.rest_rotations, (count, 4)))
        for name, shape in (("rest_translations", (count, 3)), ("t_pose_joints", (JOINT_COUNT, 3))):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            check_shape(name, array, shape, error=MotionError)
            check_finite(name, array, error=MotionError)
            object.__setattr__(self, name, array)
        _ = self.alignment  # This refuses a rig of no person at once.

    @cached_property
    def sources(self) -> dict[str, int]:
        """The index of the node of each SMPL joint that the rig has, by the joint's name."""
        if is_whole(self.nodes):
            return dict(self.nodes)
        return {**match_joints(self.names, self.parents, label=self.label), **self.nodes}

    @cached_property
    def rest_world(self) -> np.ndarray:
        """The world rotations ``W`` (J, 3, 3) of the nodes in the rest pose."""
        return global_rotations(quaternion_to_matrix(self.rest_rotations)[None], self.parents)[0]

    @cached_property
    def rest_positions(self) -> np.ndarray:
        """The world positions (J, 3) of the nodes in the rest pose, in the rig's unit."""
        positions = np.array(self.rest_translations)
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                positions[node] = positions[parent] + self.rest_world[parent] @ positions[node]
        return positions

    @cached_property
    def alignment(self) -> np.ndarray:
        """The rotations ``A`` (24, 3, 3) that bring the body's T-pose onto the rig's rest pose, joint by joint."""
        bones = {joint: rest_bone(self.t_pose_joints, JOINT_INDEX, joint, _MEASURED) for joint in _MEASURED}
        alignment = rest_alignment(
            self.rest_positions,
            self.sources,
            directions={joint: bone for joint, bone in bones.items() if bone is not None},
            label=self.label,
            ends=_MEASURED,
            up=_up(self.rest_positions, self.sources),
        )
        for side in SIDES:
            if f"{side}_foot" not in self.sources:  # The sole of a foot without toes is level, however the leg stands.
                alignment[JOINT_INDEX[f"{side}_ankle"]] = alignment[JOINT_INDEX[f"{side}_foot"]] = alignment[0]
        return alignment


def rig_to_poses(rig: Rig, quaternions: np.ndarray) -> np.ndarray:
    """Returns the SMPL poses (F, 24, 3) [rad] of a rig whose nodes have the local rotations ``quaternions`` (F, J, 4),
    wxyz. Raises ``MotionError`` for arrays of other shapes and quaternions of another length than one.

    Joints that the rig lacks are straight, but a trunk or a neck of fewer joints is spread over ours.
    """
    quaternions = _unit_quaternions("quaternions", quaternions, (None, len(rig.names), 4))
    world = global_rotations(quaternion_to_matrix(quaternions), rig.parents)
    turned = world_joint_rotations(world @ np.swapaxes(rig.rest_world, -1, -2), rig.sources, rig.alignment)
    _spread(turned, rig.sources)
    return matrix_to_rotvec(local_rotations(turned, PARENTS))


def poses_to_rig(rig: Rig, poses: np.ndarray) -> np.ndarray:
    """Returns the local rotations of a rig's nodes, unit quaternions wxyz (F, J, 4) with w >= 0, that show SMPL
    ``poses`` (F, 24, 3) [rad].

    Each joint's node takes the joint's world rotation, so that joints which the rig lacks are made up for by those
    above them. All other nodes keep their rest rotation.
    """
    poses = np.asarray(poses, dtype=np.float64)
    check_shape("poses", poses, (None, JOINT_COUNT, 3), error=MotionError)
    check_finite("poses", poses, error=MotionError)
    turned = global_rotations(rotvec_to_matrix(poses), PARENTS)
    # Of several joints on one node the one farthest from the pelvis counts, since the arms hang on it.
    joint_of = {rig.sources[name]: joint for joint, name in enumerate(JOINT_NAMES) if name in rig.sources}
    joint_of.setdefault(carrier(rig), 0)
    rest = quaternion_to_matrix(rig.rest_rotations)
    world = np.empty((len(poses), len(rig.names), 3, 3))
    for node, parent in enumerate(rig.parents):
        if node in joint_of:
            joint = joint_of[node]
            world[:, node] = turned[:, joint] @ rig.alignment[joint].T @ rig.rest_world[node]
        else:
            world[:, node] = rest[node] if parent < 0 else world[:, parent] @ rest[node]
    return matrix_to_quaternion(local_rotations(world, rig.parents))


def _up(rest: np.ndarray, sources: dict[str, int]) -> np.ndarray:
    """The world's axis (3,) that a trunk stands along, since it leans by its build; its own line if it lies askew."""
    left, right = (rest[sources[f"{side}_shoulder"]] - rest[sources[f"{side}_hip"]] for side in SIDES)
    trunk = left + right
    axis = np.zeros(3)
    axis[np.abs(trunk).argmax()] = np.sign(trunk[np.abs(trunk).argmax()])
    return axis if trunk @ axis > np.cos(_LEANING_TRUNK) * np.linalg.norm(trunk) else trunk


def carrier(rig: Rig) -> int:
    """Returns the index of the node that carries both legs and trunk: the pelvis, or the one above it where a rig
    branches there."""
    trunk, line = (ancestors(rig.parents, rig.sources[joint]) for joint in ("spine1", "pelvis"))
    return next((node for node in line if node in trunk), line[-1])


def _spread(turned: np.ndarray, sources: dict[str, int]) -> None:
    """Lets joints without a node of their own turn evenly from the joint below them to the one above, in place."""
    for chain in _SPREAD:
        nodes = [sources.get(name) for name in chain]
        # A joint is known if it has a node, and is the last of those that share it.
        known = [k for k, node in enumerate(nodes) if k == 0 or (node is not None and node not in nodes[k + 1 :])]
        for start, end in pairwise(known):
            first, last = (matrix_to_quaternion(turned[:, JOINT_INDEX[chain[k]]]) for k in (start, end))
            for k in range(start + 1, end):
                share = np.full(len(turned), (k - start) / (end - start))
                turned[:, JOINT_INDEX[chain[k]]] = quaternion_to_matrix(quaternion_slerp(first, last, share))


def _unit_quaternions(name: str, value: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray:
    """``value`` as float64 of ``shape``, each quaternion brought to length one."""
    array = np.asarray(value, dtype=np.float64)
    check_shape(name, array, shape, error=MotionError)
    check_finite(name, array, error=MotionError)
    lengths = np.linalg.norm(array, axis=-1, keepdims=True)
    if np.abs(lengths - 1.0).max(initial=0.0) > UNIT_TOLERANCE:
        raise MotionError(
            name,
            expected="unit quaternions wxyz",
            got=f"lengths from {lengths.min():.4g} to {lengths.max():.4g}",
            cure="Pass rotations without scale, scalar first.",
        )
    return array / lengths
