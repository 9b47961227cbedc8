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
NORMAL_REACH = 1.5  # spacings over which a sample's tangents are averaged
REGION_SIZE = 12  # samples of other parts that are looked up together
CLUSTER_SIZE = 4  # and of the own part
POSED_REGIONS = 4  # regions that are posed in one product

FACING = 0.2  # cosine from which a vertex counts as facing the way of a sample

Keep = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Samples:
    """S samples: ``REGION_SIZE`` in a row are a region, ``CLUSTER_SIZE`` of these a cluster; S makes whole parts of
    ``POSED_REGIONS`` regions.

    ``operator`` sparse (3 S, V): the mesh's vertices times its first S rows are the points, times the next S the first
    tangents, times the last S the second ones; their cross product points outwards. ``point``, ``normal`` (S, 3) of the
    mesh at rest; ``spacing_m`` (S,) to the neighbouring samples.
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
        """Points [m] and unit normals (F, S, 3) on the mesh posed to ``vertices`` (F, V, 3)."""
        sources = self.operator.get_shape()[1]
        check_shape("vertices", vertices, (None, sources, 3), error=InputError)
        # One product for all frames: the operator is read once.
        flat = vertices.transpose(1, 0, 2).reshape(sources, -1)
        rows = (self.operator @ flat).reshape(3, self.count, len(vertices), 3)
        point, first, second = rows.transpose(0, 2, 1, 3)
        normal = unit_cross(first.swapaxes(-1, -2), second.swapaxes(-1, -2)).swapaxes(-1, -2)
        return np.ascontiguousarray(point), np.ascontiguousarray(normal)

    def of_regions(self, regions: np.ndarray) -> Samples:
        """The samples of ``regions`` (n,) alone, in that order."""
        kept = (REGION_SIZE * np.asarray(regions)[:, None] + np.arange(REGION_SIZE)).reshape(-1)
        rows = (self.count * np.arange(3)[:, None] + kept).reshape(-1)
        chosen = scipy.sparse.csr_matrix(self.operator[rows])
        return Samples(chosen, self.point[kept], self.normal[kept], self.spacing_m[kept])


class Placed(NamedTuple):
    """S samples at rest, on the triangles ``face`` (S,) with barycentric ``weight`` (S, 3).

    Their ``point`` [m] and unit ``normal`` (S, 3), and the ``spacing_m`` (S,) to their neighbours.
    """

    face: np.ndarray
    weight: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    spacing_m: np.ndarray


def place(
    rest: np.ndarray, faces: np.ndarray, spacing: np.ndarray, *, keep: Keep | None = None, seed: int = 0
) -> Placed:
    """Samples ``spacing`` [m] (V,) apart on the mesh ``rest`` [m] (V, 3), in regions and clusters; always the same.

    ``keep(points, normals, face, weight)`` says which of the points (n, 3) are to stay.
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
    # Whole products: the last region again, which changes no mean by more than its weight.
    short = -(len(order) // REGION_SIZE) % POSED_REGIONS
    order = np.concatenate([order, np.tile(order[-REGION_SIZE:], short)])
    return Placed(face[order], weight[order], point[order], normal[order], own[order])


def at_rest(operator: scipy.sparse.csr_matrix, rest: np.ndarray, placed: Placed) -> Samples:
    """Returns the samples that were ``placed`` on the mesh ``rest`` [m] (V, 3), with the points and normals that
    ``operator`` gives."""
    template = operator @ rest
    count = len(placed.point)
    smooth = np.asarray(unit_cross(template[count : 2 * count].T, template[2 * count :].T)).T
    return Samples(operator, template[:count], smooth, placed.spacing_m)


def sample_table(point: Array, normal: Array) -> Array:
    """Rows (..., n, 8) of samples (..., n, 3) as the field reads them: point b, b . b, normal n, n . b."""
    xp = namespace(point)
    return table_of_columns(xp.matrix_transpose(point), xp.matrix_transpose(normal))


def table_of_columns(point: Array, normal: Array) -> Array:
    """Returns ``sample_table`` (..., n, 8) of points and normals given coordinates first (..., 3, n)."""
    xp = namespace(point)
    square, across = dot_columns(point, point), dot_columns(point, normal)
    columns = xp.concat([point, square, normal, across], axis=-2)
    return xp.matrix_transpose(columns)


def region_centres(skin: Array) -> Array:
    """Mean points [m] (F, R, 3) of the regions of ``skin`` (F, R, 12, 8), as one product with a constant matrix."""
    xp = namespace(skin)
    mean = [[(axis == entry) / REGION_SIZE for axis in range(3)] for _ in range(REGION_SIZE) for entry in range(8)]
    return xp.reshape(skin, (*skin.shape[:2], 8 * REGION_SIZE)) @ like(skin, mean)


def unit_cross(first: Array, second: Array) -> Array:
    """The unit vectors across ``first`` and ``second`` (..., 3, n), coordinates first; zero where parallel."""
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
    kept = thinned(key, radius)
    return face[kept], weight[kept]


def thinned(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Indices of the ``points`` (n, d) kept, in their order: none lies within ``radius`` (n,) of one before."""
    tree, alive, kept = KDTree(points), np.ones(len(points), dtype=bool), []
    for index in range(len(points)):
        if alive[index]:
            kept.append(index)
            alive[tree.query_ball_point(points[index], radius[index])] = False
    return np.array(kept, dtype=np.int64)


def ring_operator(rest: np.ndarray, faces: np.ndarray, placed: Placed) -> scipy.sparse.csr_matrix:
    """Returns an ``operator`` of ``Samples`` whose tangents are sums over all vertices near a sample that face its
    way."""
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
    """Returns ``Samples.operator``: the point by its barycentric weights, the tangents by a local least-squares plane.

    A plane goes through the vertices ``near`` (n,) of its ``sample`` (n,), which are sorted and have the corners of the
    sample's face.
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
