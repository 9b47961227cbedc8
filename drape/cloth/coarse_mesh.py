"""A coarse cloth on some of a garment's vertices, at rest as the fine one is.

Half-edges collapse, the shortest first, each triangle in its own chart along warp and weft: neither lengths nor grain
are lost. Vertices on seams, creases and borders go along these (``drape/engine/source/collapse.hpp``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.cloth.rest_state import RestState
from drape.engine.calls import call_with_scratch
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices

EDGE_M = 0.026
CREASE_RAD = 0.2  # a hinge with a larger angle at rest is a crease
# An edge that differs in two charts by this share of its length is a seam; panels have no larger share of seams.
APART, SEAMS_MOST = 1e-3, 0.1
LONGEST = 1.7  # the longest edge, in mean edges that are asked for
LINES = 4  # the most edges on lines (seams, creases, borders) that are kept of a vertex


@dataclass(frozen=True, eq=False)
class CoarseMesh:
    """A coarse mesh of n of a cloth's vertices: ``vertex`` (n,) are their indices in the fine mesh, ``faces`` (f, 3)
    index ``vertex``, and ``rest`` is the rest state of ``faces``."""

    vertex: np.ndarray
    faces: np.ndarray
    rest: RestState


def coarse_mesh(
    rest: RestState, vertices: np.ndarray, faces: np.ndarray, edge_m: float = EDGE_M, *, least: int = 0
) -> CoarseMesh:
    """Returns a coarse mesh of the cloth with ``vertices`` [m] (V, 3), ``faces`` (F, 3) and the rest state ``rest``.

    The mean of its edges is about ``edge_m`` [m], where seams and creases leave room for that. It has ``least``
    vertices or more, but at most a third of V.
    """
    count, hinges = len(vertices), meshes.hinges(faces)
    wanted = rest.face_area.sum() / (0.5 * np.sqrt(3.0) * edge_m**2)  # equilateral triangles, two for each vertex
    target = min(max(wanted, least), count / 3.0)
    edge_m = np.sqrt(rest.face_area.sum() / (0.5 * np.sqrt(3.0) * target))
    corner = np.zeros((len(faces), 3, 2))
    corner[:, 1:] = rest.edges
    creased = np.ascontiguousarray(hinges[np.abs(rest.hinge_angle) > CREASE_RAD, :2], np.int32)
    left, lines = faces.astype(np.int32, order="C"), np.full((count, LINES), -1, np.int32)
    alive = np.empty(len(faces), bool)
    given = (left, len(left), corner, lines, count, creased, len(creased), int(_of_panels(corner, faces)))
    call_with_scratch("collapse", np.float64, *given, int(target), LONGEST * edge_m, alive)
    left, corner = left[alive], corner[alive]
    vertex = np.unique(left)
    small = np.searchsorted(vertex, left)
    edges = corner[:, 1:] - corner[:, :1]
    found = meshes.hinges(small)
    ends = vertex[found[:, :2]]
    _, near = nearest_vertices(vertices[ends].mean(axis=1), vertices[hinges[:, :2]].mean(axis=1))
    on_line = (lines[ends[:, 0]] == ends[:, 1:]).any(axis=1)
    angle = np.where(on_line, rest.hinge_angle[near], 0.0)
    return CoarseMesh(vertex, small, RestState(edges, angle, rest.stiffening[near]))


def _of_panels(corner: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the charts of ``faces`` (F, 3), with the places ``corner`` (F, 3, 2), are those of panels, which differ
    at seams alone; where warp is laid on a mesh they differ everywhere."""
    ways = (np.roll(corner, -1, axis=1) - corner).reshape(-1, 2)
    _, first, second = meshes.edge_pairs(faces)
    apart = np.linalg.norm(ways[first] + ways[second], axis=1) > APART * np.linalg.norm(ways[first], axis=1)
    return float(apart.mean()) < SEAMS_MOST
