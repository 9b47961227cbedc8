"""How a garment that came without a body stands in its file: its up axis, and the way that its wearer looks.

Its openings tell both. The longest one, a hem or a waist, lies below or above the middle of the others. The two that
lie farthest apart across that axis are cuffs or legs, so their line goes from side to side. A wearer looks to the
side on which the upper opening is lower.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from drape.garment.files.mesh import GarmentMesh
from recovery.fit.contours import Contour, open_contours

CUFF_SHARE = 0.12  # of the longest opening: cuffs have a fifth of a hem, and holes that were not closed less
TURNED_RAD = 0.6  # that a garment may look aside; the body's fit finds that by itself


def long_contours(mesh: GarmentMesh) -> list[Contour]:
    """The open contours of ``mesh`` that are as long as openings, the longest first."""
    found = sorted(open_contours(mesh.vertices, mesh.faces), key=lambda one: -one.length_m)
    return [one for one in found if one.length_m > CUFF_SHARE * found[0].length_m]


def up_axis(mesh: GarmentMesh) -> str:
    """The axis, "y" or "z", along which the longest opening of ``mesh`` lies from the middle of the others."""
    first, *others = long_contours(mesh)
    if not others:
        return "y"
    way = np.abs(first.centre - np.mean([one.centre for one in others], axis=0))
    return "z" if way[2] > way[1] else "y"


def facing(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh``, y up, turned about y so that its wearer looks along +z; itself where it nearly does.

    A garment with two openings, or whose limbs lie together, is left as it is.
    """
    turn = _turn(long_contours(mesh))
    if abs(turn) < TURNED_RAD:
        return mesh
    middle = mesh.vertices.mean(axis=0)
    c, s = np.cos(turn), np.sin(turn)
    turned = (mesh.vertices - middle) @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + middle
    return replace(mesh, vertices=turned).noted(f"turned by {np.degrees(turn):.0f} degrees to look along +z")


def _turn(contours: list[Contour]) -> float:
    """The angle [rad] about y by which a garment with the openings ``contours``, longest first, has to be turned."""
    if len(contours) < 3:
        return 0.0
    pairs = [((b.centre - a.centre)[[0, 2]], a.length_m + b.length_m) for a, b in combinations(contours[1:], 2)]
    across, round_m = max(pairs, key=lambda pair: float(pair[0] @ pair[0]))
    if np.linalg.norm(across) < round_m / (2.0 * np.pi):  # they would overlap beside each other
        return 0.0
    upper = max(contours, key=lambda one: float(one.centre[1]))
    edge = upper.points - upper.centre
    # The slope of the upper opening: least squares of its height over the place in the plane.
    slope = np.linalg.lstsq(edge[:, [0, 2]], edge[:, 1], rcond=None)[0]
    front = np.array([-across[1], across[0]])
    front = -front if front @ slope > 0.0 else front
    return float(np.arctan2(-front[0], front[1]))
