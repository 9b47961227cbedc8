"""Rigs of any names, axes and rest poses: their rotations are SMPL's and back, and what they lack is spread."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import (
    matrix_to_rotvec,
    quaternion_multiply,
    quaternion_to_matrix,
    rotvec_to_matrix,
    rotvec_to_quaternion,
)
from drape.motion.joint_names import match_joints
from drape.motion.retarget import global_rotations, local_rotations
from drape.motion.rig_poses import Rig, poses_to_rig, rig_to_poses
from drape.motion.samples import SAMPLES
from drape.motion.t_pose import CANONICAL_JOINTS
from tests.drape.motion.motion_files import BODY, t_pose_offsets
from tests.drape.motion.rigs import SCHEMES, a_pose, rig_and_motion, rig_names

# Some fifty products of unit quaternions and matrices in a row, each right to 1e-15.
EXACT = 1e-12
# The arc cosine of the angle between two rotations that are equal to EXACT.
EXACT_DEG = 1e-4
# Bones of our body's arms lie up to 0.04 degrees beside the x axis; two of them meet in a joint.
ASKEW_ARM_DEG = 0.08

T_POSE = np.tile(np.eye(3), (22, 1, 1))
SIDED = ("left_", "right_")


@pytest.fixture(scope="module")
def poses():
    """Frames of all sample clips (F, 24, 3)."""
    return np.concatenate([make().poses[::12] for make in SAMPLES.values()])


def angles_deg(got, want):
    """Angles [degrees] (F, J) between rotation matrices."""
    return np.degrees(np.linalg.norm(matrix_to_rotvec(np.swapaxes(want, -1, -2) @ got), axis=-1))


def pose_errors(got, want):
    return angles_deg(rotvec_to_matrix(got), rotvec_to_matrix(want))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_poses_come_back_from_a_rig_of_any_names_and_axes(scheme, body, poses):
    joints = body.rest_joints()
    rig, moved = rig_and_motion(
        joints, rotvec_to_matrix(poses), scheme=scheme, rest=T_POSE, seed=3, t_pose_joints=joints
    )
    assert pose_errors(rig_to_poses(rig, moved), poses).max() < EXACT_DEG
    back = angles_deg(quaternion_to_matrix(poses_to_rig(rig, poses)), quaternion_to_matrix(moved))
    assert back.max() < EXACT_DEG


@pytest.mark.parametrize(
    ("arm_deg", "leg_deg", "turn"),
    [(45.0, 8.0, [0.0, np.pi, 0.0]), (70.0, 0.0, [-np.pi / 2, 0.0, 0.0]), (-30.0, 15.0, [0.0, -0.7, 0.0])],
)
def test_poses_come_back_from_an_a_pose_whichever_way_it_faces_and_lies(arm_deg, leg_deg, turn, body, poses):
    joints, rest = body.rest_joints(), a_pose(arm_deg, leg_deg)
    rig, moved = rig_and_motion(
        joints, rotvec_to_matrix(poses), scheme="vrm", rest=rest, seed=5, turn=turn, t_pose_joints=joints
    )
    assert pose_errors(rig_to_poses(rig, moved), poses).max() < ASKEW_ARM_DEG
    back = angles_deg(quaternion_to_matrix(poses_to_rig(rig, poses)), quaternion_to_matrix(moved))
    assert back.max() < ASKEW_ARM_DEG


def test_a_rig_at_rest_stands_as_it_faces():
    still = np.tile(np.eye(3), (1, 22, 1, 1))
    rig, _ = rig_and_motion(CANONICAL_JOINTS, still, scheme="vrm", rest=T_POSE, turn=[0.0, 0.8, 0.0])
    want = np.zeros((1, 24, 3))
    want[0, 0, 1] = 0.8
    assert_allclose(rig_to_poses(rig, rig.rest_rotations[None]), want, rtol=0.0, atol=EXACT)


def test_a_body_of_another_build_costs_what_its_legs_lean(body, poses):
    # The canonical body's legs are straight down and its feet straight ahead; ours lean by 2.0 and 2.6 degrees.
    # A knee's own turn is told in axes that lean with the thigh. Both bodies' arms are level.
    rig, moved = rig_and_motion(body.rest_joints(), rotvec_to_matrix(poses), scheme="unreal", rest=T_POSE, seed=6)
    errors = pose_errors(rig_to_poses(rig, moved), poses)
    assert errors.mean() < 1.0
    legs = [joint for joint, name in enumerate(JOINT_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
    assert np.delete(errors, legs, axis=1).max() < ASKEW_ARM_DEG


LACKING = {
    "toes": ("left_foot", "right_foot"),
    "neck": ("neck",),
    "collars": ("left_collar", "right_collar"),
    "chest": ("spine2",),
    "upper chest": ("spine2", "spine3"),
}
LACKING["all that VRM does not require"] = sum(
    (LACKING[part] for part in ("toes", "neck", "collars", "upper chest")), ()
)


@pytest.mark.parametrize("lacking", LACKING)
@pytest.mark.parametrize("arm_deg", [0.0, 45.0])
def test_joints_that_a_rig_has_turn_right_whatever_it_lacks(lacking, arm_deg, body, poses):
    joints, without = body.rest_joints(), LACKING[lacking]
    rig, moved = rig_and_motion(
        joints,
        rotvec_to_matrix(poses),
        scheme="vrm",
        rest=a_pose(arm_deg, arm_deg / 6.0),
        without=without,
        seed=7,
        t_pose_joints=joints,
    )
    got, want = (global_rotations(rotvec_to_matrix(p), PARENTS) for p in (rig_to_poses(rig, moved), poses))
    # Of a trunk of one joint only the chest is told; the way there is spread.
    told = [BODY.index(name) for name in BODY if name not in (*without, "spine1", "spine2")]
    told = sorted({*told, BODY.index("spine3")})
    assert angles_deg(got[:, told], want[:, told]).max() < ASKEW_ARM_DEG
    back = angles_deg(quaternion_to_matrix(poses_to_rig(rig, poses)), quaternion_to_matrix(moved))
    assert back.max() < ASKEW_ARM_DEG


def test_a_trunk_and_a_neck_of_fewer_joints_are_spread_evenly(body):
    joints, turn = body.rest_joints(), np.array([0.3, -0.2, 0.1])
    poses = np.zeros((1, 24, 3))
    poses[0, [3, 6, 9, 12, 15]] = turn
    without = ("spine2", "spine3", "neck")
    rig, moved = rig_and_motion(
        joints, rotvec_to_matrix(poses), scheme="vrm", rest=T_POSE, without=without, t_pose_joints=joints
    )
    assert_allclose(rig_to_poses(rig, moved), poses, rtol=0.0, atol=EXACT)


def test_a_turn_is_the_formula_of_normalised_rigs(body, rng):
    """``q_local = P^-1 q_norm P R_rest`` with the parent's rest rotation P in the world."""
    joints, poses = body.rest_joints(), np.zeros((1, 24, 3))
    turn = rng.normal(size=3)
    poses[0, 18] = turn  # the left elbow
    rig, _ = rig_and_motion(joints, rotvec_to_matrix(poses), scheme="vrm", rest=T_POSE, seed=8, t_pose_joints=joints)
    node = rig.sources["left_elbow"]
    above = np.array([1.0, 0.0, 0.0, 0.0])
    parent = rig.parents[node]
    while parent >= 0:
        above, parent = quaternion_multiply(rig.rest_rotations[parent], above), rig.parents[parent]
    inverse = above * [1.0, -1.0, -1.0, -1.0]
    q_norm = rotvec_to_quaternion(turn)
    want = quaternion_multiply(
        quaternion_multiply(quaternion_multiply(inverse, q_norm), above), rig.rest_rotations[node]
    )
    got = poses_to_rig(rig, poses)[0, node]
    assert_allclose(got, np.sign(want[0]) * want, rtol=0.0, atol=EXACT)


def with_nodes(rig, added):
    """Names, parents, rest rotations and translations of the rig with leaves (name, parent's name) added."""
    names, parents = list(rig.names), [rig.names[parent] if parent >= 0 else None for parent in rig.parents]
    rotations, offsets = list(rig.rest_rotations), list(rig.rest_translations)
    for name, parent in added:
        at = names.index(parent) + 1
        names.insert(at, name)
        parents.insert(at, parent)
        rotations.insert(at, np.array([1.0, 0.0, 0.0, 0.0]))
        offsets.insert(at, np.zeros(3))
    index = [-1 if parent is None else names.index(parent) for parent in parents]
    return names, index, np.array(rotations), np.array(offsets)


@pytest.mark.parametrize(
    ("scheme", "added"),
    [
        ("unreal", [("upperarm_twist_01_l", "upperarm_l"), ("thigh_twist_01_r", "thigh_r"), ("ik_foot_l", "foot_l")]),
        ("rigify", [("DEF-upper_arm.L.001", "DEF-upper_arm.L"), ("DEF-thigh.R.001", "DEF-thigh.R")]),
        ("character_creator", [("CC_Base_L_UpperarmTwist01", "CC_Base_L_Upperarm")]),
        ("makehuman", [("upperarm02.L", "upperarm01.L"), ("shoulder01.L", "clavicle.L")]),
        ("daz", [("lThighTwist", "lThighBend"), ("rShldrTwist", "rShldrBend"), ("lMetatarsals", "lFoot")]),
        ("biped", [("Bip001 L Toe0Nub", "Bip001 L Toe0"), ("Bip001 HeadNub", "Bip001 Head")]),
        ("mixamo", [("mixamorig:HeadTop_End", "mixamorig:Head"), ("mixamorig:LeftToe_End", "mixamorig:LeftToeBase")]),
        ("vrm", [("leftHand_leaf", "leftHand"), ("leftUpperArmTwist", "leftUpperArm")]),
        ("mikumiku_japanese", [("左腕捩", "左腕"), ("左足IK親", "センター"), ("左足D", "左足")]),
    ],
)  # fmt: skip
def test_twist_and_leaf_bones_are_taken_for_nothing_and_keep_their_rest(scheme, added, poses):
    rig, _ = rig_and_motion(CANONICAL_JOINTS, rotvec_to_matrix(poses), scheme=scheme, rest=T_POSE)
    names, parents, rotations, offsets = with_nodes(rig, added)
    larger = Rig(names, parents, rotations, offsets)
    assert {joint: names[node] for joint, node in larger.sources.items()} == {
        joint: rig.names[node] for joint, node in rig.sources.items()
    }
    shown = poses_to_rig(larger, poses)
    for name, _ in added:
        assert_allclose(
            shown[:, names.index(name)], np.tile([1.0, 0.0, 0.0, 0.0], (len(poses), 1)), rtol=0.0, atol=EXACT
        )
    assert pose_errors(rig_to_poses(larger, shown), poses).max() < EXACT_DEG


def test_a_bone_inside_a_segment_carries_its_turn_on(body, poses):
    rig, _ = rig_and_motion(CANONICAL_JOINTS, rotvec_to_matrix(poses), scheme="makehuman", rest=T_POSE)
    names, parents, rotations, offsets = with_nodes(rig, [("upperarm02.L", "upperarm01.L")])
    twist, elbow = names.index("upperarm02.L"), names.index("lowerarm01.L")
    parents[elbow] = twist
    segmented = Rig(names, parents, rotations, offsets)
    turned = np.array(rotations)[None].copy()
    turned[0, twist] = rotvec_to_quaternion(np.array([0.6, 0.0, 0.0]))
    want = np.zeros((1, 24, 3))
    want[0, 18, 0] = 0.6  # seen from the joint, it is the forearm that turns
    assert_allclose(rig_to_poses(segmented, turned), want, rtol=0.0, atol=EXACT)


def test_a_node_that_carries_legs_and_trunk_turns_with_the_pelvis(poses):
    """Character Creator's legs hang on a branch of their own, beside the trunk."""
    rig, _ = rig_and_motion(CANONICAL_JOINTS, rotvec_to_matrix(poses), scheme="character_creator", rest=T_POSE)
    names, parents, rotations, offsets = with_nodes(rig, [("CC_Base_Pelvis", "CC_Base_Hip")])
    for side in "LR":
        parents[names.index(f"CC_Base_{side}_Thigh")] = names.index("CC_Base_Pelvis")
    branched = Rig(names, parents, rotations, offsets)
    assert names[branched.sources["pelvis"]] == "CC_Base_Pelvis"
    shown = poses_to_rig(branched, poses)
    assert pose_errors(rig_to_poses(branched, shown), poses).max() < EXACT_DEG
    hip = quaternion_to_matrix(shown[:, names.index("CC_Base_Hip")])
    assert angles_deg(hip, rotvec_to_matrix(poses[:, 0])).max() < EXACT_DEG


def test_local_rotations_are_the_inverse_of_global_ones(rng):
    local = rotvec_to_matrix(rng.normal(size=(3, 24, 3)))
    assert_allclose(local_rotations(global_rotations(local, PARENTS), PARENTS), local, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_names_all_joints(scheme):
    names = [rig_names(scheme)[joint] for joint in BODY]
    assert match_joints(names, PARENTS[:22], label=scheme) == {joint: index for index, joint in enumerate(BODY)}
    # Pages lose the marks of names: three.js strips them.
    bare = [name.translate(str.maketrans("", "", ".:[]/ ")) for name in names]
    assert match_joints(bare, PARENTS[:22], label=scheme) == {joint: index for index, joint in enumerate(BODY)}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    "affixes", [("Character1_", ""), ("Hero.01|", ""), ("", "_JNT"), ("ORG-", ".bind"), ("", "_{}")]
)
def test_what_all_names_begin_or_end_with_is_no_part_of_them(scheme, affixes):
    # Exporters put a character's name before them, riggers a kind behind them, sites that show models a number.
    before, after = affixes
    names = [f"{before}{rig_names(scheme)[joint]}{after.format(7 + k)}" for k, joint in enumerate(BODY)]
    parents = [*PARENTS[:22], -1, -1]
    found = match_joints([*names, "Camera", "Object_7"], parents, label=scheme)
    assert found == {joint: index for index, joint in enumerate(BODY)}


def test_names_without_affixes_keep_what_tells_sides_and_twists():
    names = [rig_names("unreal")[joint] for joint in BODY]
    twists = [f"{name}_twist_01_l" for name in ("upperarm", "thigh", "calf")]
    found = match_joints([*twists, *names], [-1, -1, -1, *(p + 3 if p >= 0 else p for p in PARENTS[:22])], label="rig")
    assert found == {joint: index + 3 for index, joint in enumerate(BODY)}


LIMBS = ["hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist"]
TRUNK = ["pelvis", "spine1", "spine2", "spine3", "neck", "head"]


@pytest.mark.parametrize(
    ("limbs", "trunk", "written"),
    [
        (
            "mHip mKnee mAnkle mFoot mCollar mShoulder mElbow mWrist",
            "mPelvis mTorso mSpine3 mChest mNeck mHead",
            lambda word, side: word + side.capitalize(),
        ),
        (
            "Hip Knee Ankle Toes Scapula Shoulder Elbow Wrist",
            "Root_M Spine1_M Spine2_M Chest_M Neck_M Head_M",
            lambda word, side: f"{word}_{side[0].upper()}",
        ),
    ],
    ids=["second life", "advanced skeleton"],
)
def test_more_schemes_are_read_whole(limbs, trunk, written):
    words = dict(zip(LIMBS + TRUNK, f"{limbs} {trunk}".split(), strict=True))
    sided = [joint.rpartition("_") for joint in BODY]
    names = [written(words[limb], side) if side else words[limb] for side, _, limb in sided]
    assert match_joints(names, PARENTS[:22], label="rig") == {joint: index for index, joint in enumerate(BODY)}


def test_a_foot_of_five_toes_heads_for_the_second():
    names = [rig_names("makehuman")[joint] for joint in BODY]
    parents = list(PARENTS[:22])
    for side in "LR":
        for toe in (2, 3):
            parents.append(names.index(f"foot.{side}"))
            names.append(f"toe{toe}-1.{side}")
    sources = match_joints(names, parents, label="rig")
    assert [names[sources[f"{side}_foot"]] for side in ("left", "right")] == ["toe2-1.L", "toe2-1.R"]


def test_a_trunk_of_four_joints_may_end_under_the_name_of_another_rigs_neck():
    names = [f"Spine{k:03d}" for k in range(1, 5)]
    limbs = [name for name in BODY if name.startswith(SIDED)]
    all_names = ["Hips", *names, *(rig_names("mixamo")[limb] for limb in limbs)]
    chest, found = names.index("Spine004") + 1, {}
    parents = [-1, 0, 1, 2, 3]
    for limb in limbs:
        above = BODY[PARENTS[BODY.index(limb)]]
        found[limb] = len(parents)
        parents.append(chest if above == "spine3" else found.get(above, 0))
    sources = match_joints(all_names, parents, label="rig")
    assert all_names[sources["spine3"]] == "Spine004"
    assert "neck" not in sources


def a_rig(**changed):
    parts = {
        "names": [rig_names("vrm")[joint] for joint in BODY],
        "parents": PARENTS[:22],
        "rest_rotations": np.tile([1.0, 0.0, 0.0, 0.0], (22, 1)),
        "rest_translations": t_pose_offsets(),
    }
    return Rig(**(parts | changed))


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"parents": PARENTS[:21]}, "rig: parents: expected 22 indices"),
        ({"parents": (-1, 0, 0, 0, 5, *PARENTS[5:22])}, "parents come before their children"),
        ({"parents": (-2, *PARENTS[1:22])}, "rig: parents"),
        ({"rest_rotations": np.zeros((22, 4))}, "rest_rotations: expected unit quaternions wxyz"),
        ({"rest_rotations": np.full((22, 4), np.nan)}, "rest_rotations: expected finite"),
        ({"rest_rotations": np.zeros((22, 3))}, "rest_rotations: expected shape"),
        ({"rest_translations": np.zeros((21, 3))}, "rest_translations: expected shape"),
        ({"rest_translations": np.full((22, 3), np.inf)}, "rest_translations: expected finite"),
        ({"rest_translations": np.zeros((22, 3))}, "hips beside a trunk"),
        ({"t_pose_joints": np.zeros((22, 3))}, "t_pose_joints: expected shape"),
        ({"names": [f"bone_{k}" for k in range(22)]}, "rig: skeleton"),
    ],
)
def test_a_rig_that_does_not_fit_is_refused(changed, match):
    with pytest.raises(MotionError, match=match):
        a_rig(**changed)


def test_legs_that_hang_on_nothing_are_refused():
    parents = [-1 if joint in (1, 2) else parent for joint, parent in enumerate(PARENTS[:22])]
    with pytest.raises(MotionError, match="no joint above both legs"):
        match_joints([rig_names("vrm")[joint] for joint in BODY], parents, label="rig")


def test_motion_that_does_not_fit_the_rig_is_refused():
    rig = a_rig()
    with pytest.raises(MotionError, match="quaternions: expected shape"):
        rig_to_poses(rig, np.zeros((2, 21, 4)))
    with pytest.raises(MotionError, match="unit quaternions"):
        rig_to_poses(rig, np.ones((2, 22, 4)))
    with pytest.raises(MotionError, match="poses: expected shape"):
        poses_to_rig(rig, np.zeros((2, 22, 3)))
    with pytest.raises(MotionError, match="poses: expected finite"):
        poses_to_rig(rig, np.full((2, 24, 3), np.nan))
