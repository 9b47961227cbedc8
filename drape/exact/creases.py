"""Skin in a body's own creases, where there is no room for cloth, and contact with the rest of it.

Where a thigh meets the belly the two skins pass through each other. Cloth that goes with both of them is led into that
place, where no plane of the skin tells it the way out: on the skin of the belly it is deep in the thigh. So the skin
there takes no part in contact, and what is left, the outside of the body, pushes cloth out in front of the crease.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from drape.cloth.contact import BodyContact
from drape.exact.blended_planes import BlendedPlanes
from drape.geometry import meshes
from drape.geometry.triangle_pairs import crossing_pairs

ROOM_M = 0.006  # what cloth needs on either side: between skins nearer than twice this there is none
PUSHES = 3  # steps of a point along the normal of the plane above it


def without_creases(contact: BodyContact, posed: np.ndarray) -> BodyContact:
    """Returns ``contact`` without the vertices that lie in creases of the ``posed`` body [m] (Vb, 3): those that are
    hidden (``hidden_skin``) once the skin is moved ``ROOM_M`` outwards."""
    hidden = hidden_skin(posed + ROOM_M * np.asarray(contact.normals(posed)), contact.faces)
    taking_part = (
        np.ones(len(posed), bool) if contact.vertices is None else np.isin(np.arange(len(posed)), contact.vertices)
    )
    return BodyContact(contact.faces, contact.vertex_count, vertices=np.flatnonzero(taking_part & ~hidden))


def hidden_skin(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns which vertices of a closed surface ``x`` [m] (V, 3) lie in a part of it that is inside another part, bool
    (V,).

    The curves along which ``faces`` (F, 3) cross cut the surface into pieces. Of each connected surface all pieces are
    hidden but the largest. Corners of faces that cross are not hidden.
    """
    cut = np.zeros(len(x), bool)
    cut[faces[np.unique(crossing_pairs(x, faces))]] = True
    edges = meshes.unique_edges(faces)
    whole, piece = _pieces(edges, len(x)), _pieces(edges[~cut[edges].any(axis=1)], len(x))
    size = np.bincount(piece)[piece] * ~cut
    largest = np.zeros(whole.max() + 1, piece.dtype)
    order = np.argsort(size, kind="stable")
    largest[whole[order]] = piece[order]  # sizes ascend, so the last one written is the largest
    return ~cut & (piece != largest[whole])


def _pieces(edges: np.ndarray, count: int) -> np.ndarray:
    """The number (V,) of the piece of a graph of ``edges`` (E, 2) that each of ``count`` vertices belongs to."""
    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def move_out(contact: BodyContact, posed: np.ndarray, x: np.ndarray, gap_m: float) -> np.ndarray:
    """Returns the points ``x`` [m] (V, 3), those nearer to the ``posed`` body [m] (Vb, 3) than half of ``gap_m`` [m]
    moved out to that distance."""
    planes, x = BlendedPlanes.of_body(contact, posed, len(x), gap_m), x.copy()
    for _ in range(PUSHES):
        point, normal, _ = planes(x)
        square = np.maximum((normal * normal).sum(axis=1, keepdims=True), 1e-12)
        lack = 0.5 * gap_m * np.sqrt(square) - ((x - point) * normal).sum(axis=1, keepdims=True)
        x += np.maximum(lack, 0.0) / square * normal
    return x
