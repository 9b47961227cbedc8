"""Panels by flattening alone: the drape cut along its seams, every piece laid flat without any simulation.

LSCM keeps angles (Levy, Petitjean, Ray and Maillot 2002), ARAP keeps every triangle as rigid as it can (Liu, Zhang, Xu,
Gotsman and Gortler 2008); both leave the border free and are libigl's. Neither knows that a drape is stretched, so what
gravity and the body stretched stays in the panel.
"""

from __future__ import annotations

from enum import StrEnum

import igl
import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import MeshError
from drape.geometry import meshes
from recovery.pattern.mesh import PatternMesh
from recovery.pattern.symmetry import procrustes
from recovery.pattern.triangulate import signed_areas

ROUNDS = 200  # of ARAP's local and global steps, at most
SETTLED = 1e-7  # of a piece's size: ARAP ends where no vertex moves further


class Method(StrEnum):
    """How a piece is laid flat."""

    LSCM = "lscm"
    ARAP = "arap"


def lay_out(vertices: np.ndarray, faces: np.ndarray, method: Method) -> np.ndarray:
    """Places [m] (V, 2) of the disc ``vertices`` [m] (V, 3), ``faces`` (F, 3), turned as the faces are.

    LSCM tells no size; it gets the area of the surface. Raises ``MeshError`` for what is no disc.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", vertices, (None, 3), error=MeshError)
    check_finite("vertices", vertices, error=MeshError)
    faces = meshes.check_faces(faces, len(vertices)).astype(np.int64)
    loops = meshes.boundary_loops(faces)
    characteristic = len(np.unique(faces)) - len(meshes.unique_edges(faces)) + len(faces)
    if len(loops) != 1 or characteristic != 1:
        raise MeshError(
            "piece to lay flat",
            expected="a disc: one border, no handle",
            got=f"{len(loops)} borders, Euler characteristic {characteristic}",
            cure="Cut the garment along the seams of its panels.",
        )
    loop = loops[0]
    first = vertices[loop[0]]
    ends = np.array([loop[0], loop[np.linalg.norm(vertices[loop] - first, axis=1).argmax()]], dtype=np.int64)
    away = float(np.linalg.norm(vertices[ends[1]] - first))
    flat = np.asarray(igl.lscm(vertices, faces, ends, np.array([(0.0, 0.0), (away, 0.0)]))[0])
    flat = flat * np.sqrt(meshes.face_areas(vertices, faces).sum() / signed_areas(flat, faces).sum())
    return flat if method is Method.LSCM else _arap(vertices, faces, flat, away)


def _arap(vertices: np.ndarray, faces: np.ndarray, start: np.ndarray, size: float) -> np.ndarray:
    """Local and global steps from ``start`` (V, 2) until nothing moves; one vertex is held, which costs nothing."""
    data = igl.ARAPData()
    data.max_iter = 1
    igl.arap_precomputation(vertices, faces, 2, np.zeros(1, dtype=np.int32), data)
    flat = np.ascontiguousarray(start)
    for _ in range(ROUNDS):
        before = flat
        flat = np.asarray(igl.arap_solve(np.ascontiguousarray(start[:1]), data, flat))
        if np.abs(flat - before).max() <= SETTLED * size:
            break
    return flat


def flattened(mesh: PatternMesh, nodes: np.ndarray, method: Method, onto: np.ndarray) -> np.ndarray:
    """Panel vertices [m] (P, 2) of ``mesh`` from its drape ``nodes`` [m] (N, 3): every panel cut out and laid flat.

    Each is laid on its panel in ``onto`` [m] (P, 2) by a rigid motion.
    """
    check_shape("nodes", nodes, (mesh.node_count, 3))
    check_shape("onto", onto, (len(mesh.rest), 2))
    places = np.zeros_like(mesh.rest)
    for number in range(len(mesh.pattern.panels)):
        own = np.flatnonzero(mesh.panel == number)
        faces = np.searchsorted(own, mesh.panel_faces[mesh.face_panel == number])
        # A panel sewn right to wrong runs clockwise in its own frame.
        if signed_areas(mesh.rest[own], faces).sum() < 0.0:
            faces = faces[:, ::-1]
        flat = lay_out(nodes[mesh.node_of_panel_vertex[own]], faces, method)
        turn, _ = procrustes(flat, onto[own], reflect=False)
        places[own] = (flat - flat.mean(axis=0)) @ turn + onto[own].mean(axis=0)
    return places
