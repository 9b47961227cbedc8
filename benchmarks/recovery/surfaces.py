"""How far two surfaces are apart, by points drawn evenly from both: Chamfer distance and normals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.errors import MeshError
from drape.geometry import meshes
from drape.geometry.drawing import within
from recovery.fit.chamfer import Chamfer

SAMPLE_COUNT = 100_000
SMALLEST_M2 = 1e-9


class SurfaceError(NamedTuple):
    """``chamfer_cm2``: mean squared distances to the nearest point, both directions summed; ``mean_mm``: the mean
    distance, both directions averaged; ``normal``: mean of 1 - n . n' over the nearest pairs of both directions, and
    ``normal_deg`` the mean angle between them [deg].
    """

    chamfer_cm2: float
    mean_mm: float
    normal: float
    normal_deg: float


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (count, 3) drawn by area from the triangles, and the unit normals (count, 3) of their triangles."""
    vertices = np.asarray(vertices, dtype=np.float64)
    faces = meshes.check_faces(faces, len(vertices))
    areas = meshes.face_areas(vertices, faces)
    if not areas.sum() > SMALLEST_M2:
        raise MeshError("surface", expected="triangles that have area", got="none", cure="Pass a mesh in metres.")
    chosen = np.repeat(np.arange(len(faces)), rng.multinomial(count, areas / areas.sum()))
    return within(vertices[faces[chosen]], rng), meshes.face_normals(vertices, faces)[chosen]


def surface_error(
    vertices: np.ndarray,
    faces: np.ndarray,
    true_vertices: np.ndarray,
    true_faces: np.ndarray,
    *,
    count: int = SAMPLE_COUNT,
    seed: int = 0,
) -> SurfaceError:
    """The error of one surface against another, ``count`` points from each (docs/decisions/0004-pattern-recovery.md).

    A surface against itself is not 0 but its floor, what the drawing of points leaves: a Chamfer distance of about
    2 A / (pi count), A the area.
    """
    rng = np.random.default_rng(seed)
    points, normals = sample_surface(vertices, faces, count, rng)
    true_points, true_normals = sample_surface(true_vertices, true_faces, count, rng)
    to_true, at_true = KDTree(true_points).query(points)
    to_found, at_found = KDTree(points).query(true_points)
    cosines = [(normals * true_normals[at_true]).sum(axis=1), (true_normals * normals[at_found]).sum(axis=1)]
    angles = [np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) for cosine in cosines]
    distance = Chamfer.of(to_true, to_found)
    return SurfaceError(
        chamfer_cm2=distance.squared_cm2,
        mean_mm=distance.mean_mm,
        normal=1.0 - 0.5 * float(cosines[0].mean() + cosines[1].mean()),
        normal_deg=0.5 * float(angles[0].mean() + angles[1].mean()),
    )
