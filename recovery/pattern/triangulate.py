"""Triangles inside a polygon, as even as its corners allow, without a new point on its boundary.

A triangular lattice fills the inside; the constrained Delaunay triangulation (pythoncdt) joins it to the boundary;
a few rounds of moving the inner points to the mean of their neighbours even it out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pythoncdt

from drape.errors import InputError, MeshError
from drape.geometry import mesh_graphs

CLEARANCE_SHARE = 0.7  # of the target edge: no lattice point nearer to the boundary
ROUNDS, MOVES_PER_ROUND = 6, 2  # more rounds change the smallest angle by less than a degree
LARGEST_LATTICE = 2_000_000


def triangulate(boundary: np.ndarray, edge_length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (N, 2) and triangles (F, 3), counter-clockwise, inside the simple polygon ``boundary`` [m] (B, 2).

    The first B points are those of ``boundary``, in order, and every one of its sides is a side of one triangle.
    """
    boundary = np.array(boundary, dtype=np.float64)
    size = np.ptp(boundary, axis=0) / edge_length_m if edge_length_m > 0.0 else np.full(2, np.inf)
    if len(boundary) < 3 or not (size + 1.0).prod() < LARGEST_LATTICE:
        raise InputError(
            "edge_length_m",
            expected=f"a length > 0 that gives fewer than {LARGEST_LATTICE} points, and 3 or more boundary points",
            got=f"{edge_length_m} m for {len(boundary)} boundary points",
            cure="Take longer edges, and check that the pattern is in metres.",
        )
    points = np.concatenate([boundary, _lattice(boundary, edge_length_m)])
    count = len(boundary)
    faces = _delaunay(points, count)
    for _ in range(ROUNDS):
        to_mean = mesh_graphs.umbrella_laplacian(faces, len(points))[count:]
        for _ in range(MOVES_PER_ROUND):
            points[count:] += to_mean @ points
        faces = _delaunay(points, count)
    return points, faces


def corner_angles_deg(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Angles [deg] (F, 3) at the corners of the triangles."""
    corners = points[faces]
    first = np.roll(corners, -1, axis=1) - corners
    second = np.roll(corners, 1, axis=1) - corners
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return np.degrees(np.arctan2(np.abs(cross), (first * second).sum(axis=-1)))


def _lattice(polygon: np.ndarray, edge: float) -> np.ndarray:
    """Points of the triangular lattice inside ``polygon``, symmetric about the middle of its box."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    middle = 0.5 * (low + high)
    height = 0.5 * np.sqrt(3.0) * edge
    rows = np.arange(-np.ceil((high - middle)[1] / height), np.ceil((high - middle)[1] / height) + 1)
    columns = np.arange(-np.ceil((high - middle)[0] / edge) - 1, np.ceil((high - middle)[0] / edge) + 2)
    x = columns[None, :] * edge + np.where(rows % 2 == 0, 0.0, 0.5 * edge)[:, None]
    y = np.broadcast_to((rows * height)[:, None], x.shape)
    points = middle + np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
    return points[inside(points, polygon) & (boundary_distance(points, polygon) > CLEARANCE_SHARE * edge)]


def inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Whether each of ``points`` (N, 2) lies inside the closed ``polygon`` (M, 2), by counting crossings."""
    within = np.zeros(len(points), dtype=bool)
    x, y = points.T
    for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if ay != by:
            crossing = ((ay > y) != (by > y)) & (x < ax + (y - ay) * ((bx - ax) / (by - ay)))
            within ^= crossing
    return within


def boundary_distance(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Distances [m] (N,) of ``points`` (N, 2) to the sides of the closed ``polygon`` (M, 2)."""
    nearest = np.full(len(points), np.inf)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        along = b - a
        share = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * along, axis=1))
    return nearest


def _delaunay(points: np.ndarray, boundary_count: int) -> np.ndarray:
    """Triangles (F, 3) of the constrained Delaunay triangulation inside the first ``boundary_count`` points."""
    start = np.arange(boundary_count, dtype=np.uintc)
    # Typed loosely: numpy's stubs do not know the buffer protocol before Python 3.12.
    vertices: Any = np.ascontiguousarray(points)
    sides: Any = np.ascontiguousarray(np.stack([start, np.roll(start, -1)], axis=1))
    try:
        mesh = pythoncdt.Triangulation(
            pythoncdt.VertexInsertionOrder.AUTO, pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED, 0.0
        )
        mesh.insert_vertices(vertices)
        mesh.insert_edges(sides)
        mesh.erase_outer_triangles()
        faces = mesh.triangles_array()["vertices"].astype(np.int64)
    except RuntimeError as error:
        raise _not_simple(str(error).splitlines()[0]) from error
    # A disk with B boundary and I inner points has B + 2 I - 2 triangles.
    expected = 2 * len(points) - boundary_count - 2
    if len(faces) != expected or mesh.vertices_count() != len(points):
        raise _not_simple(f"{len(faces)} triangles instead of {expected}")
    return faces


def _not_simple(got: str) -> MeshError:
    return MeshError(
        "boundary",
        expected="a simple polygon with distinct points",
        got=got,
        cure="Remove crossings and doubled points; take shorter edges where curved sides come close.",
    )
