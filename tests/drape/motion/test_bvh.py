"""BVH files: known rotations come back, whatever the names, channels, units and rest pose."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.body.skeleton import PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.alignment import least_turn
from drape.motion.amass import Y_FROM_Z
from drape.motion.bvh import read_bvh
from drape.motion.readers import read_motion
from drape.motion.retarget import global_rotations
from drape.motion.samples import walk
from drape.motion.t_pose import BONE_CHILD, BONE_DIRECTIONS, CANONICAL_JOINTS
from tests.drape.motion.bvh_setup import local, root, wrote
from tests.drape.motion.motion_files import BODY, BODY_PARENTS, SCHEMES, scheme_names, t_pose_offsets

__all__ = ["local", "root", "wrote"]  # fixtures
# Files hold nine decimals of degrees and of the unit of length.
WRITTEN = 3e-8


def told_from_parents(turns):
    """World rotations (..., 22, 3, 3) as rotations relative to the parent."""
    parents = list(BODY_PARENTS[1:])
    relative = np.swapaxes(turns[..., parents, :, :], -1, -2) @ turns[..., 1:, :, :]
    return np.concatenate([turns[..., :1, :, :], relative], axis=-3)


def read_globals(clip):
    return global_rotations(rotvec_to_matrix(clip.poses), PARENTS)


def reposed(local, rest):
    """Offsets and local rotations of the same motion, told from a rest pose (22, 3, 3) of local rotations."""
    frames = global_rotations(rest[None], BODY_PARENTS)[0]
    # The root's offset is zero, so that any frame may turn it.
    offsets = (frames[[max(parent, 0) for parent in BODY_PARENTS]] @ t_pose_offsets()[..., None])[..., 0]
    return offsets, told_from_parents(global_rotations(local, BODY_PARENTS) @ np.swapaxes(frames, -1, -2))


def still():
    return np.tile(np.eye(3), (22, 1, 1))


def rest_tips(rest):
    """End sites of head, hands and toes in a rest pose (22, 3, 3) of local rotations."""
    frames = global_rotations(rest[None], BODY_PARENTS)[0]
    ends = ("head", "left_wrist", "right_wrist", "left_foot", "right_foot")
    return {BODY.index(name): 0.1 * frames[BODY.index(name)] @ np.array(BONE_DIRECTIONS[name]) for name in ends}


def worst_degrees(clip, local):
    got, want = read_globals(clip)[:, :22], global_rotations(local, BODY_PARENTS)
    return np.degrees(np.linalg.norm(matrix_to_rotvec(np.swapaxes(want, -1, -2) @ got), axis=-1)).max()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rotations_come_back_under_every_naming_scheme(scheme, local, root, wrote):
    clip = read_motion(wrote(names=scheme_names(scheme)))
    assert_allclose(rotvec_to_matrix(clip.poses[:, :22]), local, rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.poses[:, 22:], np.zeros((5, 2, 3)), rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, root, rtol=0.0, atol=WRITTEN)
    assert clip.name == "clip"
    assert_allclose(clip.fps, 60.0, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
@pytest.mark.parametrize("positions_last", [False, True])
def test_channels_may_come_in_any_order(order, positions_last, local, root, wrote):
    clip = read_bvh(wrote(order=order, positions_last=positions_last))
    assert_allclose(rotvec_to_matrix(clip.poses[:, :22]), local, rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, root, rtol=0.0, atol=WRITTEN)


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45])
def test_unit_is_guessed_from_the_legs(unit, root, wrote):
    path = wrote(offsets=t_pose_offsets() / unit, places=root / unit)
    assert_allclose(read_bvh(path).trans, root, rtol=0.0, atol=WRITTEN)
    assert_allclose(read_bvh(path, metres_per_unit=unit * 1.1).trans, 1.1 * root, rtol=0.0, atol=WRITTEN)


@pytest.mark.parametrize("size", [1e-5, 0.3, 4.0, 1e6])
def test_a_figure_of_any_size_walks_as_far_as_an_adult(size, local, root, wrote):
    path = wrote(offsets=size * t_pose_offsets(), places=size * root)
    clip, own = read_bvh(path), read_bvh(wrote())
    assert_allclose(rotvec_to_matrix(clip.poses[:, :22]), local, rtol=0.0, atol=1e-3)  # nine places of 1e-5
    share = np.linalg.norm(clip.trans) / np.linalg.norm(own.trans)
    assert 0.8 < share < 1.25
    assert_allclose(clip.trans, share * own.trans, rtol=0.0, atol=1e-3)


def test_legs_of_no_person_in_a_unit_that_was_told_are_refused(wrote):
    with pytest.raises(MotionError, match="legs of"):
        read_bvh(wrote(offsets=1e-5 * t_pose_offsets()), metres_per_unit=1.0)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_file_may_begin_with_a_mark_of_byte_order_and_name_joints_in_japanese(encoding, local, wrote):
    names = scheme_names("lafan")
    japanese = {
        "LeftUpLeg": "左足",
        "LeftLeg": "左ひざ",
        "LeftFoot": "左足首",
        "LeftArm": "左腕",
        "LeftForeArm": "左ひじ",
    }
    sides = japanese | {left.replace("Left", "Right"): word.replace("左", "右") for left, word in japanese.items()}
    path = wrote(names=[sides.get(name, name) for name in names])
    path.write_bytes(path.read_text().encode(encoding))
    turned = rotvec_to_matrix(read_bvh(path).poses[:, [1, 2, 4, 5, 16, 17]])
    assert_allclose(turned, local[:, [1, 2, 4, 5, 16, 17]], rtol=0.0, atol=WRITTEN)


def a_pose():
    rest = np.tile(np.eye(3), (22, 1, 1))
    for joint, angle in {
        "left_shoulder": -0.8, "right_shoulder": 0.8, "left_hip": 0.2, "right_hip": -0.2, "left_collar": 0.2,
    }.items():  # fmt: skip
        rest[BODY.index(joint)] = rotvec_to_matrix(np.array([0.0, 0.0, angle]))
    # The soles stay level, so the feet do not follow the legs.
    for side, angle in (("left", -0.2), ("right", 0.2)):
        rest[BODY.index(f"{side}_ankle")] = rotvec_to_matrix(np.array([0.0, 0.0, angle]))
    return rest


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.0, 1.3, 0.0], [np.pi / 2, 0.0, 0.0], [0.4, -2.0, 1.1]])
def test_rotations_come_back_from_an_a_pose_in_any_direction(turn, local, wrote):
    rest = a_pose()
    rest[0] = rotvec_to_matrix(np.array(turn))
    offsets, told = reposed(local, rest)
    clip = read_bvh(wrote(offsets=offsets, turns=told))
    assert_allclose(rotvec_to_matrix(clip.poses[:, :22]), local, rtol=0.0, atol=WRITTEN)


def test_bone_directions_are_the_files_for_a_bent_rest_pose(local, rng, wrote):
    offsets, told = reposed(local, rotvec_to_matrix(0.4 * rng.normal(size=(22, 3))))
    got, want = read_globals(read_bvh(wrote(offsets=offsets, turns=told))), global_rotations(local, BODY_PARENTS)
    for name, child in BONE_CHILD.items():
        # The pelvis follows the line of the hips; a foot, the heading.
        if child in BODY and name != "pelvis" and not name.endswith("ankle"):
            joint, bone = BODY.index(name), np.array(BONE_DIRECTIONS[name])
            assert_allclose(got[:, joint] @ bone, want[:, joint] @ bone, rtol=0.0, atol=WRITTEN)


def folded(rng):
    """LAFAN's rest pose: every bone along x, at an arbitrary twist; the hips along z."""
    rest = np.empty((22, 3, 3))
    for joint, name in enumerate(BODY):
        direction = t_pose_offsets()[BODY.index(BONE_CHILD[name])] if BONE_CHILD.get(name) in BODY else None
        if direction is None:
            rest[joint] = rest[BODY_PARENTS[joint]]
            continue
        y = direction / np.linalg.norm(direction)
        x = np.cross(y, [0.0, 0.3, 1.0] if abs(y[2]) < 0.9 else [1.0, 0.3, 0.0])
        if name.startswith(("pelvis", "spine", "neck")):
            x = np.array([1.0, 0.0, 0.0])
        x /= np.linalg.norm(x)
        body = np.stack([y, x, np.cross(y, x)], axis=-1)
        twist = rng.uniform(-np.pi, np.pi) if name.startswith(("left", "right")) else np.pi / 2.0
        rest[joint] = rotvec_to_matrix(np.array([twist, 0.0, 0.0])) @ body.T
    return told_from_parents(rest)


def test_folded_rest_pose_gives_exact_bones_and_natural_twists(rng, wrote):
    clip = walk()
    local = rotvec_to_matrix(clip.poses[:132:4, :22])
    offsets, told = reposed(local, folded(rng))
    path = wrote(offsets=offsets, turns=told, places=clip.trans[:132:4])
    got, want = read_globals(read_bvh(path)), global_rotations(local, BODY_PARENTS)
    for name in ("left_hip", "right_knee", "left_shoulder", "right_elbow", "spine2"):
        joint, bone = BODY.index(name), np.array(BONE_DIRECTIONS[name])
        assert_allclose(got[:, joint] @ bone, want[:, joint] @ bone, rtol=0.0, atol=WRITTEN)
    error = np.linalg.norm(matrix_to_rotvec(np.swapaxes(want, -1, -2) @ got[:, :22]), axis=-1)
    # Twists are unknown, and taken as zero on average; the walk's own are nearly zero.
    assert error.max() < 0.1


def test_z_up_file_is_turned(local, root, wrote):
    path = wrote()
    clip = read_bvh(path, up="z")
    assert_allclose(rotvec_to_matrix(clip.poses[:, 0]), Y_FROM_Z @ local[:, 0], rtol=0.0, atol=WRITTEN)
    assert_allclose(rotvec_to_matrix(clip.poses[:, 1:22]), local[:, 1:], rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, root @ Y_FROM_Z.T, rtol=0.0, atol=WRITTEN)
    with pytest.raises(MotionError, match="vertical axis"):
        read_bvh(path, up="up")


@pytest.mark.parametrize("axis", ["y", "z", "x", "-y", "-z", "-x"])
@pytest.mark.parametrize("drawn_upright", [False, True])
def test_up_is_the_axis_that_the_person_stands_along(axis, drawn_upright, wrote):
    clip = walk()
    local, trans = rotvec_to_matrix(clip.poses[:132:12, :22]), clip.trans[:132:12]
    up = float(f"{axis[:-1]}1") * np.eye(3)["xyz".index(axis[-1])]
    world = least_turn(up, np.array([0.0, 1.0, 0.0]), np.eye(3)).T
    # Either the skeleton is drawn in the file's axes, or as ours, and its root turns it.
    rest = still()
    rest[0] = np.eye(3) if drawn_upright else world
    told = local.copy()
    told[:, 0] = world @ local[:, 0]
    offsets, told = reposed(told, rest)
    clip = read_bvh(wrote(offsets=offsets, turns=told, places=trans @ world.T))
    assert_allclose(rotvec_to_matrix(clip.poses[:, :22]), local, rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, trans, rtol=0.0, atol=WRITTEN)


def test_a_person_who_lies_is_not_put_upright(wrote):
    supine = np.tile(still(), (3, 1, 1, 1))
    supine[:, 0] = rotvec_to_matrix(np.array([-np.pi / 2.0, 0.0, 0.0]))
    clip = read_bvh(wrote(turns=supine, places=np.tile([0.4, 0.15, 2.0], (3, 1))))
    assert_allclose(rotvec_to_matrix(clip.poses[:, 0]), supine[:, 0], rtol=0.0, atol=WRITTEN)


# Rest poses by the joints that turn in them, with all that they carry: trunks that are twisted, bent forward, bent
# aside or turned about below the legs; the head alone; a chest that lies in the trunk's own frame.
ODD_RESTS = {
    "twisted": {"spine1": [0.0, 1.5, 0.0]},
    "twisted a little": {"spine2": [0.0, 0.3, 0.0]},
    "about face": {"spine3": [0.0, np.pi, 0.0]},
    "twisted to and fro": {"spine2": [0.0, 1.5, 0.0], "spine3": [0.0, -1.5, 0.0]},
    "bent forward": {"spine1": [0.5, 0.0, 0.0]},
    "bent backward": {"spine2": [-1.6, 0.0, 0.0]},
    "bent aside": {"spine3": [0.0, 0.0, 1.6]},
    "legs forward": {"left_hip": [-1.2, 0.0, 0.0], "right_hip": [-1.2, 0.0, 0.0]},
    "legs turned": {"left_hip": [0.0, 2.0, 0.0], "right_hip": [0.0, 2.0, 0.0]},
    "head bowed": {"head": [1.6, 0.0, 0.0]},
    "neck bowed": {"neck": [1.6, 0.0, 0.0]},
    "hand turned down": {"left_wrist": [0.0, 0.0, -1.6]},
}


@pytest.mark.parametrize("kind", ODD_RESTS)
def test_a_motion_is_the_same_from_any_rest_pose_of_the_trunk(kind, wrote):
    clip = walk()
    local = rotvec_to_matrix(clip.poses[:132:12, :22])
    rest = still()
    for name, turn in ODD_RESTS[kind].items():
        rest[BODY.index(name)] = rotvec_to_matrix(np.array(turn))
    offsets, told = reposed(local, rest)
    clip = read_bvh(wrote(offsets=offsets, turns=told, places=clip.trans[:132:12], tips=rest_tips(rest)))
    assert worst_degrees(clip, local) < 2.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_bones_that_lie_in_frames_at_random_leave_a_still_person_as_it_stands(seed, wrote):
    lowered = still()
    for side, angle in (("left", -0.9), ("right", 0.9)):
        lowered[BODY.index(f"{side}_shoulder")] = rotvec_to_matrix(np.array([0.0, 0.0, angle]))
    local = np.tile(lowered, (2, 1, 1, 1))
    turns = Rotation.create_group("O").as_matrix()
    frames = turns[np.random.default_rng(seed).integers(0, len(turns), 22)]
    rest = told_from_parents(frames)
    offsets, told = reposed(local, rest)
    clip = read_bvh(wrote(offsets=offsets, turns=told, places=np.tile([0.0, 0.95, 0.0], (2, 1)), tips=rest_tips(rest)))
    assert worst_degrees(clip, local) < 2.0


@pytest.mark.parametrize("trunk", [1, 2])
@pytest.mark.parametrize("turn", [[0.0, 0.0, 1.5], [0.0, 1.5, 0.0]], ids=["bent aside", "twisted"])
def test_joints_of_a_short_trunk_turn_as_one(trunk, turn, wrote):
    gone = [f"spine{k}" for k in range(trunk + 1, 4)]
    kept = [joint for joint in range(22) if BODY[joint] not in gone]
    above = [BODY_PARENTS[j] if BODY_PARENTS[j] in kept else BODY.index(f"spine{trunk}") for j in kept]
    joints = CANONICAL_JOINTS[:22].copy()
    for side in ("left", "right"):  # level arms, as in a T-pose
        joints[[BODY.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")], 1] -= 0.035
    turns = np.tile(np.eye(3), (2, len(kept), 1, 1))
    # The chest is turned at rest, and its joint undoes it.
    bend = rotvec_to_matrix(np.array(turn))
    chest = kept.index(BODY.index(f"spine{trunk}"))
    carried = {chest}
    offsets = []
    for k, (joint, parent) in enumerate(zip(kept, above, strict=True)):
        offset = joints[joint] - joints[parent] if joint else np.zeros(3)
        carried |= {k} if k and kept.index(parent) in carried else set()
        offsets.append(bend @ offset if k in carried - {chest} else offset)
    turns[:, chest] = bend.T
    names = [scheme_names("lafan")[joint] for joint in kept]
    parents = tuple([-1, *(kept.index(parent) for parent in above[1:])])
    clip = read_bvh(
        wrote(
            names=names,
            parents=parents,
            offsets=np.array(offsets),
            turns=turns,
            places=np.tile([0.0, 0.9, 0.0], (2, 1)),
        )
    )
    assert np.degrees(np.linalg.norm(clip.poses[:, :16], axis=-1)).max() < 2.0


def test_joint_above_the_pelvis_carries_it(local, root, wrote):
    names = ["reference", *scheme_names("lafan")]
    parents = (-1, *(parent + 1 for parent in BODY_PARENTS))
    offsets = np.concatenate([np.zeros((1, 3)), t_pose_offsets()])
    offsets[1] = 0.1, 0.2, 0.3
    turns = np.concatenate([local[:, 3:4], local], axis=1)
    clip = read_bvh(wrote(names=names, parents=parents, offsets=offsets, turns=turns))
    assert_allclose(rotvec_to_matrix(clip.poses[:, 0]), turns[:, 0] @ local[:, 0], rtol=0.0, atol=WRITTEN)
    assert_allclose(rotvec_to_matrix(clip.poses[:, 1:22]), local[:, 1:], rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, root + (turns[:, 0] @ offsets[1][:, None])[..., 0], rtol=0.0, atol=WRITTEN)


@pytest.mark.parametrize("trunk", [1, 2, 4, 6])
def test_trunk_of_any_number_of_joints_carries_the_shoulders(trunk, rng, wrote):
    names, parents, offsets = ["Hips"], [-1], [np.zeros(3)]
    for k in range(trunk):
        names.append(f"Spine{k}")
        parents.append(k)
        offsets.append(np.array([0.0, 0.5 / trunk, 0.0]))
    for joint in range(1, 22):
        name = BODY[joint]
        if not name.startswith("spine"):
            parent = BODY[BODY_PARENTS[joint]]
            names.append(scheme_names("lafan")[joint])
            parents.append(trunk if parent == "spine3" else names.index(scheme_names("lafan")[BODY.index(parent)]))
            offsets.append(t_pose_offsets()[joint])
    turns = rotvec_to_matrix(0.4 * rng.normal(size=(3, len(names), 3)))
    path = wrote(names=names, parents=tuple(parents), offsets=np.array(offsets), turns=turns, places=np.zeros((3, 3)))
    got, want = read_globals(read_bvh(path)), global_rotations(turns, tuple(parents))
    for smpl, name in (("spine3", f"Spine{trunk - 1}"), ("left_shoulder", "LeftArm"), ("head", "Head")):
        joint = {"spine3": 9, "left_shoulder": 16, "head": 15}[smpl]
        assert_allclose(got[:, joint], want[:, names.index(name)], rtol=0.0, atol=WRITTEN)
