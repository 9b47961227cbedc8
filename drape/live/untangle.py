"""The triangles of a cloth as untangling takes them (``source/untangle.hpp`` of the engine).

Cloth that passes through itself is moved a little towards where it does not. The pairs of triangles that cross are
found by boxes around ``LANES`` triangles side by side and by cones around their normals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.engine.library import LANES
from drape.geometry import meshes
from drape.live.clusters import clusters

BORDER, OTHERS = -1, -2  # in ``Tangles.across``: no triangle is across; the other triangle has the edge


class Tangles(NamedTuple):
    """The triangles of a cloth as untangling takes them, in C clusters of ``LANES``.

    ``corner`` (3 C ``LANES``,) are the places of the corners in a sheet, three rows for each cluster. ``across`` has as
    many rows: the place across each edge, the first edge being that from the first to the second corner; ``BORDER``
    where there is no triangle across. An edge that two triangles share is looked at in one of them, and is ``OTHERS``
    in the other. Clusters that are not full repeat a triangle. ``beside[start[a] : start[a + 1]]`` are cluster a and
    the clusters behind it that share a corner with it.
    """

    corner: np.ndarray
    across: np.ndarray
    start: np.ndarray
    beside: np.ndarray


def tangles_of(faces: np.ndarray, place: np.ndarray) -> Tangles:
    """Returns the triangles ``faces`` (F, 3) in clusters; ``place`` (V,) is the place of each vertex in the sheet."""
    halves, first, second = meshes.edge_pairs(faces)  # half-edge 3 f + n begins at a corner of face f
    graph = scipy.sparse.coo_matrix(
        (np.ones(2 * len(first)), np.concatenate([[first, second], [second, first]], axis=1) // 3),
        shape=(len(faces), len(faces)),
    ).tocsr()
    across = np.full(len(halves), BORDER)
    across[second] = OTHERS
    across[first] = place[halves[second, 2]]
    member = clusters(graph)
    flat = [table.reshape(-1, 3)[member].transpose(0, 2, 1).reshape(-1) for table in (place[halves[:, 0]], across)]
    touched = scipy.sparse.coo_matrix(
        (np.ones(3 * member.size), (np.arange(len(member)).repeat(3 * LANES), faces[member].reshape(-1))),
        shape=(len(member), len(place)),
    ).tocsr()
    beside = scipy.sparse.csr_matrix(scipy.sparse.triu(touched @ touched.T))
    return Tangles(*(np.ascontiguousarray(table, np.int32) for table in (*flat, beside.indptr, beside.indices)))
