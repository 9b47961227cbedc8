"""Samples of a mesh, of skin or of cloth: points spread evenly over it with two tangents each, as fixed sums over its
vertices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from drape.arrays import Array, check_shape, like, namespace
from drape.contact.blocks import blocks
from drape.errors import InputError
from drape.geometry import mesh_graphs, meshes
from drape.geometry.rotations import cross_columns, dot_columns

DENSE_PER_DISC = 12  # random points drawn for each sample kept
NORMAL_REACH = 1.5  # in spacings: the distance over which a sample's tangents are averaged
REGION_SIZE = 12  # samples of other parts that are looked up together
CLUSTER_SIZE = 4  # samples of the own part that are looked up together
POSED_REGIONS = 4  # regions that are posed in one product

FACING = 0.2  # cosine from which a vertex counts as facing the way of a sample

Keep = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Samples:
    """S samples of a mesh of V vertices. ``CLUSTER_SIZE`` in a row are a cluster, ``REGION_SIZE`` in a row a region,
    and ``POSED_REGIONS`` regions in a row a part. No part is cut short.

    ``operator`` sparse (3 S, V): its first S rows times the mesh's vertices are the points, the next S rows give the
    first tangents, the last S rows the second ones; the cross product of the two points outwards. ``point`` [m] and
    unit ``normal`` (S, 3) are those of the mesh at rest; ``spacing_m`` (S,) is about the distance to neighbouring
    samples.
    """

    operator: scipy.sparse.csr_matrix
    point: np.ndarray
    normal: np.ndarray
    spacing_m: np.ndarray

    @property
    def count(self) -> int:
        return len(self.point)

    @property
    def region_count(self) -> int:
        return self.count // REGION_SIZE

    def posed(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the points [m] and unit outward normals (F, S, 3) of the samples on the mesh with ``vertices`` [m]
        (F, V, 3), in their frame. Raises ``InputError`` for other shapes."""
        sources = self.operator.get_shape()[1]
        check_shape("vertices", vertices, (None, sources, 3), error=InputError)
        # One product for all frames: the operator is read once.
        flat = vertices.transpose(1, 0, 2).reshape(sources, -1)
        rows = (self.operator @ flat).reshape(3, self.count, len(vertices), 3)
        point, first, second = rows.transpose(0, 2, 1, 3)
        normal = unit_cross(first.swapaxes(-1, -2), second.swapaxes(-1, -2)).swapaxes(-1, -2)
        return np.ascontiguousarray(point), np.ascontiguousarray(normal)

    def of_regions(self, regions: np.ndarray) -> Samples:
        """Returns the samples of the regions with the numbers ``regions`` (n,) alone, in that order."""
        kept = (REGION_SIZE * np.asarray(regions)[:, None] + np.arange(REGION_SIZE)).reshape(-1)
        rows = (self.count * np.arange(3)[:, None] + kept).reshape(-1)
        chosen = scipy.sparse.csr_matrix(self.operator[rows])
        return Samples(chosen, self.point[kept], self.normal[kept], self.spacing_m[kept])


class Placed(NamedTuple):
    """S places on a mesh at rest, in regions and clusters as those of ``Samples``: on the triangles ``face`` (S,) with
    the barycentric ``weight`` (S, 3).

    ``point`` [m] and unit ``normal`` (S, 3) are those of the places; ``spacing_m`` (S,) is the wanted distance to
    neighbours.
    """

    face: np.ndarray
    weight: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    spacing_m: np.ndarray


def place(
    rest: np.ndarray, faces: np.ndarray, spacing: np.ndarray, *, keep: Keep | None = None, seed: int = 0
) -> Placed:
    """Returns places about ``spacing`` [m] (V,) apart on the mesh ``rest`` [m] (V, 3), ``faces`` (F, 3). The same
    ``seed`` gives the same places.

    ``keep(points, normals, face, weight)`` returns which of n places stay, bool (n,); left out, all do.
    """
    normals = meshes.vertex_normals(rest, faces)
    face, weight = _spread(rest, faces, spacing, np.random.default_rng(seed))
    point = np.einsum("nk,nkc->nc", weight, rest[faces[face]])
    normal = unit(np.einsum("nk,nkc->nc", weight, normals[faces[face]]))
    if keep is not None:
        free = keep(point, normal, face, weight)
        face, weight, point, normal = face[free], weight[free], point[free], normal[free]
    own = np.einsum("nk,nk->n", weight, spacing[faces[face]])
    regions = blocks(point, normal, REGION_SIZE)
    order = np.concatenate([region[blocks(point[region], normal[region], CLUSTER_SIZE)] for region in regions])
    order = order.reshape(-1)
    # The last region fills up the last part. It counts twice, which changes a mean by its weight at most.
    short = -(len(order) // REGION_SIZE) % POSED_REGIONS
    order = np.concatenate([order, np.tile(order[-REGION_SIZE:], short)])
    return Placed(face[order], weight[order], point[order], normal[order], own[order])


def at_rest(operator: scipy.sparse.csr_matrix, rest: np.ndarray, placed: Placed) -> Samples:
    """Returns the samples at the places ``placed`` of the mesh ``rest`` [m] (V, 3). Their points and normals are those
    that ``operator`` (3 S, V) gives."""
    template = operator @ rest
    count = len(placed.point)
    smooth = np.asarray(unit_cross(template[count : 2 * count].T, template[2 * count :].T)).T
    return Samples(operator, template[:count], smooth, placed.spacing_m)


def sample_table(point: Array, normal: Array) -> Array:
    """Returns the rows (..., n, 8) of samples that ``field.attend`` takes: point b [m], b . b, unit normal n, n . b.
    ``point`` and ``normal`` are (..., n, 3)."""
    xp = namespace(point)
    return table_of_columns(xp.matrix_transpose(point), xp.matrix_transpose(normal))


def table_of_columns(point: Array, normal: Array) -> Array:
    """Returns ``sample_table`` (..., n, 8) for ``point`` and ``normal`` with the coordinates first, (..., 3, n)."""
    xp = namespace(point)
    square, across = dot_columns(point, point), dot_columns(point, normal)
    columns = xp.concat([point, square, normal, across], axis=-2)
    return xp.matrix_transpose(columns)


def region_centres(skin: Array) -> Array:
    """Returns the mean points [m] (F, R, 3) of the regions of ``skin`` (F, R, 12, 8), by one product with a constant
    matrix."""
    xp = namespace(skin)
    mean = [[(axis == entry) / REGION_SIZE for axis in range(3)] for _ in range(REGION_SIZE) for entry in range(8)]
    return xp.reshape(skin, (*skin.shape[:2], 8 * REGION_SIZE)) @ like(skin, mean)


def unit_cross(first: Array, second: Array) -> Array:
    """Returns the unit vectors (..., 3, n) along the cross product of ``first`` and ``second`` (..., 3, n); zero where
    these are parallel."""
    xp = namespace(first)
    across = cross_columns(first, second)
    # Tangents have length one at rest; a fold of the skin makes them nearly parallel and the normal short.
    # A bound and not a sum: ONNX exporters take "+ 1e-12" for "+ 0".
    return across * (1.0 / xp.sqrt(xp.clip(dot_columns(across, across), min=1e-12)))


def _spread(
    rest: np.ndarray, faces: np.ndarray, spacing: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Faces (n,) and barycentric weights (n, 3) of points no two of which are nearer than their spacing."""
    area = meshes.face_areas(rest, faces)
    own = spacing[faces].mean(axis=1)
    expected = DENSE_PER_DISC * area / own**2
    count = rng.poisson(expected)
    face = np.repeat(np.arange(len(faces)), count)
    face = rng.permutation(face)
    root, second = np.sqrt(rng.random(len(face))), rng.random(len(face))
    weight = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    point = np.einsum("nk,nkc->nc", weight, rest[faces[face]])
    radius = np.einsum("nk,nk->n", weight, spacing[faces[face]])
    # The two sides of a thin part are far apart along the skin: distance counts double across normals.
    normal = meshes.face_normals(rest, faces)[face]
    key = np.concatenate([point, 0.5 * radius.min(initial=1.0) * normal], axis=1)
    kept = thin_points(key, radius)
    return face[kept], weight[kept]


def thin_points(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Returns the indices of those ``points`` (n, d) that are kept, ascending: a point within the ``radius`` (n,) of a
    kept one before it is dropped."""
    tree, alive, kept = KDTree(points), np.ones(len(points), dtype=bool), []
    for index in range(len(points)):
        if alive[index]:
            kept.append(index)
            alive[tree.query_ball_point(points[index], radius[index])] = False
    return np.array(kept, dtype=np.int64)


def ring_operator(rest: np.ndarray, faces: np.ndarray, placed: Placed) -> scipy.sparse.csr_matrix:
    """Returns ``Samples.operator`` (3 S, V) of the places ``placed`` on the mesh ``rest`` [m] (V, 3), ``faces`` (F, 3).
    A tangent is a weighted sum over all vertices near the sample that face its way."""
    count, vertex_count = len(placed.point), len(rest)
    normals = meshes.vertex_normals(rest, faces)
    around = KDTree(rest).query_ball_point(placed.point, NORMAL_REACH * placed.spacing_m)
    sample = np.repeat(np.arange(count), [len(near) for near in around])
    near = np.concatenate([np.asarray(members, dtype=np.int64) for members in around])
    facing = np.einsum("nc,nc->n", normals[near], placed.normal[sample]) > FACING
    # A coarse mesh has no vertex within reach but the ring round the face.
    corners = faces[placed.face]
    touching = scipy.sparse.csr_matrix(
        (np.ones(3 * count), (np.repeat(np.arange(count), 3), corners.reshape(-1))), shape=(count, vertex_count)
    )
    itself = scipy.sparse.identity(vertex_count, format="csr")
    row, column = scipy.sparse.csr_matrix(touching @ (mesh_graphs.adjacency(faces, vertex_count) + itself)).nonzero()
    keys = np.unique(np.concatenate([sample[facing] * vertex_count + near[facing], row * vertex_count + column]))
    return operator(rest, faces, placed, keys // vertex_count, keys % vertex_count)


def operator(
    rest: np.ndarray, faces: np.ndarray, placed: Placed, sample: np.ndarray, near: np.ndarray
) -> scipy.sparse.csr_matrix:
    """Returns ``Samples.operator`` (3 S, V) of the places ``placed`` on the mesh ``rest`` [m] (V, 3), ``faces`` (F, 3):
    a point by its barycentric weights, tangents by a local least-squares plane.

    The plane of sample ``sample[i]`` goes through the vertex ``near[i]``, both (n,) sorted; the corners of the sample's
    face must be among its vertices.
    """
    count = len(placed.point)
    first, second = _tangents(placed.normal)
    offset = rest[near] - placed.point[sample]
    squared = (offset**2).sum(axis=1)
    mean = np.bincount(sample, np.sqrt(squared)) / np.bincount(sample)
    width = np.maximum(NORMAL_REACH * placed.spacing_m, mean)[sample]
    share = np.exp(-0.5 * squared / (0.5 * width) ** 2) + 1e-6
    along = [np.einsum("nc,nc->n", offset, tangent[sample]) for tangent in (first, second)]
    design = np.stack([np.ones(len(near)), *along], axis=1)
    starts = np.searchsorted(sample, np.arange(count))
    matrix = np.add.reduceat(share[:, None, None] * design[:, :, None] * design[:, None, :], starts)
    fit = np.einsum("nij,nj->ni", np.linalg.inv(matrix)[sample], share[:, None] * design)
    rows = np.concatenate([np.repeat(np.arange(count), 3), count + sample, 2 * count + sample])
    columns = np.concatenate([faces[placed.face].reshape(-1), near, near])
    values = np.concatenate([placed.weight.reshape(-1), fit[:, 1], fit[:, 2]])
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(3 * count, len(rest)))


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) each that with ``normal`` (n, 3) make right-handed frames."""
    first = unit(np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)]))
    return first, np.cross(normal, first)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Returns ``vectors`` (..., 3) scaled to length one."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
