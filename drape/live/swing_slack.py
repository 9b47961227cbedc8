"""How much wider a garment is than the body in it. A wide skirt lies near the legs in places and does not go with them.

A horizontal plane cuts the cloth at rest in rings. One closed ring at a height goes around the trunk or both legs, two
rings go around a limb each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from drape.cloth.energies import ClothMesh

STEP_M = 0.02  # between the planes
# The slack of a ring is its length over the girth of the skin in it. Up to TIGHT cloth near the skin is held wholly,
# from LOOSE on by the share LEAST: most of the dress is tighter, most of the circle skirt looser. Without any hold the
# skirt rides up in a walk; with more it does not fly.
TIGHT, LOOSE, LEAST = 1.9, 2.3, 0.003


class Ring(NamedTuple):
    """A closed ring: its ``length_m`` and its ``hull`` in the plane."""

    length_m: float
    hull: ConvexHull


def held_share(cloth: ClothMesh, rest: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """The share (V,) of the hold near the skin that each vertex of ``cloth`` has, ``LEAST`` to 1.

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
    found, last = np.zeros(len(height)), 0.0
    for i, y in enumerate(height):
        cut = rings(cloth.faces, rest, y)
        if len(cut) == 1:
            at_height = skin[np.abs(skin[:, 1] - y) < STEP_M][:, [0, 2]]
            side = cut[0].hull.equations
            inside = at_height[(at_height @ side[:, :2].T + side[:, 2] <= 0.0).all(axis=1)]
            hull = _hull(inside)
            last = last if hull is None else cut[0].length_m / hull.area  # of a plane: its girth
        elif cut:
            last = 0.0
        found[i] = last
    return found


def rings(faces: np.ndarray, rest: np.ndarray, y: float) -> list[Ring]:
    """The closed rings in which the plane at ``y`` [m] cuts ``faces`` (F, 3) that lie at ``rest`` [m] (V, 3)."""
    above = rest[:, 1] > y
    cut = faces[above[faces].any(axis=1) & ~above[faces].all(axis=1)]
    if not len(cut):
        return []
    sides = np.sort(np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1), axis=-1)
    crossed = sides[above[sides[..., 0]] != above[sides[..., 1]]]  # two of each triangle, in turn
    edge, number, count = np.unique(crossed, axis=0, return_inverse=True, return_counts=True)
    ends = number.reshape(-1, 2)
    low, high = rest[edge[:, 0]], rest[edge[:, 1]]
    place = (low + ((y - low[:, 1]) / (high - low)[:, 1])[:, None] * (high - low))[:, [0, 2]]
    length_m = np.linalg.norm(place[ends[:, 0]] - place[ends[:, 1]], axis=1)
    links = scipy.sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(edge), len(edge)))
    parts, part = connected_components(links, directed=False)
    closed = [p for p in range(parts) if (count[part == p] == 2).all()]
    hulls = [(p, _hull(place[part == p])) for p in closed]
    return [Ring(float(length_m[part[ends[:, 0]] == p].sum()), hull) for p, hull in hulls if hull is not None]


def _hull(points: np.ndarray) -> ConvexHull | None:
    """The convex hull of ``points`` (n, 2); None where they are fewer than three or lie in a line."""
    try:
        return ConvexHull(points) if len(points) > 2 else None
    except QhullError:
        return None
