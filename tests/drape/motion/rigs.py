"""Our own body's skeleton as somebody else's rig: other names, axes of its own, an A-pose, joints left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from drape.body.skeleton import PARENTS
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.motion.rig_poses import Rig
from tests.drape.motion.motion_files import BODY

_PARTS = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")

# Names of the trunk, then of the left and of the right side's parts; {} is the side.
_NAMES = {
    "vrm": (
        "hips spine chest upperChest neck head",
        "{}UpperLeg {}LowerLeg {}Foot {}Toes {}Shoulder {}UpperArm {}LowerArm {}Hand",
        ("left", "right"),
    ),
    "vroid": (
        "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head",
        "J_Bip_{0}_UpperLeg J_Bip_{0}_LowerLeg J_Bip_{0}_Foot J_Bip_{0}_ToeBase J_Bip_{0}_Shoulder J_Bip_{0}_UpperArm "
        "J_Bip_{0}_LowerArm J_Bip_{0}_Hand",
        ("L", "R"),
    ),
    "mixamo": (
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head",
        "mixamorig:{0}UpLeg mixamorig:{0}Leg mixamorig:{0}Foot mixamorig:{0}ToeBase mixamorig:{0}Shoulder "
        "mixamorig:{0}Arm mixamorig:{0}ForeArm mixamorig:{0}Hand",
        ("Left", "Right"),
    ),
    "unreal": (
        "pelvis spine_01 spine_02 spine_03 neck_01 head",
        "thigh_{0} calf_{0} foot_{0} ball_{0} clavicle_{0} upperarm_{0} lowerarm_{0} hand_{0}",
        ("l", "r"),
    ),
    "rigify": (
        "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-spine.004 DEF-spine.006",
        "DEF-thigh.{0} DEF-shin.{0} DEF-foot.{0} DEF-toe.{0} DEF-shoulder.{0} DEF-upper_arm.{0} DEF-forearm.{0} "
        "DEF-hand.{0}",
        ("L", "R"),
    ),
    "character_creator": (
        "CC_Base_Hip CC_Base_Waist CC_Base_Spine01 CC_Base_Spine02 CC_Base_NeckTwist01 CC_Base_Head",
        "CC_Base_{0}_Thigh CC_Base_{0}_Calf CC_Base_{0}_Foot CC_Base_{0}_ToeBase CC_Base_{0}_Clavicle "
        "CC_Base_{0}_Upperarm CC_Base_{0}_Forearm CC_Base_{0}_Hand",
        ("L", "R"),
    ),
    "makehuman": (
        "root spine05 spine03 spine01 neck01 head",
        "upperleg01.{0} lowerleg01.{0} foot.{0} toe1-1.{0} clavicle.{0} upperarm01.{0} lowerarm01.{0} wrist.{0}",
        ("L", "R"),
    ),
    "biped": (
        "Bip001 Pelvis|Bip001 Spine|Bip001 Spine1|Bip001 Spine2|Bip001 Neck|Bip001 Head",
        "Bip001 {0} Thigh|Bip001 {0} Calf|Bip001 {0} Foot|Bip001 {0} Toe0|Bip001 {0} Clavicle|Bip001 {0} UpperArm|"
        "Bip001 {0} Forearm|Bip001 {0} Hand",
        ("L", "R"),
    ),
    "daz": (
        "hip abdomenLower chestLower chestUpper neckLower head",
        "{0}ThighBend {0}Shin {0}Foot {0}Toe {0}Collar {0}ShldrBend {0}ForearmBend {0}Hand",
        ("l", "r"),
    ),
    "mikumiku": (
        "Hips|Spine|Chest|Upper Chest|Neck|Head",
        "{0} leg|{0} knee|{0} ankle|{0} toe|{0} shoulder|{0} arm|{0} elbow|{0} wrist",
        ("Left", "Right"),
    ),
    "mikumiku_japanese": (
        "センター 上半身 上半身2 上半身3 首 頭",
        "{0}足 {0}ひざ {0}足首 {0}つま先 {0}肩 {0}腕 {0}ひじ {0}手首",
        "左右",
    ),
}
SCHEMES = tuple(_NAMES)


def rig_names(scheme: str) -> dict[str, str]:
    """The scheme's names of the 22 joints of a body."""
    trunk, limbs, sides = _NAMES[scheme]
    mark = "|" if "|" in trunk else " "
    table: dict[str, str] = dict(zip(_TRUNK, trunk.split(mark), strict=True))
    for side, written in zip(("left", "right"), sides, strict=True):
        parts = limbs.format(*[written] * limbs.count("{}") or [written]).split(mark)
        table |= {f"{side}_{part}": name for part, name in zip(_PARTS, parts, strict=True)}
    return table


def a_pose(arm_deg: float, leg_deg: float) -> np.ndarray:
    """Local rotations (22, 3, 3) of a rest pose with arms lowered and legs apart, the soles level."""
    turns = np.zeros((22, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns[BODY.index(f"{side}_shoulder"), 2] = -sign * np.radians(arm_deg)
        turns[BODY.index(f"{side}_hip"), 2] = sign * np.radians(leg_deg)
        turns[BODY.index(f"{side}_ankle"), 2] = -sign * np.radians(leg_deg)
    return rotvec_to_matrix(turns)


def rig_and_motion(
    joints: np.ndarray,
    local: np.ndarray,
    *,
    scheme: str,
    rest: np.ndarray,
    without: Sequence[str] = (),
    seed: int | None = None,
    turn: Sequence[float] = (0.0, 0.0, 0.0),
    **more,
) -> tuple[Rig, np.ndarray]:
    """A rig of rest joints (24, 3), and the local quaternions (F, J, 4) that show rotations ``local`` on it.

    ``local`` (F, 22 or more, 3, 3) turn joints relative to their parents. The rig rests as
    ``rest`` (22, 3, 3) turned by ``turn`` [rad]; ``seed`` draws axes of each node's own.
    Written from the definitions alone: a node turns from its rest as the joint does from
    the T-pose, less the joint's own turn from the T-pose to the rest. A rig whose trunk
    ends below spine3 turns that end as the chest.
    """
    kept = [joint for joint, name in enumerate(BODY) if name not in without]
    above = [_kept_ancestor(joint, kept) for joint in kept]
    turned, places = _turned_from_rest(joints[:22], local[:, :22], rest, rotvec_to_matrix(np.array(turn)))
    if "spine3" in without:
        turned[:, [3, 6]] = turned[:, [9]]
    axes = np.tile(np.eye(3), (22, 1, 1))
    if seed is not None:
        axes = Rotation.random(22, rng=np.random.default_rng(seed)).as_matrix()
    moved = turned @ axes
    inverse = [np.eye(3) if parent < 0 else axes[parent].T for parent in above]
    offsets = [
        places[joint] - (0.0 if parent < 0 else places[parent]) for joint, parent in zip(kept, above, strict=True)
    ]
    rig = Rig(
        names=[rig_names(scheme)[BODY[joint]] for joint in kept],
        parents=[-1 if parent < 0 else kept.index(parent) for parent in above],
        rest_rotations=matrix_to_quaternion(np.stack(inverse) @ axes[kept]),
        rest_translations=(np.stack(inverse) @ np.stack(offsets)[..., None])[..., 0],
        **more,
    )
    told = [
        moved[:, k] if p < 0 else np.swapaxes(moved[:, p], -1, -2) @ moved[:, k]
        for k, p in zip(kept, above, strict=True)
    ]
    return rig, matrix_to_quaternion(np.stack(told, axis=1))


def _turned_from_rest(
    joints: np.ndarray, local: np.ndarray, rest: np.ndarray, stance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (F, 22, 3, 3) from the rest pose on, and the joints' places (22, 3) in it."""
    rest_turned, places = forward_kinematics(rest, joints, PARENTS[:22])
    posed, _ = forward_kinematics(local, joints, PARENTS[:22])
    return posed @ np.swapaxes(stance @ rest_turned, -1, -2), places @ stance.T


def _kept_ancestor(joint: int, kept: Sequence[int]) -> int:
    above = PARENTS[joint]
    while above >= 0 and above not in kept:
        above = PARENTS[above]
    return above
