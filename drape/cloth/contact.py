"""Contact of a garment with the posed body: nearest body vertices, plane distances and the push-out baseline.

A garment point is tested against the tangent plane of the nearest body vertex in
the posed frame, d = n . (x - b), positive outside. A k-d tree finds the nearest
vertex; d is differentiable in x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from drape.arrays import Array, check_shape, like, namespace
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import InputError
from drape.geometry import closest, meshes

# Cloth seldom touches these parts, and their detail is finer than cloth.
DETAIL_JOINTS = tuple(
    JOINT_NAMES.index(name) for name in ("head", "left_hand", "right_hand", "left_foot", "right_foot")
)
DETAIL_CELL_M = 0.012  # one collider per cell of this size there
OPENING_M = 0.02  # a head vertex that does not have half of this free before it lies in the mouth or an eye socket


@dataclass(frozen=True, eq=False)
class ContactPlanes:
    """Tangent planes of the nearest body vertices ``index`` (..., V): ``point`` [m] and unit ``normal`` (..., V, 3)."""

    point: Array
    normal: Array
    index: np.ndarray

    def distance(self, positions: Array) -> Array:
        """Signed distances [m] (..., V) of ``positions`` (..., V, 3), outside positive; differentiable."""
        return plane_distance(positions, self.point, self.normal)

    def like(self, positions: Array) -> ContactPlanes:
        """The same planes in the namespace, dtype and device of ``positions``."""
        return ContactPlanes(like(positions, self.point), like(positions, self.normal), self.index)


class BodyContact:
    """The surface of a body that cloth collides with: its triangles, and those of its vertices that take part, whose
    tangent planes push cloth.

    ``vertices`` (C,) are the indices of the vertices that take part; ``None``: all do.
    """

    def __init__(self, faces: np.ndarray, vertex_count: int, *, vertices: np.ndarray | None = None) -> None:
        self.faces = meshes.check_faces(faces, vertex_count)
        self.vertex_count = vertex_count
        self.vertices = vertices
        self._table = meshes.face_table(self.faces, vertex_count)

    @classmethod
    def of_body(cls, body: BodyModel) -> BodyContact:
        """Returns the whole surface of ``body``, of which only the vertices of ``collider_vertices`` take part."""
        return cls(body.faces, body.vertex_count, vertices=collider_vertices(body))

    @cached_property
    def edges(self) -> np.ndarray:
        """The edges (E, 2) of the surface, as vertex indices, whose two ends take part."""
        found = meshes.unique_edges(self.faces)
        return found if self.vertices is None else found[np.isin(found, self.vertices).all(axis=1)]

    def normals(self, body_vertices: Array) -> Array:
        """Returns the unit vertex normals (..., Vb, 3), outward, of the posed ``body_vertices`` [m] (..., Vb, 3)."""
        return meshes.vertex_normals(body_vertices, self.faces, table=self._table)

    def planes(self, points: np.ndarray, body_vertices: np.ndarray, normals: np.ndarray | None = None) -> ContactPlanes:
        """Returns for ``points`` [m] (B, V, 3) the tangent planes at the nearest vertices that take part of the posed
        ``body_vertices`` [m] (B, Vb, 3). ``normals`` (B, Vb, 3) are computed if left out."""
        if normals is None:
            normals = np.asarray(self.normals(body_vertices))
        index = nearest_body_vertices(points, body_vertices, vertices=self.vertices)
        return ContactPlanes(take_rows(body_vertices, index), take_rows(normals, index), index)


def nearest_body_vertices(
    points: np.ndarray, body_vertices: np.ndarray, *, vertices: np.ndarray | None = None
) -> np.ndarray:
    """Returns the indices (B, V) int64 of the body vertices nearest to ``points`` [m] (B, V, 3).

    ``body_vertices`` are [m] (B, Vb, 3); ``vertices`` (C,) restricts the search to these. Raises ``InputError`` for
    other shapes.
    """
    check_shape("points", points, (None, None, 3), error=InputError)
    check_shape("body_vertices", body_vertices, (len(points), None, 3), error=InputError)
    nearest = np.empty(points.shape[:2], dtype=np.int64)
    for frame, posed in enumerate(body_vertices):
        candidates = posed if vertices is None else posed[vertices]
        # Built for one round of queries: an unbalanced tree costs a third and answers as fast. Leaves of 32 points take
        # a quarter off both, but all ratios to the push-out baseline are with leaves of ten.
        tree = KDTree(candidates, balanced_tree=False, compact_nodes=False)
        nearest[frame] = tree.query(points[frame], workers=1)[1]
    return nearest if vertices is None else vertices[nearest]


def take_rows(rows: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Returns the rows (B, V, 3) of ``rows`` (B, Vb, 3) at ``index`` (B, V), frame by frame."""
    return np.take_along_axis(rows, index[..., None], axis=-2)


def plane_distance(positions: Array, point: Array, normal: Array) -> Array:
    """Returns the signed distances [m] (..., V) of ``positions`` from planes, positive where the normals point.

    ``positions``, ``point`` [m] and unit ``normal`` are (..., V, 3).
    """
    xp = namespace(positions)
    return xp.sum((positions - point) * normal, axis=-1)


def nearest_vertex_push(
    vertices: np.ndarray,
    body_vertices: np.ndarray,
    body_normals: np.ndarray,
    clearance_m: float = 0.002,
    *,
    colliders: np.ndarray | None = None,
    passes: int = 2,
) -> np.ndarray:
    """Returns ``vertices`` [m] (B, V, 3) after the push: one nearer than ``clearance_m`` to the tangent plane of its
    nearest body vertex is moved to this distance along that vertex's normal.

    ``body_vertices`` and their unit ``body_normals`` are (B, Vb, 3), ``colliders`` (C,) the body vertices that count,
    all if left out. The second of two ``passes`` follows vertices whose nearest body vertex changed. This is the
    baseline beside every number of quality.
    """
    pushed = np.array(vertices, dtype=np.float64)
    for _ in range(passes):
        index = nearest_body_vertices(pushed, body_vertices, vertices=colliders)
        normal = take_rows(body_normals, index)
        missing = clearance_m - plane_distance(pushed, take_rows(body_vertices, index), normal)
        if not (missing > 0.0).any():
            break
        pushed += np.maximum(missing, 0.0)[..., None] * normal
    return pushed


def collider_vertices(body: BodyModel) -> np.ndarray:
    """Returns the sorted indices (C,) of the body vertices that cloth is tested against.

    These are all of trunk and limbs; of head, hands and feet one per ``DETAIL_CELL_M`` cell of the rest pose, without
    the inside of the mouth and the eye sockets.
    """
    rest = body.v_template
    detail = body.weights[:, DETAIL_JOINTS].sum(axis=1) > 0.5
    probe = rest[detail] + OPENING_M * meshes.vertex_normals(rest, body.faces)[detail]
    head = body.weights[detail][:, DETAIL_JOINTS[0]] > 0.5
    is_open = closest.signed_distance(probe, rest, body.faces) > 0.5 * OPENING_M
    candidates = np.flatnonzero(detail)[is_open | ~head]
    cells = np.floor(rest[candidates] / DETAIL_CELL_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return np.sort(np.concatenate([np.flatnonzero(~detail), candidates[first]]))
