"""A tailor's measures of a body at rest: its height, girths, reaches and weight.

Names are those of ISO 8559-1. Levels and points are vertices of the body, found on its template and followed through
its shapes, so that measures change smoothly with the shape. A tape does not enter hollows: a girth is the perimeter of
the convex hull of a horizontal section.

| measure | from | ISO 8559-1 |
|---|---|---|
| ``height_m`` | the soles to the crown | stature |
| ``chest_m`` | the section through the point of the chest that reaches furthest forward | bust girth |
| ``waist_m`` | the section where the template is narrowest between hip and chest | waist girth |
| ``hip_m`` | the section through the point of the seat that reaches furthest back | hip girth |
| ``inseam_m`` | the soles to the crotch, the lowest point of the middle plane between the legs | inside leg height |
| ``sleeve_m`` | shoulder joint, elbow, wrist, mean of both arms | outer arm length, of a stretched arm |
| ``shoulder_m`` | the skin right above one shoulder joint to that above the other | shoulder breadth |
| ``weight_kg`` | the volume times ``DENSITY_KG_M3`` | body mass |
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import BodyError
from drape.geometry import meshes
from drape.geometry.sections import convex_hull

DENSITY_KG_M3 = 985.0  # Density in quiet breathing: 945 after a deep breath, 1,060 without air in the lungs.
# Shares of the template's height: from the middle plane, within which a vertex counts as on it; and beside a shoulder
# joint, within which the highest skin is right above it.
MIDDLE_SHARE, ABOVE_SHARE = 0.003, 0.01
LEVEL_COUNT = 60  # The template's waist is sought at so many heights.
_ARMS = [i for i, name in enumerate(JOINT_NAMES) if name.split("_")[-1] in ("shoulder", "elbow", "wrist", "hand")]
_PELVIS, _KNEE, _CHEST = (JOINT_NAMES.index(name) for name in ("pelvis", "left_knee", "spine3"))
_SHOULDERS = [JOINT_NAMES.index(name) for name in ("left_shoulder", "right_shoulder")]
SLEEVES = np.array(
    [[JOINT_NAMES.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")] for side in ("left", "right")]
)


class Measures(NamedTuple):
    """Measures of one body, lengths [m] and weight [kg]."""

    height_m: float
    chest_m: float
    waist_m: float
    hip_m: float
    inseam_m: float
    sleeve_m: float
    shoulder_m: float
    weight_kg: float


class SectionHeights(NamedTuple):
    """Heights [m] of the horizontal sections at chest, waist and hip, in the frame of the body at rest."""

    chest_m: float
    waist_m: float
    hip_m: float


class Tape(NamedTuple):
    """A tape around a horizontal section of a mesh.

    ``edge`` (n, 2) are the edges that the section crosses, as vertices, and ``share`` (n,) in [0, 1] is where it
    crosses them, from the first vertex to the second. ``hull`` is the convex hull of these points' x and z [m].
    """

    edge: np.ndarray
    share: np.ndarray
    hull: ConvexHull


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places of one body that measures are taken at.

    ``chest``, ``seat``, ``crotch`` and ``shoulders`` (2,) are indices of vertices. ``waist_share`` in [0, 1] is how far
    the waist lies on the way from the height of the seat to that of the chest. ``trunk`` (E, 2) are all edges but those
    of the arms.
    """

    chest: int
    seat: int
    crotch: int
    shoulders: np.ndarray
    waist_share: float
    trunk: np.ndarray

    def levels(self, vertices: np.ndarray) -> SectionHeights:
        """Returns the heights y [m] of the sections of the body with the rest ``vertices`` [m] (V, 3), in any of its
        shapes. They are linear in ``vertices``."""
        chest, seat = float(vertices[self.chest, 1]), float(vertices[self.seat, 1])
        return SectionHeights(chest, seat + self.waist_share * (chest - seat), seat)


@lru_cache(maxsize=8)
def landmarks(body: BodyModel) -> Landmarks:
    """Returns the landmarks of ``body``. Raises ``BodyError`` for one whose mesh does not have them."""
    template, joints = body.v_template, body.joints_template
    arms = body.weights[:, _ARMS].sum(axis=1)
    edges = meshes.unique_edges(body.faces)
    trunk = edges[(arms[edges] <= 0.5).all(axis=1)]
    (x, y, z), size = template.T, float(np.ptp(template[:, 1]))
    pelvis, knee, spine = joints[_PELVIS], joints[_KNEE], joints[_CHEST]
    chest = _extreme(z, (y > spine[1]) & (y < joints[_SHOULDERS[0], 1]) & (arms < 0.1), "chest")
    seat = _extreme(-z, (y > 0.5 * (pelvis + knee)[1]) & (y < spine[1]) & (arms < 0.1), "seat")
    between = (np.abs(x - pelvis[0]) < MIDDLE_SHARE * size) & (y > knee[1]) & (y < spine[1])
    crotch = _extreme(-y, between, "crotch")
    above = [np.hypot(x - at[0], z - at[2]) < ABOVE_SHARE * size for at in joints[_SHOULDERS]]
    shoulders = np.array([_extreme(y, near, "shoulders") for near in above])
    levels = np.linspace(y[seat], y[chest], LEVEL_COUNT + 2)[1:-1]
    narrowest = int(np.argmin([section_girth(template, trunk, level) for level in levels]))
    return Landmarks(chest, seat, crotch, shoulders, (narrowest + 1) / (LEVEL_COUNT + 1), trunk)


def _extreme(values: np.ndarray, among: np.ndarray, name: str) -> int:
    """The vertex of the largest of ``values`` (V,) ``among`` (V,) those that come in question."""
    if not among.any():
        cure = "Use a body that stands in the T-pose, in metres, y up, facing +z."
        raise BodyError(f"body {name}", expected="a vertex there", got="none", cure=cure)
    return int(np.argmax(np.where(among, values, -np.inf)))


def section_girth(vertices: np.ndarray, edges: np.ndarray, y: float) -> float:
    """Returns the girth [m] of ``edges`` (E, 2) of ``vertices`` [m] (V, 3) at the height ``y`` [m]: the perimeter of
    the convex hull of their section. Raises ``BodyError`` as ``section_tape`` does."""
    return float(section_tape(vertices, edges, y).hull.area)  # SciPy calls a plane hull's perimeter its area.


def section_tape(vertices: np.ndarray, edges: np.ndarray, y: float) -> Tape:
    """Returns the tape around ``edges`` (E, 2) of ``vertices`` [m] (V, 3) at the height ``y`` [m]. Raises ``BodyError``
    for a height that no edge crosses."""
    above = vertices[:, 1] > y
    crossed = edges[above[edges[:, 0]] != above[edges[:, 1]]]
    low, high = vertices[crossed[:, 0]], vertices[crossed[:, 1]]
    share = (y - low[:, 1]) / (high[:, 1] - low[:, 1])
    hull = convex_hull((low + share[:, None] * (high - low))[:, [0, 2]])
    if hull is None:
        cure = "Use a body that stands in the T-pose, in metres, y up."
        raise BodyError("body section", expected=f"skin at the height {y:.3f} m", got="none", cure=cure)
    return Tape(crossed, share, hull)


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Returns the volume [m^3] inside the closed surface ``faces`` (F, 3) of ``vertices`` [m] (V, 3), by Gauss's
    theorem."""
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("fc,fc->", first, np.cross(second, third)) / 6.0)


def measures(body: BodyModel, betas: np.ndarray | None = None) -> Measures:
    """Returns the measures of ``body`` at rest in the shape ``betas`` (S,), its mean shape by default. Raises
    ``BodyError`` for a body without the landmarks."""
    place, vertices, joints = landmarks(body), body.rest_vertices(betas), body.rest_joints(betas)
    chest, waist, hip = (section_girth(vertices, place.trunk, level) for level in place.levels(vertices))
    soles = float(vertices[:, 1].min())
    first, second = vertices[place.shoulders]
    return Measures(
        height_m=float(vertices[:, 1].max()) - soles,
        chest_m=chest,
        waist_m=waist,
        hip_m=hip,
        inseam_m=float(vertices[place.crotch, 1]) - soles,
        sleeve_m=_sleeve(joints),
        shoulder_m=float(np.linalg.norm(first - second)),
        weight_kg=DENSITY_KG_M3 * enclosed_volume(vertices, body.faces),
    )


def _sleeve(joints: np.ndarray) -> float:
    """From shoulder over elbow to wrist [m], the mean of both arms, at rest ``joints`` [m] (24, 3)."""
    return float(np.linalg.norm(np.diff(joints[SLEEVES], axis=1), axis=2).sum(axis=1).mean())
