"""How a garment that came without a body stands in its file: its up axis, and the way that its wearer looks.

Its openings tell both. The longest one, a hem or a waist, lies below or above the middle of the others. The two that
lie farthest apart across that axis are cuffs or legs, so their line goes from side to side. To which of both sides a
wearer looks the body tells that is fitted inside; that the upper opening is mostly lower in front is a cue beside it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from drape.garment.contours import Contour, open_contours
from drape.garment.files.mesh import GarmentMesh

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


def facing(mesh: GarmentMesh) -> tuple[GarmentMesh, int]:
    """``mesh``, y up, turned about y by at most a right angle until its limbs lie side by side, and a cue of its front.

    The mesh is itself where they nearly do. The cue is 1 where the upper opening is lower on the side of +z, -1 where
    it is lower on the other, and 0 for a garment with two openings, or whose limbs lie together: it is left as it is.
    """
    turn, cue = _turn(long_contours(mesh))
    return (mesh if abs(turn) < TURNED_RAD else turned_about(mesh, turn)), cue


def turned_about(mesh: GarmentMesh, turn_rad: float) -> GarmentMesh:
    """``mesh`` turned about y by ``turn_rad``, with a note."""
    middle = mesh.vertices.mean(axis=0)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    vertices = (mesh.vertices - middle) @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + middle
    return replace(mesh, vertices=vertices).noted(f"turned by {np.degrees(turn_rad):.0f} degrees to look along +z")


def _turn(contours: list[Contour]) -> tuple[float, int]:
    """The turn [rad] and the cue of ``facing`` for a garment with the openings ``contours``, longest first."""
    if len(contours) < 3:
        return 0.0, 0
    limbs = max(
        combinations(contours[1:], 2), key=lambda pair: np.linalg.norm((pair[1].centre - pair[0].centre)[[0, 2]])
    )
    across = (limbs[1].centre - limbs[0].centre)[[0, 2]]
    if np.linalg.norm(across) < (limbs[0].length_m + limbs[1].length_m) / (2.0 * np.pi):  # they would overlap
        return 0.0, 0
    # A low back's middle lies below those of armholes.
    upper = max((one for one in contours if one not in limbs), key=lambda one: float(one.centre[1]))
    edge = upper.points - upper.centre
    # The slope of the upper opening: least squares of its height over the place in the plane.
    slope = np.linalg.lstsq(edge[:, [0, 2]], edge[:, 1], rcond=None)[0]
    front = np.array([-across[1], across[0]]) * (1.0 if across[0] >= 0.0 else -1.0)
    return float(np.arctan2(-front[0], front[1])), -1 if front @ slope > 0.0 else 1
