"""Level sections of triangle meshes: the edges that a plane crosses, closed rings, and girths around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError


class Section(NamedTuple):
    """Where a plane cuts a mesh: it crosses M edges, and N faces along a segment between two of these crossings.
    ``face`` (N,): the faces. ``edge`` (M, 2): the vertices of the edges, the smaller first. ``share`` (M,) in [0, 1]:
    the crossing's share of the way from the first to the second vertex. ``ends`` (N, 2): the crossings, as rows of
    ``edge``, at the ends of each segment."""

    face: np.ndarray
    edge: np.ndarray
    share: np.ndarray
    ends: np.ndarray

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the positions [m] (M, 3) of the crossings on the edges of a mesh at ``vertices`` [m] (V, 3)."""
        low, high = vertices[self.edge[:, 0]], vertices[self.edge[:, 1]]
        return low + self.share[:, None] * (high - low)


class Ring(NamedTuple):
    """A closed ring of a section: ``length_m``; ``hull``, its convex hull in the plane (x, z) [m]; and ``rows`` (n,),
    its segments as rows of ``Section.face``."""

    length_m: float
    hull: ConvexHull
    rows: np.ndarray


def level_section(faces: np.ndarray, vertices: np.ndarray, y: float) -> Section:
    """Returns the section of the mesh ``faces`` (F, 3), ``vertices`` [m] (V, 3) with the horizontal plane at the height
    ``y`` [m]. A vertex in the plane counts as below it, so no triangle is touched in a point alone."""
    above = vertices[:, 1] > y
    face = np.flatnonzero(above[faces].any(axis=1) & ~above[faces].all(axis=1))
    cut = faces[face]
    sides = np.sort(np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1), axis=-1)
    crossed = sides[above[sides[..., 0]] != above[sides[..., 1]]]  # two of each triangle, in turn
    edge, number = np.unique(crossed, axis=0, return_inverse=True)
    low, high = vertices[edge[:, 0], 1], vertices[edge[:, 1], 1]
    return Section(face, edge, (y - low) / (high - low), number.reshape(-1, 2))


def closed_rings(section: Section, vertices: np.ndarray) -> list[Ring]:
    """Returns the closed rings of ``section``, a level section of a mesh at ``vertices`` [m] (V, 3). A chain with loose
    ends is none."""
    place, ends = section.points(vertices)[:, [0, 2]], section.ends
    if not len(ends):
        return []
    count = np.bincount(ends.reshape(-1), minlength=len(place))
    length_m = np.linalg.norm(place[ends[:, 0]] - place[ends[:, 1]], axis=1)
    links = scipy.sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(place), len(place)))
    parts, part = connected_components(links, directed=False)
    of_segment = part[ends[:, 0]]
    rings = []
    for number in range(parts):
        hull = convex_hull(place[part == number]) if (count[part == number] == 2).all() else None
        if hull is not None:
            rows = np.flatnonzero(of_segment == number)
            rings.append(Ring(float(length_m[rows].sum()), hull, rows))
    return rings


def convex_hull(points: np.ndarray) -> ConvexHull | None:
    """Returns the convex hull of ``points`` (n, 2) as scipy's ``ConvexHull``, whose ``area`` is the perimeter in the
    plane. None where they are fewer than three, or lie on a line."""
    try:
        return ConvexHull(points) if len(points) > 2 else None
    except QhullError:
        return None
