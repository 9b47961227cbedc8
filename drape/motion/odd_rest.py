"""Rest poses that no person takes: what their bones say of trunk and limbs, and what only the motion says.

A bone fixes two of the three angles of its joint, and leaves its twist open. The lines between the hips and between the
arms fix the twist of pelvis and chest. Other twists follow from a rest pose that a person can take. Where it is none,
they are those that people keep on average: zero in a limb, and an even share in a trunk.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.motion.alignment import SLOPING_FOOT, least_turn, rest_bone
from drape.motion.joint_names import ancestors
from drape.motion.t_pose import BONE_CHILD, BONE_DIRECTIONS, JOINT_INDEX

# Farther [rad] from its T-pose direction, seen from its parent, no person holds a bone (LAFAN lays all along x).
_FAR = {"collar": 1.0, "shoulder": 2.0, "elbow": 2.0, "hip": 2.0, "knee": 2.5}
_ASIDE = {"hip": 0.8, "knee": 0.4}  # At most this share of a leg's bone lies aside.
_LIMBS = ("collar", "shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "foot")
_FAR_TIP = 1.0  # People turn head, hand and toes by less [rad] from what carries them, at rest or on average in a clip.

# Bones of a straight trunk turn by less than this [rad] from one to the next, the shipped body's by 0.8 where the
# spine begins; where the trunk stands over legs that stand, within _LEAN, by less than _SHARP_KINK.
_KINK, _SHARP_KINK, _LEAN = 0.9, 1.3, 0.2
_SHORT = 0.08  # A bone with a smaller share of the trunk's length does not count.
_TRUNK_TWIST = 0.7  # A joint of a trunk is twisted by less [rad] on average, beside the rest pose's own twist.

# More [rad] than people keep a joint twisted on average.
_TWIST = {"neck": 0.9, "head": 0.9, "collar": 0.9, "shoulder": 2.0, "elbow": 1.7, "wrist": 1.7, "hand": 0.9}
_TWIST |= {"hip": 1.3, "knee": 0.9, "ankle": 0.9, "foot": 0.9}

_SPINE = ("spine1", "spine2", "spine3")


def trunk_ends(
    rest: np.ndarray, parents: Sequence[int], sources: Mapping[str, int]
) -> tuple[dict[str, int], np.ndarray | None]:
    """Returns the index of the file's joint that the bone of each spine joint points to, by SMPL's names of spine
    joints, and the up direction (3,) of the pelvis, a unit vector or None. ``rest`` (J, 3) are the joints' positions at
    rest.

    A bent trunk is measured from joint to joint of the file, and up is along its lowest bone. A straight one is
    measured from joint to joint of SMPL's: up is None, and only spine joints on its topmost node have an entry.
    """
    tops = [sources[name] for name in ("neck", "head", "spine3") if name in sources]
    top = next(joint for joint in tops if sources["spine3"] in ancestors(parents, joint))
    below = ancestors(parents, sources["pelvis"])
    path = [sources["pelvis"], *(joint for joint in ancestors(parents, top)[::-1] if joint not in below)]
    reach = _SHORT * np.linalg.norm(np.diff(rest[path], axis=0), axis=1).sum()

    def far_end(start: int) -> int | None:
        above = path[path.index(start) + 1 :]
        return next((joint for joint in above if np.linalg.norm(rest[joint] - rest[start]) > reach), None)

    bones, joint = [], path[0]
    while (end := far_end(joint)) is not None:
        bones.append((rest[end] - rest[joint]) / np.linalg.norm(rest[end] - rest[joint]))
        joint = end
    stance = sum(rest[sources[f"{side}_hip"]] - rest[sources[f"{side}_ankle"]] for side in ("left", "right"))

    def leans(line: np.ndarray) -> bool:
        return line @ stance < np.cos(_LEAN) * np.linalg.norm(line) * np.linalg.norm(stance)

    chord_leans = leans(rest[top] - rest[path[0]])
    kink = min((one @ other for one, other in pairwise(bones)), default=1.0)
    kinked = kink < np.cos(_KINK if chord_leans else _SHARP_KINK)
    if not bones or not (kinked or (chord_leans and not leans(bones[0]))):
        return {name: top for name in _SPINE if sources[name] == sources["spine3"] != top}, None
    ends = {name: far_end(sources[name]) for name in _SPINE}
    return {name: end for name, end in ends.items() if end is not None}, bones[0]


def arms_across(rest: np.ndarray, sources: Mapping[str, int]) -> np.ndarray | None:
    """Returns the vector (3,) from the right arm to the left, where joints lie at the positions ``rest`` (J, 3); None
    if there is none.

    It joins the shoulders. If the collars do not point apart, it joins their own positions, which turn with the chest.
    """
    left, right = (rest[sources[f"{side}_shoulder"]] for side in ("left", "right"))
    if "left_collar" in sources and "right_collar" in sources:
        starts = [rest[sources[f"{side}_collar"]] for side in ("left", "right")]
        collars = left - starts[0], right - starts[1]
        if collars[0] @ collars[1] > -0.5 * np.linalg.norm(collars[0]) * np.linalg.norm(collars[1]):
            left, right = starts
    return left - right if np.linalg.norm(left - right) > 1e-9 else None


def odd_limbs(rest: np.ndarray, sources: Mapping[str, int], alignment: np.ndarray) -> set[str]:
    """Returns the SMPL names of the joints of those limbs that no person holds as they are at the positions ``rest``
    (J, 3). ``alignment`` (24, 3, 3) brings the T-pose onto that pose."""
    odd = set()
    for limb in [[f"{side}_{joint}" for joint in limb] for side in ("left", "right") for limb in _LIMBS]:
        for name in limb:
            bone, part = rest_bone(rest, sources, name), name.split("_")[1]
            if bone is None or part not in _FAR:
                continue
            seen = alignment[PARENTS[JOINT_INDEX[name]]].T @ bone
            far = seen @ np.array(BONE_DIRECTIONS[name]) < np.cos(_FAR[part])
            if far or abs(seen[0]) > _ASIDE.get(part, 2.0) or (part == "knee" and seen[2] > _ASIDE["knee"]):
                odd |= set(limb)
    return odd


def tips_of(rest: np.ndarray, parents: Sequence[int], sources: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Returns the unit directions (3,) in which feet, toes, hands and head point at the positions ``rest`` (J, 3), by
    SMPL's names of their joints: to the middle of the joints that they carry. What carries none is left out."""
    tips = {}
    for name in ("left_ankle", "right_ankle", "left_foot", "right_foot", "left_wrist", "right_wrist", "head"):
        carried = [k for k, parent in enumerate(parents) if parent == sources.get(name)]
        tip = np.sum(rest[carried] - rest[sources.get(name, 0)], axis=0)
        if np.linalg.norm(tip) > 1e-9:
            tips[name] = tip / np.linalg.norm(tip)
    return tips


def turn_tips(turned: np.ndarray, tips: Mapping[str, np.ndarray], alignment: np.ndarray, odd: set[str]) -> set[str]:
    """Turns feet, toes, hands and head to where their ``tips`` point, in ``turned`` and in ``alignment``, in place.
    Returns the names of the joints that it turned.

    ``turned`` (F, 24, 3, 3) are world rotations from the T-pose on, and ``alignment`` (24, 3, 3) brings the T-pose onto
    the rest pose. A joint that is not ``odd`` is left as it is, unless both at rest and through the clip it is held as
    no person holds it.
    """
    turned_limbs = set()
    for name, tip in tips.items():
        joint = JOINT_INDEX[name]
        carrier = alignment[PARENTS[joint]]
        expected = carrier @ (SLOPING_FOOT if name.endswith("ankle") else np.array(BONE_DIRECTIONS[name]))
        # It is the cosine of the mean turn.
        held = 0.5 * (np.trace(_relative(turned, PARENTS[joint], joint).mean(axis=0)) - 1.0)
        if name in odd or max(held, tip @ expected) < np.cos(_FAR_TIP):
            own = least_turn(expected, tip, carrier) @ carrier
            turned[:, joint] @= alignment[joint].T @ own
            alignment[joint] = own
            turned_limbs.add(name)
    return turned_limbs


def keep_mean_twists(
    turned: np.ndarray, sources: Mapping[str, int], alignment: np.ndarray, odd: set[str], tips: set[str]
) -> None:
    """Turns joints of the world rotations ``turned`` (F, 24, 3, 3) about their own bones, in place, so that their mean
    twist is one that people keep.

    Joints between pelvis and chest turn towards an even share of the mean twist between these two: by no more than the
    rest pose's own twist, unless they lie far off. Limbs that are ``odd`` at rest get a mean twist of zero. Hands and
    toes go with what carries them, unless they are among ``tips``, the joints that ``turn_tips`` turned.
    """
    up = np.array(BONE_DIRECTIONS["spine1"])
    twist = _mean_twist((alignment[0].T @ alignment[JOINT_INDEX["spine3"]])[None], up)
    chain = [0, *(JOINT_INDEX[name] for name in _SPINE if sources[name] != sources["spine3"]), JOINT_INDEX["spine3"]]
    share = _mean_twist(_relative(turned, 0, chain[-1]), up) / (len(chain) - 1)
    for below, joint in pairwise(chain[:-1]):
        turn = share - _mean_twist(_relative(turned, below, joint), up)
        natural = np.clip(turn, min(0.0, twist), max(0.0, twist))
        turned[:, joint] @= rotvec_to_matrix((natural if abs(turn - natural) < _TRUNK_TWIST else turn) * up)
    for joint, name in enumerate(JOINT_NAMES):
        if name not in sources or name in ("pelvis", *_SPINE):
            continue
        axis = SLOPING_FOOT if name.endswith("ankle") else np.array(BONE_DIRECTIONS[name])
        turn = _mean_twist(_relative(turned, PARENTS[joint], joint), axis)
        if name in odd or abs(turn) > _TWIST[name.split("_")[-1]]:
            undo = rotvec_to_matrix(-turn * axis)
            turned[:, joint] @= undo
            for leaf in range(joint + 1, JOINT_COUNT):
                if PARENTS[leaf] == joint and JOINT_NAMES[leaf] not in sources:
                    turned[:, leaf] = turned[:, joint]
                elif PARENTS[leaf] == joint and JOINT_NAMES[leaf] not in {*BONE_CHILD, *tips}:
                    turned[:, leaf] @= undo  # Such a joint shares its parent's alignment.


def _relative(turned: np.ndarray, parent: int, joint: int) -> np.ndarray:
    return np.swapaxes(turned[:, parent], -1, -2) @ turned[:, joint]


def _mean_twist(rotations: np.ndarray, axis: np.ndarray) -> float:
    """The mean twist [rad] of rotations (F, 3, 3) about a unit ``axis`` (3,)."""
    quaternions = matrix_to_quaternion(rotations)
    # Twists are half angles of either sign: their mean is that of the doubled angles.
    return float(np.angle(((quaternions[:, 0] + 1j * (quaternions[:, 1:] @ axis)) ** 2).sum()))
