"""The mesh that was delivered, hung on the cloth that is draped in its place.

A drawn vertex belongs to a triangle c_0, c_1, c_2 of the cloth with shares w that sum to one, n its unit normal:

    x = sum_k w_k c_k                               on the cloth
    x = sum_k w_k (c_k + h n_k)                     off it, n_k the cloth's normals at the corners
    x = sum_k w_k c_k + a t + b (n x t) + h n       stiff, t = (c_1 - c_0) / |c_1 - c_0|

Linings, hems turned in and belts are off the cloth and bend with it. Buttons and buckles are stiff: their vertices
share a triangle, so that they turn with it and keep their shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from drape.engine.calls import call_with_scratch
from drape.files.looks import NO_LOOKS, Looks
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import meshes
from drape.geometry.closest import closest_point

ON, OFF, STIFF = range(3)
SLACK_M = 5e-4  # a vertex farther than this from its triangle's normal is placed in the triangle's frame
ARRAYS = ("faces", "uv", "uv_faces", "face_material", "corner", "weight", "offset", "kind")


@dataclass(frozen=True, eq=False)
class BoundMesh:
    """A delivered mesh of D vertices, and how each of them follows the vertices of another mesh, the cloth.

    ``faces`` (F, 3), ``uv`` (T, 2), ``uv_faces`` (F, 3), ``material_names`` and ``face_material`` (F,) are as in
    ``GarmentMesh``. A vertex hangs on a triangle of the cloth: ``corner`` (D, 3), rows of the cloth's vertices;
    ``weight`` (D, 3), barycentric; ``offset`` (D, 3) [m], along t, n x t and n, with the triangle's first edge t and
    its normal n. ``kind`` (D,) uint8: ``ON`` the triangle, ``OFF`` it along the cloth's vertex normals, or ``STIFF``,
    off it in the triangle's own frame. ``looks``: those of the materials.
    """

    name: str
    material_names: tuple[str, ...]
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    face_material: np.ndarray
    corner: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    kind: np.ndarray
    looks: Looks = NO_LOOKS

    @property
    def vertex_count(self) -> int:
        return len(self.corner)

    @property
    def heaviest(self) -> np.ndarray:
        """Returns for each drawn vertex the row (D,) of the cloth's vertex with the largest weight in it."""
        return np.take_along_axis(self.corner, self.weight.argmax(axis=1)[:, None], axis=1)[:, 0]

    def shares(self, count: int) -> scipy.sparse.csr_matrix:
        """Returns the sparse matrix (D, ``count``) of the weights: it interpolates values of the cloth's ``count``
        vertices to the drawn ones."""
        rows = np.repeat(np.arange(len(self.corner)), 3)
        value = self.weight.reshape(-1), (rows, self.corner.reshape(-1))
        return scipy.sparse.csr_matrix(value, (len(self.corner), count))


class Drawer:
    """Computes the vertices of a bound mesh from those of its cloth, whose triangles are ``faces`` (F, 3)."""

    def __init__(self, bound: BoundMesh, faces: np.ndarray) -> None:
        self._bound = bound
        self._asked = np.unique(bound.corner[bound.kind == OFF])  # vertices of the cloth that need normals
        self._faces = np.ascontiguousarray(faces[np.isin(faces, self._asked).any(axis=1)], dtype=np.int32)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Returns the arrays that the engine's ``drape_draw_bound`` takes, in its order: the cloth's faces (F, 3) that
        vertex normals are computed from, the cloth's vertices (N,) that need normals, and ``corner``, ``weight``,
        ``offset`` and ``kind`` of the bound mesh. Integers are int32, numbers float32, kinds uint8."""
        bound = self._bound
        numbers = bound.weight.astype(np.float32), bound.offset.astype(np.float32)
        return self._faces, self._asked.astype(np.int32), bound.corner, *numbers, bound.kind

    def draw(self, cloth: np.ndarray) -> np.ndarray:
        """Returns the drawn vertices [m] (D, 3) for the cloth's vertices ``cloth`` [m] (V, 3), in the same frame and
        dtype."""
        bound, dtype = self._bound, cloth.dtype
        drawn = np.empty((bound.vertex_count, 3), dtype)
        weight, offset = bound.weight.astype(dtype, copy=False), bound.offset.astype(dtype, copy=False)
        cloth = np.ascontiguousarray(cloth)
        hung = (bound.corner, weight, offset, bound.kind, len(drawn), drawn)
        normals = (self._faces, len(self._faces), self._asked, len(self._asked))
        call_with_scratch("draw_bound", dtype, cloth, len(cloth), *normals, *hung)
        return drawn


def bind(
    mesh: GarmentMesh,
    places: np.ndarray,
    cloth: np.ndarray,
    faces: np.ndarray,
    row: np.ndarray,
    part: np.ndarray,
    beyond: np.ndarray | None = None,
) -> BoundMesh:
    """Returns ``mesh`` bound to the cloth with vertices ``cloth`` [m] (V, 3) and triangles ``faces`` (F, 3). ``places``
    [m] (D, 3): where the D vertices of ``mesh`` are. ``row`` (D,): the vertex of the cloth that is the same one, or -1.
    ``part`` (D,): the number of the stiff part to which the vertex of ``mesh`` belongs, or -1. ``beyond`` [m] (D, 3):
    the points for which the nearest triangle is searched, by default ``places``."""
    count = len(places)
    weight, kind = np.tile([1.0, 0.0, 0.0], (count, 1)), np.full(count, ON, dtype=np.uint8)
    corner, offset = np.repeat(np.maximum(row, 0)[:, None], 3, axis=1), np.zeros((count, 3))
    loose = np.flatnonzero(row < 0)
    if len(loose):
        face, shares = _triangles((places if beyond is None else beyond)[loose], cloth, faces, part[loose])
        corner[loose], weight[loose] = faces[face], shares
        normals = meshes.vertex_normals(cloth, faces)
        base = np.einsum("nk,nkc->nc", shares, cloth[faces[face]])
        gap = places[loose] - base
        # n_k are unit vectors, so their mean is shorter than one where the cloth bends.
        out = np.einsum("nk,nkc->nc", shares, normals[faces[face]])
        square = np.einsum("nc,nc->n", out, out)
        height = np.einsum("nc,nc->n", gap, out) / np.maximum(square, 1e-12)
        missed = np.linalg.norm(gap - height[:, None] * out, axis=1)
        framed = (part[loose] >= 0) | (missed > SLACK_M) | (square < 0.25)
        local = np.einsum("nac,nc->na", frames(cloth[faces[face]]), gap)
        flat = np.zeros_like(height)
        offset[loose] = np.where(framed[:, None], local, np.stack([flat, flat, height], axis=1))
        kind[loose] = np.where(framed, STIFF, OFF)
    return BoundMesh(
        mesh.name,
        mesh.material_names,
        mesh.faces.astype(np.int32),
        mesh.uv.astype(np.float32),
        mesh.uv_faces.astype(np.int32),
        mesh.face_material.astype(np.int32),
        np.ascontiguousarray(corner, dtype=np.int32),
        weight.astype(np.float32),
        offset.astype(np.float32),
        kind,
        mesh.looks,
    )


def frames(corners: np.ndarray) -> np.ndarray:
    """Returns orthonormal frames (N, 3, 3) of triangles with ``corners`` (N, 3, 3). Their rows are t, the direction of
    the first edge; n x t; and n, the unit normal."""
    along = corners[:, 1] - corners[:, 0]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    up = np.cross(along, corners[:, 2] - corners[:, 0])
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-12)
    return np.stack([along, np.cross(up, along), up], axis=1)


def _triangles(
    points: np.ndarray, cloth: np.ndarray, faces: np.ndarray, part: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The triangle (N,) that each of ``points`` (N, 3) hangs on and its shares (N, 3): the nearest, and for a stiff
    part that of its middle."""
    found = closest_point(points, cloth, faces)
    face, shares = found.face.copy(), found.barycentric.copy()
    stiff = np.flatnonzero(part >= 0)
    if len(stiff):
        numbers, which = np.unique(part[stiff], return_inverse=True)
        middle = closest_point(np.stack([points[part == one].mean(axis=0) for one in numbers]), cloth, faces)
        face[stiff], shares[stiff] = middle.face[which], middle.barycentric[which]
    return face, shares
