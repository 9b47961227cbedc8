"""Panels of a pattern that a file has as pieces of their own, sewn along their borders.

Design programs write a garment panel by panel, each often a wall with a thickness. Of walls the outer side stays, and
where the borders of two pieces run along each other their vertices become one. A lining, a pocket or a collar that lies
on other cloth is not sewn to it: it hangs there (``cloth_layer``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from drape.garment.cloth_layer import bearing_pieces
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import cut_branches
from drape.garment.walls import outer_sides
from drape.geometry import mesh_graphs, meshes

SEAM_M = 0.003  # between the borders of two pieces
NEIGHBOURS = 6  # of a border's vertex that are looked at, until one is of another piece
SEAM_SHARE = 0.05  # of a piece's border that runs along the others'


def with_sewn_panels(sheets: GarmentMesh, skin: np.ndarray) -> GarmentMesh:
    """``sheets`` [m] (``cloth_layer.joined``) round a body with the points ``skin`` [m] (S, 3), without the inner sides
    of walls, and its panels sewn; themselves where no two pieces have a seam.

    Vertices stay in their places and their order; those that become one follow them.
    """
    points = sheets.vertices
    if len(np.unique(mesh_graphs.connected_components(sheets.faces, len(points))[sheets.faces[:, 0]])) == 1:
        return sheets
    outer = outer_sides(points, sheets.faces, KDTree(skin))
    faces = sheets.faces[outer]
    row = _seams(points, faces)
    if row is None:
        return sheets
    sewn = row[faces]
    whole = (sewn != np.roll(sewn, 1, axis=1)).all(axis=1)
    kept = np.flatnonzero(outer)[whole]
    joined = cut_branches(replace(sheets.take_faces(kept), faces=sewn[whole]))
    pieces = int((row != np.arange(len(row))).sum())
    joined = joined.noted(f"{pieces} vertices are sewn to other panels")
    if len(joined.vertices) == len(points):
        return joined
    return replace(joined, vertices=np.concatenate([points, joined.vertices]), faces=joined.faces + len(points))


def _seams(points: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """The row (N,) that each vertex has after sewing; None where nothing is sewn."""
    piece, area, bears = bearing_pieces(points, faces)
    if bears.sum() < 2:
        return None
    borders = [np.unique(meshes.boundary_edges(faces[piece == number])) for number in np.flatnonzero(bears)]
    own = np.concatenate(borders)
    whose = np.repeat(np.flatnonzero(bears), [len(border) for border in borders])
    if not len(own):
        return None
    count = min(NEIGHBOURS, len(own))
    distance, near = KDTree(points[own]).query(points[own], k=count, distance_upper_bound=SEAM_M)
    distance, near = distance.reshape(len(own), count), near.reshape(len(own), count)
    other = np.isfinite(distance) & (whose[np.minimum(near, len(own) - 1)] != whose[:, None])
    mate = np.where(other.any(axis=1), np.take_along_axis(near, other.argmax(axis=1)[:, None], axis=1)[:, 0], -1)
    mutual = (mate >= 0) & (mate[mate] == np.arange(len(own)))
    share = np.bincount(whose, mate >= 0, minlength=len(area)) / np.maximum(np.bincount(whose, minlength=len(area)), 1)
    mutual &= (share[whose] > SEAM_SHARE) & (share[whose[mate]] > SEAM_SHARE)
    if not mutual.any():
        return None
    ends = own[mutual], own[mate[mutual]]
    graph = scipy.sparse.coo_matrix((np.ones(mutual.sum()), ends), shape=(len(points),) * 2)
    number, label = csgraph.connected_components(graph, directed=False)
    first = np.full(number, len(points))
    np.minimum.at(first, label, np.arange(len(points)))
    return first[label]
