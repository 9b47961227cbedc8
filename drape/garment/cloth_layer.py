"""One layer of cloth out of a mesh as people draw them: what is simulated in place of a mesh that is no cloth.

Vertices at the same place become one; faces without area, drawn twice, or beyond the second at an edge are left out;
of a wall with a thickness stays the side away from the body; what lies on other cloth (linings, belts, pockets) and
what is small (buttons, cards of fur) is left out too, and dense cloth is thinned. All that is left out hangs on the
cloth that stays (``drape.garment.bound``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from drape.cloth.coarse_mesh import coarse_mesh
from drape.garment.bound import BoundMesh, bind
from drape.garment.caps import SHARP, edge_cosines, smooth_parts, without_caps
from drape.garment.files.mesh import GarmentMesh, plain_mesh, weld
from drape.garment.mesh_checks import without_flat_faces
from drape.garment.rest_detail import cloth_of, rest_of
from drape.garment.sheets import cut_branches, pieces_of, samples_to, with_used_vertices, without_copies
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point

SAME_M = 1e-5  # a drawn vertex so near to one of the cloth is that
PROBES_M = (0.003, 0.008, 0.015)  # below a face: a wall at up to twice the depth is nearer than the face itself
OPPOSITE = 0.5  # cosine between the sides of a wall, whichever way they are wound
WALLED_SHARE = 0.5  # of a piece's area that must have a second side
EVEN = 1.6  # a wall is as thick everywhere: its upper quartile over the lower one
RIM_M = 0.035  # the rim between two walls
ON_M, ON_SHARE = 0.015, 0.8  # cloth that lies on other cloth with this share of its points is left out
SMALL_M2, SMALL_SHARE, NEAR_M = 0.02, 0.05, 0.03  # a small thing near cloth: its area, that over the largest piece's
SEWN_M, SEWN_SHARE, TRIM_SHARE = 0.004, 0.4, 0.15  # of a collar's border on its garment, and its area over that
STIFF_M = 0.06  # parts up to this size turn as a whole
VERTEX_LIMIT = 12_000
THINNED_M = 0.012  # edges of thinned cloth
SAMPLED_FACES = 4000

Pairs = tuple[np.ndarray, np.ndarray, np.ndarray]  # of half-edges: ``meshes.edge_pairs``


def joined(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` as sheets: copies of a vertex are one, faces without area, drawn twice or closing the end of a tube are
    left out, and edges have two faces at most. Where that changes it, the vertices of the sheets follow those of
    ``mesh``."""
    sheets = cut_branches(without_flat_faces(without_copies(weld(mesh))))
    if not (keep := without_caps(sheets.vertices, sheets.faces)).all():
        sheets = with_used_vertices(sheets.take_faces(keep)).noted(f"{int((~keep).sum())} faces close ends of tubes")
    if sheets is mesh:
        return mesh
    vertices = np.concatenate([mesh.vertices, sheets.vertices])
    return replace(sheets, vertices=vertices, faces=sheets.faces + len(mesh.vertices))


def cloth_layer(sheets: GarmentMesh, skin: np.ndarray) -> GarmentMesh:
    """The cloth of ``sheets`` [m] (``joined``), which lie round a body with the points ``skin`` [m] (S, 3).

    ``sheets`` themselves are returned where all of them is cloth.
    """
    points, faces, notes = sheets.vertices, sheets.faces, []
    keep = _single_walls(points, faces, KDTree(skin), notes)
    keep[keep] = _bearing(points, faces[keep], notes)
    cloth = sheets if keep.all() else sheets.take_faces(keep)
    cloth = _thinned(cloth, notes)
    return cloth if cloth is sheets else cloth.noted(*notes)


def hung(mesh: GarmentMesh, places: np.ndarray, cloth: GarmentMesh) -> BoundMesh:
    """``mesh`` with its vertices at ``places`` [m] (D, 3), hung on its ``cloth``."""
    distance, row = KDTree(cloth.vertices).query(places)
    row = np.where(distance <= SAME_M, row, -1)
    return bind(mesh, places, cloth.vertices, cloth.faces, row, _stiff_parts(mesh, places, row))


def _single_walls(points: np.ndarray, faces: np.ndarray, skin: KDTree, notes: list[str]) -> np.ndarray:
    """Which ``faces`` (F,) stay where walls have two sides: not the side at the body, nor the rim between them."""
    keep, piece = np.ones(len(faces), dtype=bool), mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]
    middles, normals = points[faces].mean(axis=1), meshes.face_normals(points, faces)
    areas = meshes.face_areas(points, faces)
    some = np.arange(0, len(faces), max(1, len(faces) // SAMPLED_FACES))  # of most garments they tell that it has none
    walled = _other_sides(points, faces, some, middles, normals) >= 0
    seen = np.bincount(piece[some], areas[some], minlength=len(points))
    share = np.bincount(piece[some], walled * areas[some], minlength=len(points)) / np.maximum(seen, 1e-12)
    asked = np.flatnonzero((share > 0.7 * WALLED_SHARE)[piece] | (seen == 0.0)[piece])
    if not len(asked):
        return keep
    other = np.full(len(faces), -1)
    other[asked] = _other_sides(points, faces, asked, middles, normals)
    walled, height = other >= 0, skin.query(middles)[0]
    rise = np.where(walled, height - height[np.maximum(other, 0)], 0.0)
    gap = np.abs(np.einsum("fc,fc->f", normals, middles - middles[np.maximum(other, 0)]))
    share = np.bincount(piece, walled * areas) / np.maximum(np.bincount(piece, areas), 1e-12)
    for number in np.flatnonzero(share > WALLED_SHARE):
        own = np.flatnonzero(piece == number)
        low, high = np.quantile(gap[own][walled[own]], [0.25, 0.75])
        if high > EVEN * low:  # folds
            continue
        pairs = meshes.edge_pairs(faces[own])
        ends = pairs[1] // 3, pairs[2] // 3
        smooth = (edge_cosines(pairs, normals[own]) > SHARP) & (walled[own][ends[0]] == walled[own][ends[1]])
        label = smooth_parts(len(own), *ends, smooth)
        area, lift = np.bincount(label, areas[own]), np.bincount(label, areas[own] * rise[own])
        side = (np.bincount(label, walled[own]) > 0) & (area > 0.05 * area.sum())
        inner, outer = side & (lift < 0.0), side & (lift >= 0.0)
        if inner.any() and outer.any():
            near, _ = KDTree(points[np.unique(faces[own[outer[label]]])]).query(points[faces[own]])
            rims = ~side & (_most(label, near.max(axis=1)) < RIM_M)
            keep[own[_beside(pairs, label, inner, outer, rims)[label]]] = False
    if not keep.all():
        notes.append(f"{int((~keep).sum())} faces are the inner side of walls with a thickness")
    return keep


def _most(label: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The largest of ``values`` (F,) for every number of ``label`` (F,)."""
    found = np.zeros(int(label.max()) + 1)
    np.maximum.at(found, label, values)
    return found


def _beside(pairs: Pairs, label: np.ndarray, inner: np.ndarray, outer: np.ndarray, rims: np.ndarray) -> np.ndarray:
    """Which parts (n,) go: the ``inner`` ones, and ``rims`` that have at least as many edges with these as with the
    ``outer`` ones."""
    count = len(inner)
    ends = label[pairs[1] // 3], label[pairs[2] // 3]
    edges = scipy.sparse.coo_matrix((np.ones(len(ends[0])), ends), shape=(count, count)).tocsr()
    edges, gone, stays = edges + edges.T, inner, outer
    while True:
        to_gone, to_stays = edges @ gone, edges @ stays
        joins = rims & ~gone & (to_gone > 0) & (to_gone >= to_stays)
        if not joins.any():
            return gone
        gone = gone | joins


def _other_sides(
    points: np.ndarray, faces: np.ndarray, asked: np.ndarray, middles: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """The face (n,) opposite to each ``asked`` one (n,) within a wall, -1 where there is none."""
    other, own, start = np.full(len(asked), -1), normals[asked], middles[asked]
    probes = [start + sign * depth * own for depth in PROBES_M for sign in (-1.0, 1.0)]
    found = closest_point(np.concatenate(probes), points, faces)
    for face, point in zip(np.split(found.face, len(probes)), np.split(found.point, len(probes)), strict=True):
        way = point - start
        length = np.linalg.norm(way, axis=1)
        straight = np.abs(np.einsum("fc,fc->f", way, own)) > 0.8 * length
        facing = np.abs(np.einsum("fc,fc->f", own, normals[face])) > OPPOSITE
        apart = (length > SAME_M) & (face != asked) & straight & facing
        other = np.where((other < 0) & apart, face, other)
    return other


def _bearing(points: np.ndarray, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Which ``faces`` (F,) are of pieces that bear themselves."""
    piece, _, bears = bearing_pieces(points, faces)
    if not bears.all():
        notes.append(f"{int((~bears).sum())} of {len(bears)} pieces lie on the others and hang on them")
    return bears[piece]


def bearing_pieces(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The piece (F,) of every face, the largest first, the areas (P,) of the pieces [m^2], and which (P,) are cloth by
    themselves: they do not lie on other cloth, are not sewn to a much larger piece, and are no small things near it.
    """
    piece, area = pieces_of(points, faces)
    small = area < min(SMALL_M2, SMALL_SHARE * area[0])
    bears = np.zeros(len(area), dtype=bool)
    bears[0] = True
    for number in np.flatnonzero(~small)[1:]:
        _, distance, border = samples_to(points, faces[piece == number], faces[bears[piece]])
        sewn = any(_trims(points, faces[piece == number], faces[piece == other]) for other in range(number)
                   if bears[other] and area[number] < TRIM_SHARE * area[other])  # fmt: skip
        bears[number] = ((distance < ON_M) & ~border).mean() < ON_SHARE and not sewn
    for number in np.flatnonzero(small & (area > 0.1 * SMALL_M2)):
        _, distance, _ = samples_to(points, faces[piece == number], faces[bears[piece]])
        bears[number] = (distance < NEAR_M).mean() < 0.5
    return piece, area, bears


def _trims(points: np.ndarray, faces: np.ndarray, others: np.ndarray) -> bool:
    """Whether a piece of ``faces`` is sewn onto that of ``others`` by its border, as a collar or a lapel."""
    border = meshes.boundary_edges(faces)
    if not len(border):
        return False
    length = meshes.edge_lengths(points, border)
    near = closest_point(points[border].mean(axis=1), points, others).distance < SEWN_M
    return float(length[near].sum()) > SEWN_SHARE * float(length.sum())


def _thinned(mesh: GarmentMesh, notes: list[str]) -> GarmentMesh:
    """``mesh`` with at most ``VERTEX_LIMIT`` vertices, some of its own; then without texture coordinates."""
    used, faces = meshes.in_use(mesh.faces)
    if len(used) <= VERTEX_LIMIT:
        return mesh
    points = mesh.vertices[used]
    area = float(meshes.face_areas(points, faces).sum())
    edge_m = max(THINNED_M, float(np.sqrt(area / (0.5 * np.sqrt(3.0) * 0.95 * VERTEX_LIMIT))))
    plain = plain_mesh(mesh.name, points, faces)
    cloth = cloth_of(points, faces, (plain.uv, plain.uv_faces), (plain.material_names, plain.face_material))
    thin = coarse_mesh(rest_of(cloth, "modelled")[0], points, faces, edge_m)
    notes.append(f"{len(used):,} vertices of cloth are simulated as {len(thin.vertex):,}")
    return plain_mesh(mesh.name, points[thin.vertex], thin.faces).noted(*mesh.notes)


def _stiff_parts(mesh: GarmentMesh, places: np.ndarray, row: np.ndarray) -> np.ndarray:
    """The number (D,) of the stiff part that a vertex belongs to, -1 for what bends."""
    label = mesh_graphs.connected_components(mesh.faces, len(places))
    _, first, at = np.unique(places, axis=0, return_index=True, return_inverse=True)
    pairs = np.stack([label, label[first[at.reshape(-1)]]], axis=1)  # what a seam of the texture parts is one
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(places),) * 2)
    label = csgraph.connected_components(graph, directed=False)[1][label]
    count = int(label.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, places)
    np.maximum.at(high, label, places)
    stiff = np.linalg.norm(high - low, axis=1) < STIFF_M
    stiff[label[row >= 0]] = False
    return np.where(stiff[label], label, -1)
