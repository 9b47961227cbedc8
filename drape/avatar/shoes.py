"""How high the shoes of a character reach where they stand out of the feet of the body that stands for it."""

from __future__ import annotations

import numpy as np

from drape.avatar.covered import points_on
from drape.avatar.parts import PARTS, parts_of, plain_part
from drape.body.model import BodyModel
from drape.geometry.closest import signed_distance

OUT_M = 0.015  # A shoe stands out of the foot by more.
MOST = 0.95  # The quantile of what stands out. Tips of tongues and tags do not count.


def shoes_height(body: BodyModel, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray) -> float:
    """Returns the height [m], in the frame of ``body``, up to which a character's shoes stand out of the feet of
    ``body``, which stands for it; minus infinity where none does.

    ``vertices`` [m] (V, 3) are the character's surface in T-pose, ``faces`` (F, 3) its faces and ``weights`` (V, 24)
    its skinning weights.
    """
    soles = [number for number, part in enumerate(PARTS) if plain_part(part) == "sole"]
    shoes = faces[np.isin(parts_of(weights), soles)[faces].all(axis=1)]
    if not len(shoes):
        return -np.inf
    points, _ = points_on(vertices.astype(np.float64), shoes)
    out = points[signed_distance(points, body.v_template, body.faces) > OUT_M]
    return float(np.quantile(out[:, 1], MOST)) if len(out) else -np.inf
