"""Exact nearest points on a triangle mesh, signed distances to a closed one (libigl, float64), and nearest vertices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from scipy.spatial import KDTree

from drape.arrays import check_finite, check_shape
from drape.errors import MeshError
from drape.geometry.meshes import boundary_edges, check_faces, face_normals

ON_EDGE = 1e-9  # barycentric coordinate below which a point lies on the edge opposite
LEAF = 32  # vertices in a leaf: the fastest for tens of neighbours
NEEDLE = 1e-12  # squared sine below which a triangle has no barycentric coordinates; its nearest corner stands in


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """The points of a mesh that are nearest to N given points: the unsigned ``distance`` [m] (N,), the ``face`` (N,) on
    which each lies, the ``point`` itself [m] (N, 3), and the ``corners`` [m] (N, 3, 3) of that face."""

    distance: np.ndarray
    face: np.ndarray
    point: np.ndarray
    corners: np.ndarray

    @cached_property
    def barycentric(self) -> np.ndarray:
        """Returns the barycentric coordinates (N, 3) of each nearest point in its face; they are in [0, 1] and sum to
        one."""
        return barycentric(self.point, self.corners)


class SearchedMesh:
    """A mesh that is asked for nearest points many times: ``vertices`` [m] (V, 3), ``faces`` (F, 3). Its search tree is
    made once. Raises ``MeshError`` for arrays that are no finite mesh with faces."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        _, self.vertices, self.faces = _checked(np.zeros((0, 3)), vertices, faces)
        self._tree = igl.AABB()
        self._tree.init(self.vertices, self.faces)

    def closest(self, points: np.ndarray) -> ClosestPoints:
        """Returns the point of the mesh nearest to each of ``points`` [m] (N, 3), with its distance and its face."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if len(points) == 0:
            return ClosestPoints(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        squared, face, nearest = map(np.asarray, self._tree.squared_distance(self.vertices, self.faces, points))
        face = face.reshape(-1)
        return ClosestPoints(np.sqrt(squared.reshape(-1)), face, nearest, self.vertices[self.faces[face]])


def closest_point(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> ClosestPoints:
    """Returns the point of the mesh nearest to each of ``points`` [m] (N, 3), with its distance and its face. Raises
    ``MeshError`` for arrays that are no points or no finite mesh with faces."""
    points, vertices, faces = _checked(points, vertices, faces)
    return SearchedMesh(vertices, faces).closest(points)


def nearest_vertices(points: np.ndarray, vertices: np.ndarray, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Returns the distances [m] to the ``vertices`` (V, 3) nearest to each of ``points`` (N, 3), and the rows of these
    vertices: both (N,) for a ``count`` of 1, else (N, ``count``), the nearest first."""
    distance, index = KDTree(vertices, leafsize=LEAF).query(points, k=count)
    return np.asarray(distance), np.asarray(index)


def on_border(nearest: ClosestPoints, faces: np.ndarray) -> np.ndarray:
    """Returns bool (N,), True for those of the N points in ``nearest`` that lie on a boundary edge of the mesh
    ``faces`` (F, 3)."""
    corners = np.asarray(faces, dtype=np.int64)
    count = int(corners.max()) + 1
    border = boundary_edges(corners)
    keys, rim = border @ (count, 1), np.zeros(count, dtype=bool)
    rim[border] = True
    own, weight = corners[nearest.face], nearest.barycentric
    ends = (weight > 1.0 - ON_EDGE) & rim[own]
    for k in range(3):
        edge = np.sort(own[:, [(k + 1) % 3, (k + 2) % 3]], axis=1)
        ends[:, k] |= (weight[:, k] < ON_EDGE) & np.isin(edge @ (count, 1), keys)
    return np.asarray(ends.any(axis=1))


def signed_distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the distances [m] (N,) of ``points`` (N, 3) from a closed mesh, negative inside. The sign is that of the
    angle-weighted pseudo-normal at the nearest point (Baerentzen & Aanaes 2005): exact for a closed mesh without
    self-intersections, and local where a posed body cuts into itself. Raises ``MeshError`` for arrays that are no
    points or no finite mesh with faces."""
    points, vertices, faces = _checked(points, vertices, faces)
    if len(points) == 0:
        return np.zeros(0)
    kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    return np.asarray(igl.signed_distance(points, vertices, faces, sign_type=kind)[0]).reshape(-1)


class ClosedMesh(SearchedMesh):
    """A closed mesh that is asked for signed distances many times: ``vertices`` [m] (V, 3), ``faces`` (F, 3). Its
    search tree and the normals that decide signs are made once; signs are those of ``signed_distance``."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        super().__init__(vertices, faces)
        corners = self.vertices[self.faces]
        self._face_normals = face_normals(self.vertices, self.faces)
        following, last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        sine = np.linalg.norm(np.cross(following, last), axis=2)
        angle = np.arctan2(sine, (following * last).sum(axis=2)).reshape(-1)
        self._vertex_normals = _gathered(
            self.faces.reshape(-1), angle[:, None] * np.repeat(self._face_normals, 3, axis=0), len(self.vertices)
        )
        opposite = np.sort(self.faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2).reshape(-1, 2)
        _, edge = np.unique(opposite @ (len(self.vertices), 1), return_inverse=True)
        edge = edge.reshape(-1)
        summed = _gathered(edge, np.repeat(self._face_normals, 3, axis=0), int(edge.max()) + 1)
        self._edge_normals = summed[edge].reshape(-1, 3, 3)  # of the edge across from each corner

    def signed_closest(self, points: np.ndarray) -> tuple[np.ndarray, ClosestPoints]:
        """Returns the distances [m] (N,) of ``points`` [m] (N, 3) from the mesh, negative inside, and the nearest
        points on it."""
        nearest = self.closest(points)
        face, weights = nearest.face, nearest.barycentric
        there = weights > ON_EDGE
        normal, count = self._face_normals[face], there.sum(axis=1)
        on_edge, on_corner = count == 2, count == 1
        normal[on_edge] = self._edge_normals[face[on_edge], there[on_edge].argmin(axis=1)]
        normal[on_corner] = self._vertex_normals[self.faces[face[on_corner], there[on_corner].argmax(axis=1)]]
        outside = np.einsum("nc,nc->n", points - nearest.point, normal) >= 0.0
        return np.where(outside, nearest.distance, -nearest.distance), nearest


def _gathered(rows: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The sums (``count``, 3) of ``values`` (N, 3) by ``rows`` (N,)."""
    return np.stack([np.bincount(rows, column, count) for column in values.T], axis=1)


def barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Returns the barycentric coordinates (N, 3), in [0, 1] with sum one, of ``points`` (N, 3) on the triangles
    ``corners`` (N, 3, 3). On a degenerate triangle they are those of the nearest corner."""
    e1, e2, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    a, b, c = (e1 * e1).sum(1), (e1 * e2).sum(1), (e2 * e2).sum(1)
    d, e = (p * e1).sum(1), (p * e2).sum(1)
    determinant = a * c - b * b
    flat = determinant <= NEEDLE * a * c
    safe = np.where(flat, 1.0, determinant)
    second, third = (c * d - b * e) / safe, (a * e - b * d) / safe
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    corner = np.argmin(((points[:, None] - corners) ** 2).sum(2), axis=1)
    weights = np.where(flat[:, None], np.eye(3)[corner], weights)
    return weights / weights.sum(axis=1, keepdims=True)


def _checked(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = np.ascontiguousarray(points, dtype=np.float64)
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    for name, array in (("points", points), ("vertices", vertices)):
        check_shape(name, array, (None, 3), error=MeshError)
        check_finite(name, array, error=MeshError)
    faces = np.ascontiguousarray(check_faces(faces, len(vertices)))
    if len(faces) == 0:
        raise MeshError("faces", expected="at least one triangle", got="none", cure="Pass a mesh with a surface.")
    return points, vertices, faces
