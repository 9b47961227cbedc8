"""The numbers by which a drape is judged; docs/quality.md defines them and says what peers do differently.

Each returns one value per frame, (...,) for positions (..., V, 3); percentages are
unsigned means over the mesh, as in GAPS (Chen et al. 2024).
"""

from __future__ import annotations

import numpy as np

from drape.cloth.contact import nearest_vertices, plane_distance, take_rows
from drape.errors import MeshError
from drape.geometry import closest, meshes


def edge_strain_pct(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of |l - l0| / l0 over the edges, l0 the length in the rest mesh [m] (V, 3)."""
    edges = meshes.unique_edges(faces)
    return _strain_pct(meshes.edge_lengths(vertices, edges), meshes.edge_lengths(rest, edges), "edge")


def area_strain_pct(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of |A - A0| / A0 over the faces, A0 the area in the rest mesh [m] (V, 3)."""
    return _strain_pct(meshes.face_areas(vertices, faces), meshes.face_areas(rest, faces), "face")


def colliding_vertex_pct(vertices: np.ndarray, body_vertices: np.ndarray, body_normals: np.ndarray) -> np.ndarray:
    """Share of garment vertices (B, V, 3) behind the tangent plane of the nearest of all body vertices (B, Vb, 3)."""
    index = nearest_vertices(vertices, body_vertices)
    distance = plane_distance(vertices, take_rows(body_vertices, index), take_rows(body_normals, index))
    return 100.0 * (distance < 0.0).mean(axis=-1)


def colliding_triangle_pct(vertices: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """Share of garment vertices (B, V, 3) with a negative signed distance to the body's triangles."""
    inside = [
        (closest.signed_distance(cloth, body, body_faces) < 0.0).mean()
        for cloth, body in zip(vertices, body_vertices, strict=True)
    ]
    return 100.0 * np.array(inside)


def gain(e_skin_push: float, e_net: float, e_physics: float) -> float:
    """(E_skin - E_net) / (E_skin - E_physics): 0 is skinning with push-out, 1 the physics optimum.

    NaN where physics is not below skinning: then there is nothing to gain.
    """
    room = e_skin_push - e_physics
    return (e_skin_push - e_net) / room if room > 0.0 else float("nan")


def _strain_pct(now: np.ndarray, rest: np.ndarray, what: str) -> np.ndarray:
    if rest.size == 0 or rest.min() < 1e-12:
        got = f"zero at {what} {int(rest.argmin())}" if rest.size else f"no {what}s"
        raise MeshError(f"rest {what}s", expected="all of some size", got=got, cure="Remove degenerate triangles.")
    return 100.0 * (np.abs(now - rest) / rest).mean(axis=-1)
