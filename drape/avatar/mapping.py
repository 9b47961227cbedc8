"""Which nodes of a character are which joints: by VRM's bones, by names, or by positions where the names are
unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drape.avatar.character import Character
from drape.avatar.shape_joints import hanging_on, joints_by_shape
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MotionError, NotFound, did_you_mean
from drape.geometry.rotations import matrix_to_quaternion
from drape.motion.joint_names import is_whole, match_joints
from drape.motion.node_clip import nearest_rotations
from drape.motion.rig_poses import Rig

VRM, NAMES, SHAPE, TOLD = "vrm", "names", "shape", "told"
SWAPPED = "left and right look swapped: by these joints the feet point backwards"


@dataclass(frozen=True, eq=False)
class JointMapping:
    """The ``rig`` of a character, and how its joints were found.

    ``by`` is "vrm", "names", "shape" (by positions), or "told" by a client. ``confidence`` in [0, 1]: where joints were
    found by positions, how much these are like a person's; otherwise 1. ``notes`` are sentences on what looks wrong.
    """

    rig: Rig
    by: str
    confidence: float = 1.0
    notes: tuple[str, ...] = ()


def map_joints(
    character: Character, body: BodyModel, *, joints: Mapping[str, str] | None = None, label: str = "avatar"
) -> JointMapping:
    """Returns the rig of ``character`` for poses of ``body``. Its joints are found by VRM's bones where the file has
    them, else by names, else by their positions.

    ``joints`` are names of nodes by SMPL's names of joints, which a client sets where they are found wrong. ``label``
    names the character in refusals. Raises ``MotionError`` where the nodes are no person's, ``NotFound`` for a name in
    ``joints`` that does not exist.
    """
    names = list(character.names)
    if character.humanoid:
        bones = {place: bone for bone, place in character.humanoid.items()}
        names = [bones.get(place, f"node {place}") for place in range(len(names))]
    sources, by, confidence = _places(character, joints or {}, label), TOLD, 1.0
    if not is_whole(sources):
        try:
            matched, by = match_joints(names, character.parents, label=label), VRM if character.humanoid else NAMES
        except MotionError:
            shape = joints_by_shape(character, label=label)
            matched, by, confidence = shape.sources, SHAPE, shape.confidence
        sources = {**matched, **sources}
    turns = nearest_rotations(character.world[:, :3, :3])
    local, moves = turns.copy(), character.places.copy()
    for node, parent in enumerate(character.parents):
        if parent >= 0:
            local[node] = turns[parent].T @ turns[node]
            moves[node] = turns[parent].T @ (character.places[node] - character.places[parent])
    quaternions = matrix_to_quaternion(local)
    rig = Rig(names, character.parents, quaternions, moves, body.joints_template, label, sources)
    return JointMapping(rig, by, confidence, (SWAPPED,) if _feet_point_back(rig, character) else ())


def _feet_point_back(rig: Rig, character: Character) -> bool:
    """Whether the skin of both feet lies behind their ankles, as joints that are called left and right tell front."""
    ahead = rig.alignment[0][:, 2]
    for side in ("left", "right"):
        ankle = rig.sources[f"{side}_ankle"]
        share = np.asarray(character.weights[:, np.flatnonzero(hanging_on(rig.parents, ankle))].sum(axis=1)).reshape(-1)
        sole = character.vertices[share > 0.5]
        if not len(sole) or (sole.mean(axis=0) - character.places[ankle]) @ ahead >= 0.0:
            return False
    return True


def _places(character: Character, joints: Mapping[str, str], label: str) -> dict[str, int]:
    """Indices of the nodes whose names ``joints`` has, by SMPL's names of joints."""
    for joint, name in joints.items():
        if joint not in JOINT_NAMES:
            known, cure = ", ".join(JOINT_NAMES), did_you_mean(joint, JOINT_NAMES, "Correct the name.")
            raise NotFound(f"{label}: joint", expected=f"one of {known}", got=joint[:40], cure=cure)
        if name not in character.names:
            near, cure = ", ".join(character.names[:40]), did_you_mean(name, character.names, "Correct the name.")
            raise NotFound(f"{label}: {joint}", expected=f"a node: {near}", got=name[:60], cure=cure)
    return {joint: character.names.index(name) for joint, name in joints.items()}
