"""Cloth round legs on its way to a wearer: it ends above shoes, and each leg's stays on its own side.

Wide legs of cloth would lie across each other where legs are close, and a hem that is narrower than the shoe below it
would have the shoe through it in every step.
"""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.garment.avatars import Avatar
from drape.garment.rest_pose import LEGS, skirt_blend
from drape.geometry.closest import nearest_vertices

APART_M = 0.003  # distance of a leg's cloth from the plane between the legs
HEM_M = 0.02  # a leg's depth is measured over this length at its end
LEANING = 0.3  # shins lean forward, so cloth in front comes down to the shoe by this share of half that depth
SHORTEST = 0.4  # legs keep at least this share of the way from knee to ankle, however high the shoe


def above_shoes(
    standing: np.ndarray, faces: np.ndarray, body: BodyModel, wearer: BodyModel, shoes_m: float
) -> np.ndarray:
    """Returns the vertices [m] (N, 3) of a garment at ``standing`` on ``body``, its legs shortened below the knees so
    that they would end above shoes. ``standing`` [m] (N, 3), ``faces`` (F, 3). The shoes reach up to ``shoes_m`` [m] on
    ``wearer``, a body of the same topology. Skirts, and legs that end above the shoes, stay as they are."""
    if shoes_m == -np.inf or skirt_blend(standing, faces, Avatar(body.v_template, body.faces, 0.0, ""), body).any():
        return standing
    nearest, shorter = nearest_vertices(standing, body.v_template)[1], standing.copy()
    places = [body.regressor @ one.v_template for one in (body, wearer)]
    for bones in LEGS.values():
        knee, ankle = places[1][bones[1:3], 1]
        below = places[0][bones[1], 1]
        own = (body.weights[:, bones].sum(axis=1) > 0.5)[nearest] & (standing[:, 1] < below)
        hem = standing[own, 1].min(initial=below)
        before_m = 0.5 * np.ptp(standing[own & (standing[:, 1] < hem + HEM_M), 2]) if hem < below else 0.0
        share = max((knee - shoes_m - LEANING * before_m) / (knee - ankle), SHORTEST)
        knee, ankle = places[0][bones[1:3], 1]
        least = knee - share * (knee - ankle)
        if hem < least:
            shorter[own, 1] = knee + (standing[own, 1] - knee) * (knee - least) / (knee - hem)
    return shorter


def apart(moved: np.ndarray, standing: np.ndarray, body: BodyModel, wearer: BodyModel) -> np.ndarray:
    """Returns ``moved`` [m] (N, 3), a garment's vertices on ``wearer``, with each leg kept on its own side of the plane
    between the legs. ``standing`` [m] (N, 3): the vertices on ``body``. A vertex of a leg that is on its side at
    ``standing`` ends at least as far from the plane as it is there, or ``APART_M`` from it if that is less."""
    nearest, kept = nearest_vertices(standing, body.v_template)[1], moved.copy()
    hips = [bones[0] for bones in LEGS.values()]
    here, there = (one.joints_template[hips, 0].mean() for one in (body, wearer))
    for bones in LEGS.values():
        side = np.sign(body.joints_template[bones[0], 0] - here)
        gap = side * (standing[:, 0] - here)
        own = (body.weights[:, bones].sum(axis=1) > 0.5)[nearest] & (gap > 0.0)
        least = np.minimum(gap, APART_M)
        kept[own, 0] = there + side * np.maximum(side * (moved[:, 0] - there), least)[own]
    return kept
