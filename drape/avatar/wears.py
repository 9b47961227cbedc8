"""Whether a character can wear a garment, by the proportions of its legs, before any cloth is cut.

Cloth is cut for any body, but it cannot hang from limbs that are hardly longer than they are thick, as those of figures
of games are. A tube of cloth round such a limb is wider than long and falls off its end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.avatar.own_clothes import BONES, Halves, halves_by, skin_next_to
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import BodyError
from drape.garment.avatars import Avatar
from drape.garment.cache import Garment
from drape.garment.rest_pose import skirt_blend

# Thickness of legs over their length: persons have 0.1, stylised children 0.2, figures of games 0.53 and more.
THICKEST = 0.45
STOUTEST = 0.55  # Skirts, dresses and shorts stand off legs that are thicker, and are trodden on.
HIP, KNEE, ANKLE = (JOINT_NAMES.index(f"left_{joint}") for joint in ("hip", "knee", "ankle"))
LEAST_SHARE = 0.1  # A garment goes round the shins if a larger share of its vertices is there.


class Reach(NamedTuple):
    """Where a garment lies on a body: on which ``halves``, and whether it has long tubes round the ``legs``."""

    halves: Halves
    legs: bool


def reach_of(garment: Garment, body: BodyModel) -> Reach:
    """Returns where ``garment``, which is made for the standard ``body``, lies on it."""
    nearest = skin_next_to(garment, body)
    near = BONES[body.weights.argmax(axis=1)][nearest]
    legs = (near == "knee").mean() > LEAST_SHARE
    if legs:
        vertices = garment.vertices[: garment.vertex_count].astype(np.float64)
        standing = Avatar(body.v_template, body.faces, 0.0, body.name)
        legs = not skirt_blend(vertices, garment.faces.astype(np.int64), standing, body).any()
    return Reach(halves_by([nearest], body), bool(legs))


def legs_thickness(body: BodyModel) -> float:
    """Returns how thick the legs of ``body`` are for their length: twice the median distance of a shin's skin from its
    bone, over the length of the leg. It is 0 where the body has no skin there."""
    joints = body.joints_template
    along, length = joints[ANKLE] - joints[KNEE], np.linalg.norm(joints[ANKLE] - joints[KNEE])
    own = body.v_template[body.weights.argmax(axis=1) == KNEE] - joints[KNEE]
    if not len(own):
        return 0.0
    along = along / max(float(length), 1e-9)
    across = np.linalg.norm(own - np.outer(own @ along, along), axis=1)
    return float(2.0 * np.median(across) / (length + np.linalg.norm(joints[KNEE] - joints[HIP])))


def why_not(body: BodyModel, reach: Reach, *, garment: str) -> BodyError | None:
    """Returns the refusal of the garment called ``garment``, which has this ``reach``, for a character whose ``body``
    this is; None if the character can wear it."""
    limit = THICKEST if reach.legs else STOUTEST
    thickness = legs_thickness(body) if reach.legs or reach.halves.lower else 0.0
    if thickness <= limit:
        return None
    return BodyError(
        f"{garment} on {body.name}",
        expected=f"legs at most {limit:g} times as thick as long",
        got=f"{thickness:.2f} times",
        cure="Choose a skirt, shorts or a dress." if thickness <= STOUTEST else "Choose a top.",
    )
