"""Hems, cuffs and fronts that are turned in far: the inner side, the facing, hangs on the cloth above it.

A facing is cloth of the same piece folded back under itself: opposite to it, with the reverse normal, lies what it was
folded from, farther from the skin. Much of its rim is a border of the mesh. The middle of a pleat is folded so as well,
but its long sides both go on.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.garment.files.mesh import plain_mesh
from drape.garment.sheets import agreeing
from drape.garment.walls import FACING, farther, opposite_faces, smoothed_sides
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import SearchedMesh

SAMPLED_FACES, SAMPLED_SHARE = 1000, 0.01  # so few faces show of most garments that nothing is turned in
LEAST_M2 = 0.002  # a smaller facing is a hem, and does no harm
BORDER_SHARE = 0.3  # this share of a facing's rim is a border of the mesh


def without_facings(points: np.ndarray, faces: np.ndarray, skin: KDTree) -> np.ndarray:
    """Returns bool (F,), False for those of ``faces`` (F, 3) that belong to a facing: cloth that is turned in under
    cloth of the same piece. ``points`` [m] (N, 3) are the vertices; ``skin`` holds points [m] of the body inside."""
    keep, every = np.ones(len(faces), dtype=bool), np.arange(len(faces))
    wound, _ = agreeing(plain_mesh("cloth", points, faces))
    middles, normals = points[faces].mean(axis=1), meshes.face_normals(wound.vertices, wound.faces)
    piece = mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]

    mesh = SearchedMesh(points, faces)

    def folded_from(asked: np.ndarray) -> np.ndarray:
        """The face of the same piece (n,) that lies opposite to each ``asked`` one (n,) the other way round, or -1."""
        other = opposite_faces(mesh, asked, middles, normals)
        reverse = np.einsum("fc,fc->f", normals[asked], normals[other]) < -FACING
        return np.where((other >= 0) & reverse & (piece[other] == piece[asked]), other, -1)

    some = every[:: max(1, len(faces) // SAMPLED_FACES)]
    if (folded_from(some) >= 0).mean() < SAMPLED_SHARE:
        return keep
    other = folded_from(every)
    side = farther(middles, other, skin)
    inner = np.flatnonzero((other >= 0) & (smoothed_sides(faces, normals, other, side) < 0.0))
    region = mesh_graphs.connected_components(faces[inner], len(points))[faces[inner, 0]]
    for number in np.unique(region):
        own = inner[region == number]
        rim = meshes.boundary_edges(faces[own])
        border = np.isin(rim, meshes.boundary_vertices(faces)).all(axis=1)
        length = meshes.edge_lengths(points, rim)
        if meshes.face_areas(points, faces[own]).sum() > LEAST_M2 and border @ length > BORDER_SHARE * length.sum():
            keep[own] = False
    return keep
