"""The numbers by which a drape is judged; docs/reference/quality.md defines them and says what peers do differently.

Each returns one value per frame, (...,) for positions (..., V, 3); percentages are
unsigned means over the mesh, as in GAPS (Chen et al. 2024).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drape.cloth import energies
from drape.cloth.contact import BodyContact, nearest_body_vertices, plane_distance, take_rows
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.errors import InputError, MeshError
from drape.geometry import closest, meshes


def edge_strain_pct(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the mean [%] (B,) of |l - l0| / l0 over the edges of ``vertices`` [m] (B, V, 3), l0 the length in the
    mesh ``rest`` [m] (V, 3). Raises ``MeshError`` where an l0 is zero."""
    edges = meshes.unique_edges(faces)
    return _strain_pct(meshes.edge_lengths(vertices, edges), meshes.edge_lengths(rest, edges), "edge")


def area_strain_pct(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the mean [%] (B,) of |A - A0| / A0 over the faces of ``vertices`` [m] (B, V, 3), A0 the area in the mesh
    ``rest`` [m] (V, 3). Raises ``MeshError`` where an A0 is zero."""
    return _strain_pct(meshes.face_areas(vertices, faces), meshes.face_areas(rest, faces), "face")


def colliding_vertex_pct(vertices: np.ndarray, body_vertices: np.ndarray, body_normals: np.ndarray) -> np.ndarray:
    """Returns the share [%] (B,) of garment vertices [m] (B, V, 3) behind the tangent plane of the nearest of all body
    vertices (B, Vb, 3).
    """
    index = nearest_body_vertices(vertices, body_vertices)
    distance = plane_distance(vertices, take_rows(body_vertices, index), take_rows(body_normals, index))
    return 100.0 * (distance < 0.0).mean(axis=-1)


def colliding_triangle_pct(vertices: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """Returns the share [%] (B,) of garment vertices [m] (B, V, 3) with a negative signed distance to the body's
    triangles.
    """
    inside = [
        (closest.signed_distance(cloth, body, body_faces) < 0.0).mean()
        for cloth, body in zip(vertices, body_vertices, strict=True)
    ]
    return 100.0 * np.array(inside)


def nearest_distance(vertices: np.ndarray, contact: BodyContact, body: np.ndarray, *, gap_m: float) -> np.ndarray:
    """Returns the signed distances [m] (F, V) of ``vertices`` (F, V, 3) to the tangent planes of the nearest vertices
    of the posed ``body`` [m] (F, Vb, 3). ``gap_m`` has no effect; other distances for ``static_parts`` need it."""
    return contact.planes(vertices, body).distance(vertices)


def static_parts(
    vertices: np.ndarray,
    cloth: ClothMesh,
    material: Material,
    contact: BodyContact,
    body_vertices: np.ndarray,
    *,
    height_m: np.ndarray,
    distance: Callable[..., np.ndarray] = nearest_distance,
) -> dict[str, np.ndarray]:
    """Returns the energies [J] (F,) of ``vertices`` [m] (F, V, 3) by name, as ``energies.total`` does with contact.

    Heights count from ``height_m`` [m] (F,). ``distance`` is the function that gives the distances of contact; left
    out, it is that of training.
    """
    apart = distance(vertices, contact, body_vertices, gap_m=material.contact_gap_m)
    return energies.total(vertices, cloth, material, distance=apart, height_m=height_m[:, None])


def mean_height(vertices: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """Returns the height y [m] (F,) of the cloth's centre of mass for ``vertices`` [m] (F, V, 3)."""
    return vertices[..., 1] @ cloth.vertex_area / cloth.vertex_area.sum()


def third_difference_square(vertices: np.ndarray) -> float:
    """Returns the mean square [m^2] of x[t+3] - 3 x[t+2] + 3 x[t+1] - x[t] over the vertices of a clip [m] (F, V, 3).

    A constant acceleration has none, so what remains is jerk times the cube of the time step: jitter. Raises
    ``InputError`` for fewer than four frames.
    """
    if len(vertices) < 4:
        raise InputError("clip", expected="4 frames or more", got=str(len(vertices)), cure="Take a longer window.")
    third = np.diff(np.asarray(vertices, dtype=np.float64), n=3, axis=0)
    return float(np.mean(np.sum(third * third, axis=-1)))


def gain(e_skin_push: float, e_net: float, e_physics: float) -> float:
    """Returns (E_skin - E_net) / (E_skin - E_physics): 0 is skinning with push-out, 1 the physics optimum.

    It is NaN where physics is not below skinning: then there is nothing to gain.
    """
    room = e_skin_push - e_physics
    return (e_skin_push - e_net) / room if room > 0.0 else float("nan")


def _strain_pct(now: np.ndarray, rest: np.ndarray, what: str) -> np.ndarray:
    if rest.size == 0 or rest.min() < 1e-12:
        got = f"zero at {what} {int(rest.argmin())}" if rest.size else f"no {what}s"
        raise MeshError(f"rest {what}s", expected="all of some size", got=got, cure="Remove degenerate triangles.")
    return 100.0 * (np.abs(now - rest) / rest).mean(axis=-1)
