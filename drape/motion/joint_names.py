"""Which joint of a motion file or a rig is which SMPL joint, by its name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from drape.errors import MotionError

# A side's name, then how it is written before or after a joint's word.
_SIDES = (("left", "left", "l", "左"), ("right", "right", "r", "右"))

# What rigs put before every name: Rigify, Character Creator, Biped, Mixamo without its colon, VRoid (C is its middle),
# Second Life ("mHipLeft").
_PREFIX = re.compile(r"def-|cc_base_|bip\d+|mixamorig\d*|j_bip_(c_)?|(?-i:m(?=[A-Z]))", re.IGNORECASE)
# Between the words of a name; what most names begin or end with is no part of them (``_readings``).
_BETWEEN = re.compile(r"[\s_.:|-]+")
_SHARED, _NUMBER = 0.5, "0"

# SMPL joint -> names, without side, lower case. The same word means different
# joints in different schemes ("LeftShoulder" is a collar in MotionBuilder, an
# upper arm in Poser), so a file is read by one scheme: the one that fits best.
_SCHEMES = {
    # MotionBuilder, Mixamo, CMU's BVH by cgspeed, LAFAN, Motive
    "motionbuilder": {
        "hip": ("upleg", "thigh"),
        "knee": ("leg", "shin", "lowleg"),
        "ankle": ("foot",),
        "foot": ("toebase", "toe", "toes"),
        "collar": ("shoulder", "clavicle"),
        "shoulder": ("arm", "uparm", "uarm"),
        "elbow": ("forearm", "lowarm", "farm"),
        "wrist": ("hand",),
    },
    # Poser, SMPL's own names, Second Life, Advanced Skeleton
    "anatomical": {
        "hip": ("hip",),
        "knee": ("knee",),
        "ankle": ("ankle",),
        "foot": ("foot", "toe", "toes", "ball"),
        "collar": ("collar", "scapula", "clavicle", "clav"),
        "shoulder": ("shoulder",),
        "elbow": ("elbow",),
        "wrist": ("wrist",),
        "hand": ("hand",),
    },
    # CMU's own names, which converters of its ASF files keep
    "acclaim": {
        "hip": ("femur",),
        "knee": ("tibia",),
        "ankle": ("foot",),
        "foot": ("toes",),
        "collar": ("clavicle",),
        "shoulder": ("humerus",),
        "elbow": ("radius",),
        "wrist": ("wrist",),
        "hand": ("hand",),
    },
    # Avatars that name segments: VRM, VRoid, Unreal, Rigify, Character Creator, Biped, MakeHuman, Daz. Only whole words
    # count: "upperarm_twist_01_l", "DEF-thigh.L.001", "upperarm02.L" and "lThighTwist" are bones inside a segment.
    "segments": {
        "hip": ("upperleg", "thigh", "upperleg01", "thighbend"),
        "knee": ("lowerleg", "calf", "shin", "lowerleg01"),
        "ankle": ("foot",),
        "foot": ("toes", "toebase", "ball", "toe", "toe0", "toe21", "toe11"),  # MakeHuman's second toe points ahead.
        "collar": ("shoulder", "clavicle", "collar"),
        "shoulder": ("upperarm", "upperarm01", "shldrbend", "shldr"),
        "elbow": ("lowerarm", "forearm", "lowerarm01", "forearmbend"),
        "wrist": ("hand", "wrist"),
    },
    # MikuMikuDance, in English and Japanese: "Left leg" is a thigh, "Left arm" an upper arm
    "mikumiku": {
        "hip": ("leg", "足"),
        "knee": ("knee", "ひざ"),
        "ankle": ("ankle", "足首"),
        "foot": ("toe", "つま先"),
        "collar": ("shoulder", "肩"),
        "shoulder": ("arm", "腕"),
        "elbow": ("elbow", "ひじ"),
        "wrist": ("wrist", "手首"),
    },
}

# The first of several names wins, so a neck of two or three joints is its lowest joint.
_NECK = ("neck", "neckm", "lowerneck", "neck0", "neck1", "neck01", "necklower", "necktwist01", "spine004", "首")
_HEAD = ("head", "headm", "head1", "spine006", "頭")

CURE = "Rename the joints, or export with one of these naming schemes: docs/guide/motion.md."

_REQUIRED = ("hip", "knee", "ankle", "shoulder", "elbow")


def match_joints(names: Sequence[str], parents: Sequence[int], *, label: str) -> dict[str, int]:
    """Returns the index in ``names`` of every SMPL joint that the file has, by the joint's name.

    ``parents`` are indices, -1 for none. The trunk's joints, however many, are spread over spine1 to spine3. Raises
    ``MotionError``, which names ``label``, without both hips, knees, ankles, shoulders and elbows, and a trunk.
    """
    readings = [_best_limbs(reading) for reading in _readings(names)]
    plain, sources = next((one for one in readings if not _lacks(one[1])), readings[0])
    missing = _lacks(sources)
    if missing:
        raise _too_few(label, f"no {', '.join(missing)} among {', '.join(names[:40])}")
    sources = with_trunk(sources, parents, label=label)
    trunk = _trunk(parents, sources)
    return sources | {
        joint: plain[word]
        for joint, words in (("neck", _NECK), ("head", _HEAD))
        for word in words[::-1]
        if word in plain and plain[word] not in trunk  # A trunk of four joints may end in "spine004".
    }


def with_trunk(limbs: dict[str, int], parents: Sequence[int], *, label: str) -> dict[str, int]:
    """Returns ``limbs``, indices of joints with a side by their SMPL names, together with the pelvis and spine1 to
    spine3, which hold them. Raises ``MotionError``, which names ``label``, for nodes without a trunk."""
    left, right = (ancestors(parents, limbs[f"{side}_hip"]) for side in ("left", "right"))
    pelvis = next((joint for joint in left[1:] if joint in right[1:]), None)
    if pelvis is None:
        raise _too_few(label, "no joint above both legs")
    sources = {**limbs, "pelvis": pelvis}
    trunk = _trunk(parents, sources)
    if not trunk:
        raise _too_few(label, "no joint between the pelvis and the arms")
    return sources | {f"spine{k}": trunk[-(-k * len(trunk) // 3) - 1] for k in (1, 2, 3)}


def is_whole(sources: Mapping[str, int]) -> bool:
    """Returns whether ``sources`` has every SMPL joint that a person needs."""
    return not _lacks(sources) and {"pelvis", "spine1", "spine2", "spine3"} <= sources.keys()


def _best_limbs(names: Sequence[str]) -> tuple[dict[str, int], dict[str, int]]:
    """The plain ``names`` with their indices, and the limbs' joints by the scheme that finds the most among them."""
    plain: dict[str, int] = {}
    for index, name in enumerate(names):
        plain.setdefault(_plain(name), index)
    found = (_limbs(plain, scheme) for scheme in _SCHEMES.values())
    return plain, max(found, key=lambda limbs: (not _lacks(limbs), len(limbs)))


def _readings(names: Sequence[str]) -> Iterator[list[str]]:
    """The ``names``, and these without the words that most end or begin with, as "JNT" or a character's name, and the
    numbers that sites which show models put behind them; one word less each time."""
    yield list(names)
    words = [[word for word in _BETWEEN.split(name) if word] for name in names]
    sides = {mark for side in _SIDES for mark in side}
    for place in (-1, 0):
        while True:
            ends = ["" if len(own) < 2 else _NUMBER if own[place].isdigit() else own[place].lower() for own in words]
            shared, count = Counter(end for end in ends if end).most_common(1)[0] if any(ends) else ("", 0)
            if shared in sides or count < max(1.0, _SHARED * sum(map(bool, words))):
                break
            for own, end in zip(words, ends, strict=True):
                if end == shared:
                    del own[place]
            yield list(map("_".join, words))


def _plain(name: str) -> str:
    own = name.rsplit(":", 1)[-1]
    prefix = _PREFIX.match(own)
    bare = own[prefix.end() :] if prefix else own
    return "".join(letter for letter in bare.lower() if letter.isalnum())


def _limbs(plain: dict[str, int], scheme: dict[str, tuple[str, ...]]) -> dict[str, int]:
    joints = {}
    for side, *marks in _SIDES:
        for joint, words in scheme.items():
            before = [mark + word for mark in marks for word in words]
            after = [word + mark for mark in marks for word in words]
            for key in before + after:
                if key in plain:
                    joints.setdefault(f"{side}_{joint}", plain[key])
    return joints


def _lacks(sources: Mapping[str, int]) -> list[str]:
    """Required limb joints that are not among ``sources``."""
    return [f"{side}_{joint}" for side, *_ in _SIDES for joint in _REQUIRED if f"{side}_{joint}" not in sources]


def _trunk(parents: Sequence[int], sources: dict[str, int]) -> list[int]:
    """Joints from above the pelvis up to the one from which the arms branch, in order."""
    left, right = (ancestors(parents, sources[f"{side}_shoulder"]) for side in ("left", "right"))
    arms = {sources.get(f"{side}_{joint}") for side in ("left", "right") for joint in ("collar", "shoulder")}
    below = set(ancestors(parents, sources["pelvis"]))  # A root or reference joint may carry the pelvis.
    shared = [joint for joint in left if joint in right and joint not in arms and joint not in below]
    return shared[::-1]


def ancestors(parents: Sequence[int], joint: int) -> list[int]:
    """Returns ``joint`` and the joints above it, up to the root."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def _too_few(label: str, got: str) -> MotionError:
    return MotionError(
        f"{label}: skeleton",
        expected="a person's joints under MotionBuilder, Mixamo, CMU, LAFAN, Poser, SMPL, VRM, Unreal, Rigify, "
        "Character Creator, Biped, MakeHuman, Daz or MikuMikuDance names",
        got=got,
        cure=CURE,
    )
