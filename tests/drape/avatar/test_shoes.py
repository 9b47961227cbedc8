"""How high shoes of characters reach."""

from __future__ import annotations

import numpy as np

from drape.avatar.shoes import shoes_height
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES

FEET = [[JOINT_NAMES.index(f"{side}_{joint}") for joint in ("ankle", "foot")] for side in ("left", "right")]


def test_shoes_reach_as_high_as_they_stand_out_of_the_feet(body: BodyModel):
    """Feet that are 3 cm wider to all sides below a height are shoes up to there; feet alone are none."""
    assert shoes_height(body, body.v_template, body.faces, body.weights) == -np.inf
    top_m, shod = body.v_template[:, 1].min() + 0.06, body.v_template.copy()
    for bones in FEET:
        foot = (body.weights[:, bones].sum(axis=1) > 0.5) & (shod[:, 1] < top_m)
        way = (shod[foot] - shod[foot].mean(axis=0)) * [1.0, 0.0, 1.0]
        shod[foot] += 0.03 * way / np.linalg.norm(way, axis=1, keepdims=True)
    found = shoes_height(body, shod, body.faces, body.weights)
    assert top_m - 0.02 < found < top_m + 0.01
    legless = np.zeros((0, 3), dtype=np.int64)
    assert shoes_height(body, shod, legless, body.weights) == -np.inf
