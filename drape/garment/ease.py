"""Ease: how much longer a garment is around the body than the body itself, at the levels of its measures.

The garment's girth is that of its cloth without stress, along the line in which a level plane cuts the drape at rest.
So it is what the pattern gives there, neither stretched by the body nor shortened by folds of the drape; ease below
zero is what the cloth has to stretch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.body.measures import landmarks, section_girth
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.cloth.rest_state import RestState
from drape.geometry.sections import Ring, Section, closed_rings, level_section

# The joint that lies in the middle of the trunk at each level, by the names of drape.body.measures.
_MIDDLE = {"chest_m": "spine3", "waist_m": "spine1", "hip_m": "pelvis"}


class Ease(NamedTuple):
    """Girths [m] around one level of the body: ``body_m`` of the body, ``garment_m`` of the garment without stress."""

    body_m: float
    garment_m: float

    @property
    def ease_m(self) -> float:
        """Returns the garment's girth minus the body's [m]; below zero the cloth has to stretch."""
        return self.garment_m - self.body_m


def eases(
    faces: np.ndarray, rest: RestState, vertices: np.ndarray, body: BodyModel, betas: np.ndarray | None = None
) -> dict[str, Ease]:
    """Returns the ease of a garment at the levels "chest_m", "waist_m" and "hip_m" of the body, without those that the
    garment does not go around. The cloth with ``faces`` (F, 3) and the rest state ``rest`` is draped at ``vertices``
    [m] (V, 3) on ``body`` with shape ``betas`` in the rest pose."""
    place, skin, joints = landmarks(body), body.rest_vertices(betas), body.rest_joints(betas)
    by_name = {}
    for name, level in place.levels(skin)._asdict().items():
        middle = joints[JOINT_NAMES.index(_MIDDLE[name])][[0, 2]]
        girth = girth_around(faces, rest, vertices, y=level, middle=middle)
        if girth is not None:
            by_name[name] = Ease(section_girth(skin, place.trunk, level), girth)
    return by_name


def girth_around(
    faces: np.ndarray, rest: RestState, vertices: np.ndarray, *, y: float, middle: np.ndarray
) -> float | None:
    """Returns the length [m], without stress as in ``rest``, of the longest closed ring of cloth at the height ``y``
    [m] around the point ``middle`` (x, z) [m]. None where there is no closed ring: the garment ends above or below, or
    is open there."""
    section = level_section(faces, vertices, y)
    around = [ring for ring in closed_rings(section, vertices) if _encloses(ring, middle)]
    if not around:
        return None
    lengths = rest_lengths(section, faces, rest)
    return max(float(lengths[ring.rows].sum()) for ring in around)


def rest_lengths(section: Section, faces: np.ndarray, rest: RestState) -> np.ndarray:
    """Returns the lengths [m] (N,) that the segments of ``section`` have on the unstressed triangles of ``rest``."""
    cut = faces[section.face]
    corners = np.concatenate([np.zeros((len(cut), 1, 2)), rest.edges[section.face]], axis=1)  # (N, 3, 2)
    rows, ends = np.arange(len(cut)), []
    for crossing in section.ends.T:
        first, second = (corners[rows, (cut == section.edge[crossing, k, None]).argmax(axis=1)] for k in (0, 1))
        ends.append(first + section.share[crossing, None] * (second - first))
    return np.linalg.norm(ends[1] - ends[0], axis=1)


def _encloses(ring: Ring, point: np.ndarray) -> bool:
    """Whether the hull of ``ring`` holds ``point`` (x, z) [m]."""
    sides = ring.hull.equations
    return bool((sides[:, :2] @ point + sides[:, 2] <= 0.0).all())
