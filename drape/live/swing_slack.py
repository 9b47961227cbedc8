"""How much wider a garment is than the body in it: a wide skirt does not go with the legs that it lies near in places.

A horizontal plane cuts the cloth at rest in rings. One closed ring at a height goes around the trunk or both legs, two
rings go around a limb each.
"""

from __future__ import annotations

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.geometry.sections import closed_rings, convex_hull, level_section

STEP_M = 0.02  # distance of the planes
# The slack of a ring is its length over the girth of the skin in it. Up to TIGHT cloth near the skin is held wholly,
# from LOOSE on by the share LEAST: most of the dress is tighter, most of the circle skirt looser. Without any hold the
# skirt rides up in a walk; with more it does not fly.
TIGHT, LOOSE, LEAST = 1.9, 2.3, 0.003


def held_share(cloth: ClothMesh, rest: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Returns for each vertex of ``cloth`` a factor (V,), ``LEAST`` to 1, of the spring by which the skin near it holds
    a node of swing in place: the wider the cloth is around the body at this height, the smaller.

    ``rest`` [m] (V, 3) are the vertices and ``skin`` [m] (S, 3) points of the body, both at rest.
    """
    height = np.arange(rest[:, 1].max(), rest[:, 1].min(), -STEP_M)
    slack = np.interp(-rest[:, 1], -height, _slack(cloth, rest, skin, height))
    loose = np.clip((slack - TIGHT) / (LOOSE - TIGHT), 0.0, 1.0)
    return 1.0 - (1.0 - LEAST) * loose * loose * (3.0 - 2.0 * loose)


def _slack(cloth: ClothMesh, rest: np.ndarray, skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """The slack of the ring at every ``height`` [m] (n,) from the top down.

    0 where there are several rings. Where there is none, as at a wavy hem, it is that of the ring above.
    """
    slack, last = np.zeros(len(height)), 0.0
    for i, y in enumerate(height):
        rings = closed_rings(level_section(cloth.faces, rest, y), rest)
        if len(rings) == 1:
            at_height = skin[np.abs(skin[:, 1] - y) < STEP_M][:, [0, 2]]
            side = rings[0].hull.equations
            inside = at_height[(at_height @ side[:, :2].T + side[:, 2] <= 0.0).all(axis=1)]
            hull = convex_hull(inside)
            last = last if hull is None else rings[0].length_m / hull.area  # the area of a plane hull is its girth
        elif rings:
            last = 0.0
        slack[i] = last
    return slack
