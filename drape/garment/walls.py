"""Cloth drawn with a thickness: of a wall with two sides the one away from the body is kept.

Each face of a wall has one opposite to it. Which of the two is the outer one is told by their distances from the skin,
noisily where cloth is folded, so a field phi over the faces smooths it:

    min  sum_e w_e (phi_a - phi_b)^2 + P sum_f (phi_f + phi_o(f))^2 + S sum_f (phi_f - s_f)^2,

over edges e of faces a and b whose normals have the cosine sqrt(w_e), the opposite face o(f), and s_f how much farther
than that one f is from the skin, over their distance. phi is positive outside, negative inside, and near zero on the
rim, which sharp edges part from both.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import scipy.sparse as sp
from scipy.spatial import KDTree

from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import SearchedMesh
from drape.geometry.symmetric import symmetric_factor

SAME_M = 1e-5  # places so near to each other are one
PROBES_M = (0.003, 0.008, 0.015)  # below a face: a wall at up to twice the depth is nearer to the probe than the face
FACING = 0.5  # cosine between the sides of a wall, whichever way they are wound
WALLED_SHARE = 0.5  # share of a wall's area that has a second side
OWN_SHARE = 0.5  # share of this that has it in the same piece: of two sheets one lies on the other
# Most of a wall is as thin as its thin parts, by the median over the lower quartile, whatever lies beyond it elsewhere.
# Its sides lie one over the other, by the median of |s|; folds of one layer lie side by side.
EVEN, OVER = 1.6, 0.5
CLOSED_SHARE = 0.9  # share above which a piece without a border is all wall
RIM_M = 0.035  # width of the rim between the two sides
# P and S of the formula: S once for s, whose noise goes far, and once with the signs found, for which rims stand out.
PAIRED, SIDED = 0.1, (0.01, 0.5)
LEAST_COSINE = 0.01  # no edge separates its faces completely
OUTER = 0.5  # faces with less of the outer side's median phi are on the rim
SAMPLED_FACES = 4000


def outer_sides(points: np.ndarray, faces: np.ndarray, skin: KDTree) -> np.ndarray:
    """Returns bool (F,), False for those of ``faces`` (F, 3) that are the inner side or the rim of a wall, cloth drawn
    with a thickness. ``points`` [m] (N, 3): the vertices. ``skin``: points [m] of the body inside."""
    keep, piece = np.ones(len(faces), dtype=bool), mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]
    middles, normals = points[faces].mean(axis=1), meshes.face_normals(points, faces)
    areas = meshes.face_areas(points, faces)
    mesh = SearchedMesh(points, faces)
    some = np.arange(0, len(faces), max(1, len(faces) // SAMPLED_FACES))  # they show if there may be walls
    walled = opposite_faces(mesh, some, middles, normals) >= 0
    seen = np.bincount(piece[some], areas[some], minlength=len(points))
    share = np.bincount(piece[some], walled * areas[some], minlength=len(points)) / np.maximum(seen, 1e-12)
    asked = np.flatnonzero((share > 0.7 * WALLED_SHARE)[piece] | (seen == 0.0)[piece])
    if not len(asked):
        return keep
    other = np.full(len(faces), -1)
    other[asked] = opposite_faces(mesh, asked, middles, normals)
    walled, side = other >= 0, farther(middles, other, skin)
    depth = np.abs(np.einsum("fc,fc->f", normals, middles - middles[np.maximum(other, 0)]))
    share = np.bincount(piece, walled * areas) / np.maximum(np.bincount(piece, areas), 1e-12)
    for number in np.flatnonzero(share > WALLED_SHARE):
        own = np.flatnonzero(piece == number)
        low, high = np.quantile(depth[own][walled[own]], [0.25, 0.5])
        closed = share[number] > CLOSED_SHARE and not len(meshes.boundary_edges(faces[own]))
        within = np.where(np.isin(other[own], own), np.searchsorted(own, other[own]), -1)
        alone = (areas[own] * (within >= 0)).sum() > OWN_SHARE * (areas[own] * walled[own]).sum()
        if alone and (closed or (high <= EVEN * low and np.median(np.abs(side[own][walled[own]])) > OVER)):
            phi = smoothed_sides(faces[own], normals[own], within, side[own])
            keep[own] = _outer(points, faces[own], walled[own], within, phi)
    return keep


def farther(middles: np.ndarray, other: np.ndarray, skin: KDTree) -> np.ndarray:
    """Returns for each face s (F,): how much farther from the ``skin`` it is than the face ``other`` (F,) opposite to
    it, divided by the distance between the two. It is 0 where ``other`` is -1. ``middles`` [m] (F, 3): those of the
    faces."""
    height, gap = skin.query(middles)[0], np.linalg.norm(middles - middles[other], axis=1)
    return np.where(other >= 0, (height - height[other]) / np.maximum(gap, SAME_M), 0.0)


def smoothed_sides(faces: np.ndarray, normals: np.ndarray, other: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Returns phi (F,), without unit, for the ``faces`` (F, 3) of one piece: positive on the outer side of a wall,
    negative on the inner one. It smooths ``side`` (F,), what ``farther`` returns, along the faces. ``normals`` (F, 3);
    ``other`` (F,): the face opposite to each within the piece, or -1."""
    count, pairs = len(faces), meshes.edge_pairs(faces)
    weight = np.maximum(meshes.edge_cosines(pairs, normals), LEAST_COSINE) ** 2
    edges = mesh_graphs.edge_matrix(np.stack([pairs[1] // 3, pairs[2] // 3], axis=1), weight, count)
    rows = np.flatnonzero(other >= 0)
    opposite = sp.coo_matrix((np.ones(len(rows)), (rows, other[rows])), shape=(count, count)).tocsr()[rows]
    both = sp.csr_matrix(sp.identity(count))[rows] + opposite
    matrix = mesh_graphs.weighted_laplacian(edges) + 1e-9 * sp.identity(count) + PAIRED * (both.T @ both)
    seen, phi = side != 0.0, side
    for share in SIDED:
        factor = symmetric_factor(sp.csc_matrix(matrix + sp.diags(share * seen)))
        phi = factor.solve(share * np.sign(phi) * np.abs(side))
    return phi


def _outer(points: np.ndarray, faces: np.ndarray, walled: np.ndarray, other: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Which ``faces`` (F,) of a piece stay: the outer side of a wall, and what is no wall away from it. Where neither
    side is plainly the outer one, as in an armpit, that which is more so stays: cloth has no hole there."""
    outside = walled & (phi > 0.0)
    if not outside.any() or not (walled & (phi < 0.0)).any():
        return np.ones(len(faces), dtype=bool)
    outer = phi > OUTER * np.median(phi[outside])
    near, _ = KDTree(points[np.unique(faces[outside])]).query(points[faces])
    kept = outer | (~walled & (near.max(axis=1) > RIM_M))
    return kept | ((other >= 0) & ~kept[other] & (phi > phi[other]))


def opposite_faces(mesh: SearchedMesh, numbers: np.ndarray, middles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Returns the face (n,) of ``mesh`` that lies opposite to each of the faces ``numbers`` (n,) within a wall, -1
    where there is none. ``middles`` [m] and ``normals`` (F, 3): those of all faces of ``mesh``."""
    other, own, start, deepest = np.full(len(numbers), -1), normals[numbers], middles[numbers], PROBES_M[-1]
    # A probe's ball lies in that of a deeper one on its side: where that is empty of other cloth, so are all.
    near = [mesh.closest(start + sign * deepest * own).distance < (1.0 - 1e-9) * deepest for sign in (-1.0, 1.0)]
    for depth, (sign, beside) in product(PROBES_M, zip((-1.0, 1.0), near, strict=True)):
        rows = np.flatnonzero(beside & (other < 0))
        hit = mesh.closest(start[rows] + sign * depth * own[rows])
        way = hit.point - start[rows]
        length = np.linalg.norm(way, axis=1)
        straight = np.abs(np.einsum("fc,fc->f", way, own[rows])) > 0.8 * length
        facing = np.abs(np.einsum("fc,fc->f", own[rows], normals[hit.face])) > FACING
        apart = (length > SAME_M) & (hit.face != numbers[rows]) & straight & facing
        other[rows[apart]] = hit.face[apart]
    return other
