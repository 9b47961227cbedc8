"""Cuts off hems that are turned in: their edge lies across the opening, as the rim of a hole does in the cloth.

The cloth of such a hem looks along the opening's axis, in a strip that ends at the fold. About a hole it goes on so.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.garment.borders import Loop, borders, plainly_opening
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import with_used_vertices
from drape.geometry import meshes

ACROSS = 0.5  # cosine between an opening's axis and the normals of a hem that is turned in; a cuff's cloth has 0.2
SMOOTH = 0.7  # cosine between neighbours of one strip: a fold is sharper
WIDE_SHARE = 0.06  # of the root of the area: no hem is as wide, and the cloth about a hole is wider
ALL_ROUND = 0.9  # of an edge that the strip has


def without_turned_hems(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh``, whose faces agree in orientation, cut off at the folds of hems that are turned in."""
    normals = meshes.face_normals(mesh.vertices, mesh.faces)
    pairs = np.stack(meshes.edge_pairs(mesh.faces)[1:]) // 3
    pairs = pairs[:, (normals[pairs[0]] * normals[pairs[1]]).sum(axis=1) > SMOOTH]
    strips = [_strip(mesh, one, normals, *pairs) for one in borders(mesh) if not plainly_opening(one)]
    strips = [strip for strip in strips if strip.any()]
    if not strips:
        return mesh
    kept = with_used_vertices(mesh.take_faces(~np.any(strips, axis=0)))
    return kept.noted(f"cut off {len(strips)} hems that are turned in, at their folds")


def _strip(mesh: GarmentMesh, one: Loop, normals: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The faces (F,) of the hem with the edge ``one``, True for them; none where it is not turned in.

    ``a`` and ``b`` (P,) are neighbours without a fold between them.
    """
    across = np.abs(normals @ one.axis) > ACROSS
    on = across[a] & across[b]
    graph = scipy.sparse.coo_matrix((np.ones(on.sum()), (a[on], b[on])), shape=(len(normals),) * 2)
    piece = csgraph.connected_components(graph, directed=False)[1]
    strip = across & np.isin(piece, piece[np.isin(mesh.faces, one.loop).any(axis=1) & across])
    area = meshes.face_areas(mesh.vertices, mesh.faces)
    wide = WIDE_SHARE * np.sqrt(area.sum())
    if np.isin(one.loop, mesh.faces[strip]).mean() < ALL_ROUND or area[strip].sum() > wide * (
        one.length + np.pi * wide
    ):
        return np.zeros_like(strip)
    # The fold is longer than the edge. What leaves no fold, or more than one, is no hem.
    folds = [loop for loop in borders(mesh.take_faces(~strip)) if np.isin(loop.loop, mesh.faces[strip]).all()]
    return strip & (len(folds) == 1 and folds[0].length > one.length)
