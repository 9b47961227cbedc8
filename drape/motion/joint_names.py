"""Which joint of a motion file is which SMPL joint, by its name."""

from __future__ import annotations

from collections.abc import Sequence

from drape.errors import MotionError

_SIDES = (("left", "left", "l"), ("right", "right", "r"))

# SMPL joint -> names, without side, lower case. The same word means different
# joints in different schemes ("LeftShoulder" is a collar in MotionBuilder, an
# upper arm in Poser), so a file is read by one scheme: the one that fits best.
_SCHEMES = {
    # MotionBuilder, Mixamo, CMU's BVH by cgspeed, LAFAN
    "motionbuilder": {
        "hip": ("upleg", "thigh"),
        "knee": ("leg", "shin", "lowleg"),
        "ankle": ("foot",),
        "foot": ("toebase", "toe"),
        "collar": ("shoulder", "clavicle"),
        "shoulder": ("arm", "uparm"),
        "elbow": ("forearm", "lowarm"),
        "wrist": ("hand",),
    },
    # Poser, SMPL's own names
    "anatomical": {
        "hip": ("hip",),
        "knee": ("knee",),
        "ankle": ("ankle",),
        "foot": ("foot", "toe"),
        "collar": ("collar",),
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
}

_NECK = ("neck", "lowerneck")
_HEAD = ("head",)

_REQUIRED = ("hip", "knee", "ankle", "shoulder", "elbow")


def match_joints(names: Sequence[str], parents: Sequence[int], *, label: str) -> dict[str, int]:
    """SMPL joint name -> index into ``names``, for every SMPL joint that the file has.

    Refused without both hips, knees, ankles, shoulders and elbows, and a trunk.
    The trunk's joints, however many, are spread over spine1 to spine3.
    """
    plain = {}
    for index, name in enumerate(names):
        plain.setdefault(_plain(name), index)
    found = max((_limbs(plain, scheme) for scheme in _SCHEMES.values()), key=len)
    missing = [f"{side}_{joint}" for side, *_ in _SIDES for joint in _REQUIRED if f"{side}_{joint}" not in found]
    if missing:
        raise _too_few(label, f"no {', '.join(missing)} among {', '.join(names[:40])}")
    left, right = (_ancestors(parents, found[f"{side}_hip"]) for side in ("left", "right"))
    found["pelvis"] = next(joint for joint in left[1:] if joint in right[1:])
    found |= {
        joint: plain[word]
        for joint, words in (("neck", _NECK), ("head", _HEAD))
        for word in words[::-1]
        if word in plain
    }
    trunk = _trunk(parents, found)
    if not trunk:
        raise _too_few(label, "no joint between the pelvis and the arms")
    for k in (1, 2, 3):
        found[f"spine{k}"] = trunk[-(-k * len(trunk) // 3) - 1]
    return found


def _plain(name: str) -> str:
    return "".join(letter for letter in name.rsplit(":", 1)[-1].lower() if letter.isalnum())


def _limbs(plain: dict[str, int], scheme: dict[str, tuple[str, ...]]) -> dict[str, int]:
    found = {}
    for side, *prefixes in _SIDES:
        for joint, words in scheme.items():
            for key in (prefix + word for prefix in prefixes for word in words):
                if key in plain:
                    found.setdefault(f"{side}_{joint}", plain[key])
    return found


def _trunk(parents: Sequence[int], found: dict[str, int]) -> list[int]:
    """Joints from above the pelvis up to the one from which the arms branch, in order."""
    left, right = (_ancestors(parents, found[f"{side}_shoulder"]) for side in ("left", "right"))
    arms = {found.get(f"{side}_{joint}") for side in ("left", "right") for joint in ("collar", "shoulder")}
    below = set(_ancestors(parents, found["pelvis"]))  # a root or reference joint may carry the pelvis
    shared = [joint for joint in left if joint in right and joint not in arms and joint not in below]
    return shared[::-1]


def _ancestors(parents: Sequence[int], joint: int) -> list[int]:
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def _too_few(label: str, got: str) -> MotionError:
    return MotionError(
        f"{label}: skeleton",
        expected="a person's joints under MotionBuilder, Mixamo, CMU, LAFAN, Poser or SMPL names",
        got=got,
        cure="Rename the joints, or export with one of these naming schemes.",
    )
