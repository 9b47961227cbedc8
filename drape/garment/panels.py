"""Panels of a pattern that a file has as pieces of their own, sewn along their borders.

Design programs write a garment panel by panel, each often a wall with a thickness. Of walls the outer side stays, and
where the borders of two pieces run along each other their vertices become one. A lining, a pocket or a collar that lies
on other cloth is not sewn to it: it hangs there (``cloth_layer``).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from drape.garment.cloth_layer import bearing_pieces
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import without_flat_faces
from drape.garment.sheets import cut_branches
from drape.garment.walls import outer_sides
from drape.geometry import mesh_graphs, meshes

SEAM_M = 0.003  # most distance between the borders of sewn pieces
NEIGHBOURS = 6  # so many neighbours of a border's vertex are searched for one of another piece
SEAM_SHARE = 0.05  # share of a piece's border that runs along others', if it is sewn
END = 0.05  # a vertex nearer than this share of an edge to its end, or to another cut, does not cut it


def with_sewn_panels(sheets: GarmentMesh, skin: np.ndarray) -> tuple[GarmentMesh, np.ndarray]:
    """Returns ``sheets`` [m] (``join_sheets``) with the panels of a pattern sewn to each other, and bool (F,) for its
    faces, True for outer sides (``walls.outer_sides``). If no two pieces have a seam, ``sheets`` themselves are
    returned. Otherwise only outer sides are left. The vertices of ``sheets`` keep their rows; vertices that sewing
    makes come after them. ``skin`` [m] (S, 3): points of the body inside."""
    points = sheets.vertices
    outer = outer_sides(points, sheets.faces, KDTree(skin))
    faces = sheets.faces[outer]
    piece, row = _seams(points, faces)
    if row is None:
        return sheets, outer
    sewn = row[faces]
    whole = (sewn != np.roll(sewn, 1, axis=1)).all(axis=1)
    joined = replace(sheets.take_faces(np.flatnonzero(outer)[whole]), faces=sewn[whole])
    joined = cut_branches(without_flat_faces(_with_split_borders(joined, piece[whole])))
    joined = joined.noted(f"{int((row != np.arange(len(row))).sum())} vertices are sewn to other panels")
    if len(joined.vertices) != len(points):
        joined = replace(joined, vertices=np.concatenate([points, joined.vertices]), faces=joined.faces + len(points))
    return joined, np.ones(len(joined.faces), dtype=bool)


def _with_split_borders(mesh: GarmentMesh, piece: np.ndarray) -> GarmentMesh:
    """``mesh``, faces of which are of the ``piece`` (F,), where the faces at a border have a corner for each vertex of
    another piece's border that lies on it: a seam has no more vertices on one side than on the other."""
    halves = meshes.half_edges(mesh.faces)
    used, cut, uv_cut, parent = set(), [], [], []
    uv, count = [mesh.uv], len(mesh.uv)
    for half, inserted in sorted(_vertices_on_borders(mesh, halves, piece).items(), key=lambda item: -len(item[1])):
        face, corner = divmod(half, 3)
        if face in used:  # a face with two such edges is cut at one
            continue
        used.add(face)
        start, end, top = halves[half]
        cut += [[a, b, top] for a, b in pairwise([start, *(vertex for _, vertex in inserted), end])]
        parent += [face] * (len(inserted) + 1)
        if len(mesh.uv_faces):
            first, last, above = np.roll(mesh.uv_faces[face], -corner)
            share = np.array([along for along, _ in inserted])[:, None]
            uv.append((1.0 - share) * mesh.uv[first] + share * mesh.uv[last])
            uv_cut += [[a, b, above] for a, b in pairwise([first, *range(count, count + len(inserted)), last])]
            count += len(inserted)
    if not cut:
        return mesh
    stays = np.setdiff1d(np.arange(len(mesh.faces)), list(used))
    kept = mesh.take_faces(np.concatenate([stays, parent]).astype(np.int64))
    faces = np.concatenate([mesh.faces[stays], np.array(cut, dtype=mesh.faces.dtype)])
    if not uv_cut:
        return replace(kept, faces=faces)
    uv_faces = np.concatenate([mesh.uv_faces[stays], np.array(uv_cut, dtype=mesh.uv_faces.dtype)])
    return replace(kept, faces=faces, uv=np.concatenate(uv), uv_faces=uv_faces)


def _vertices_on_borders(
    mesh: GarmentMesh, halves: np.ndarray, piece: np.ndarray
) -> dict[int, list[tuple[float, int]]]:
    """For half-edges at a border the vertices of other pieces' borders on them, each with its share of the way."""
    points = mesh.vertices
    number, counts = meshes.edges_of_halves(halves)
    edge = np.flatnonzero(counts[number] == 1)
    if not len(edge):
        return {}
    loose, at = np.unique(halves[edge, 0], return_index=True)
    start, way = points[halves[edge, 0]], points[halves[edge, 1]] - points[halves[edge, 0]]
    count = min(NEIGHBOURS, len(edge))
    near = KDTree(start + 0.5 * way).query(points[loose], k=count)[1].reshape(len(loose), count)
    gap, ways = points[loose][:, None] - start[near], way[near]
    along = np.einsum("vkc,vkc->vk", gap, ways) / np.maximum(np.einsum("vkc,vkc->vk", ways, ways), 1e-18)
    off = np.linalg.norm(gap - along[:, :, None] * ways, axis=2)
    fits = (off < SEAM_M) & (along > END) & (along < 1.0 - END)
    fits &= piece[edge[near] // 3] != piece[edge[at] // 3][:, None]
    fits &= (halves[edge[near], :2] != loose[:, None, None]).all(axis=2)
    by_half: dict[int, list[tuple[float, int]]] = {}
    for v in np.flatnonzero(fits.any(axis=1)):
        k = int(np.where(fits[v], off[v], np.inf).argmin())
        by_half.setdefault(int(edge[near[v, k]]), []).append((float(along[v, k]), int(loose[v])))
    return {half: _apart(sorted(inserted)) for half, inserted in by_half.items()}


def _apart(inserted: list[tuple[float, int]]) -> list[tuple[float, int]]:
    """Those of ``found`` that are an ``END`` behind the one before."""
    spaced = inserted[:1]
    for along, vertex in inserted[1:]:
        if along > spaced[-1][0] + END:
            spaced.append((along, vertex))
    return spaced


def _seams(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """The piece (F,) of each face, and the row (N,) that each vertex has after sewing; None where nothing is sewn."""
    piece, area, bears = bearing_pieces(points, faces)
    if bears.sum() < 2:
        return piece, None
    borders = [np.unique(meshes.boundary_edges(faces[piece == number])) for number in np.flatnonzero(bears)]
    own = np.concatenate(borders)
    whose = np.repeat(np.flatnonzero(bears), [len(border) for border in borders])
    if not len(own):
        return piece, None
    count = min(NEIGHBOURS, len(own))
    distance, near = KDTree(points[own]).query(points[own], k=count, distance_upper_bound=SEAM_M)
    distance, near = distance.reshape(len(own), count), near.reshape(len(own), count)
    other = np.isfinite(distance) & (whose[np.minimum(near, len(own) - 1)] != whose[:, None])
    mate = np.where(other.any(axis=1), np.take_along_axis(near, other.argmax(axis=1)[:, None], axis=1)[:, 0], -1)
    mutual = (mate >= 0) & (mate[mate] == np.arange(len(own)))
    share = np.bincount(whose, mate >= 0, minlength=len(area)) / np.maximum(np.bincount(whose, minlength=len(area)), 1)
    mutual &= (share[whose] > SEAM_SHARE) & (share[whose[mate]] > SEAM_SHARE)
    if not mutual.any():
        return piece, None
    label = mesh_graphs.joined_parts(len(points), own[mutual], own[mate[mutual]])
    _, first = np.unique(label, return_index=True)
    return piece, first[label]
