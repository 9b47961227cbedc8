"""Parts of a body, by the joints that move them: a character's skin is compared with ours part by part."""

from __future__ import annotations

import numpy as np

from drape.avatar.t_pose import TPose
from drape.body.skeleton import JOINT_NAMES

PARTS = {
    "trunk": ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar"),
    "neck": ("neck",),
    "head": ("head",),
    **{f"{side}_{part}": tuple(f"{side}_{joint}" for joint in joints)
       for side in ("left", "right") for part, joints in (("upper_arm", ("shoulder",)), ("forearm", ("elbow",)),
       ("palm", ("wrist", "hand")), ("thigh", ("hip",)), ("shin", ("knee",)), ("sole", ("ankle", "foot")))},
}  # fmt: skip
CHAINS = (("upper_arm", "forearm", "palm"), ("thigh", "shin", "sole"))
LIMBS = ("trunk", "upper_arm", "forearm", "thigh", "shin")  # The fit is measured on the parts that garments lie on.


def parts_of(weights: np.ndarray) -> np.ndarray:
    """Returns the index (V,) in ``PARTS`` of the part whose joints have most of each row of ``weights`` (V, 24)."""
    index = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    return np.argmax([weights[:, [index[name] for name in names]].sum(axis=1) for names in PARTS.values()], axis=0)


def plain_part(part: str) -> str:
    """Returns the name of ``part`` without its side: "palm" of "left_palm"."""
    return part.removeprefix("left_").removeprefix("right_")


def _beside(part: str) -> set[str]:
    """``part`` and those that join it."""
    near, plain = {part}, plain_part(part)
    side = part.removesuffix(plain)
    for chain in CHAINS:
        if plain in chain:
            place = chain.index(plain)
            near |= {side + other for other in chain[max(0, place - 1) : place + 2]}
            near |= {"trunk"} if place == 0 else set()
    if part == "trunk":
        near |= {"neck", *(f"{side}_{chain[0]}" for side in ("left", "right") for chain in CHAINS)}
    return near | {"neck": {"trunk", "head"}, "head": {"neck"}}.get(part, set())


# Rows and columns are indices of ``PARTS``.
_JOINED = np.array([[other in _beside(part) for other in PARTS] for part in PARTS])


def beside(own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns the mask (n,) bool that says which of the parts ``own`` (n,) are equal to the parts ``others`` (n,), one
    by one, or join them. Parts are indices of ``PARTS``."""
    return _JOINED[own, others]


def faces_beside(part: str, corners: np.ndarray) -> np.ndarray:
    """Returns the indices (n,) of a character's faces whose three corners lie on ``part`` or on parts that join it.
    ``corners`` (F, 3) are the corners' parts as indices of ``PARTS``."""
    return np.flatnonzero(beside(np.array(list(PARTS).index(part)), corners).all(axis=1))


def counted_vertices(pose: TPose) -> np.ndarray:
    """Returns the indices (n,) of the character's vertices on trunk, arms and legs that faces use. Neck, head, hands
    and feet do not count in a fit."""
    wanted = [number for number, part in enumerate(PARTS) if plain_part(part) in LIMBS]
    return np.intersect1d(np.flatnonzero(np.isin(parts_of(pose.weights), wanted)), pose.faces)
