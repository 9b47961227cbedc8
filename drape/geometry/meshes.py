"""Topology of triangle meshes (NumPy integers) and the geometry of their positions (numpy or torch).

Positions are (..., V, 3) with any leading batch axes; faces are (F, 3) vertex
indices, counter-clockwise seen from outside.
"""

from __future__ import annotations

import numpy as np

from drape.arrays import Array, device, like, namespace
from drape.errors import MeshError
from drape.geometry.rotations import cross

# --- topology --------------------------------------------------------------------------------------------------------


def check_faces(faces: np.ndarray, vertex_count: int, *, name: str = "faces") -> np.ndarray:
    """Returns ``faces`` as int64 (F, 3). Raises ``MeshError`` for another shape and for indices outside [0,
    vertex_count).
    """
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise MeshError(
            name,
            expected="integers of shape (F, 3)",
            got=f"{faces.dtype} of shape {faces.shape}",
            cure="Triangulate the mesh.",
        )
    if faces.size and (faces.min() < 0 or faces.max() >= vertex_count):
        raise MeshError(
            name,
            expected=f"indices in [0, {vertex_count})",
            got=f"[{faces.min()}, {faces.max()}]",
            cure="Repair the mesh.",
        )
    return faces.astype(np.int64)


def half_edges(faces: np.ndarray) -> np.ndarray:
    """Start, end and opposite vertex (3F, 3) of every half-edge; row ``3 f + c`` starts at corner c of face f."""
    return np.stack([faces, np.roll(faces, -1, axis=1), np.roll(faces, -2, axis=1)], axis=2).reshape(-1, 3)


def unique_edges(faces: np.ndarray) -> np.ndarray:
    """Undirected edges (E, 2), the smaller index first, in lexicographic order."""
    return edge_uses(faces)[0]


def edge_uses(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (E, 2) of ``unique_edges``, and how many faces (E,) each has."""
    if len(faces) == 0:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
    corners = faces.T
    key, base = _edge_keys(corners.reshape(-1), corners[[1, 2, 0]].reshape(-1))
    key.sort()
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    return np.stack(np.divmod(key[first], base), axis=1).astype(faces.dtype), np.diff(first, append=len(key))


def _edge_keys(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, int]:
    """One number (N,) for each undirected edge, low * base + high, and the base: rows sort ten times as slowly."""
    start, end = start.astype(np.int64), end.astype(np.int64)
    base = int(max(start.max(initial=0), end.max(initial=0))) + 1
    return np.minimum(start, end) * base + np.maximum(start, end), base


def edges_of_halves(halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the number (n,) of each half-edge's edge, and how many ``halves`` each edge (E,) has. The first two
    columns of ``halves`` are the ends."""
    _, inverse, counts = np.unique(_edge_keys(halves[:, 0], halves[:, 1])[0], return_inverse=True, return_counts=True)
    return inverse.reshape(-1), counts


def boundary_edges(faces: np.ndarray) -> np.ndarray:
    """The edges (B, 2) of ``unique_edges`` that one face alone has: the surface ends there."""
    edges, uses = edge_uses(faces)
    return edges[uses == 1]


def boundary_vertices(faces: np.ndarray) -> np.ndarray:
    """Vertices on a boundary edge, sorted."""
    return np.unique(boundary_edges(faces))


def edge_pairs(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the half-edges (3F, 3), and two arrays of rows of these: the half-edges of a pair lie on one edge. m
    faces on one edge give m - 1 pairs."""
    halves = half_edges(faces)
    key, _ = _edge_keys(halves[:, 0], halves[:, 1])
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    return halves, order[:-1][same], order[1:][same]


def edge_cosines(pairs: tuple[np.ndarray, np.ndarray, np.ndarray], normals: np.ndarray) -> np.ndarray:
    """The cosine (E,) between the ``normals`` (F, 3) of each pair of faces (``edge_pairs``), wound alike."""
    halves, first, second = pairs
    wound = np.where((halves[first, :2] == halves[second, :2]).all(axis=1), -1.0, 1.0)
    return wound * np.einsum("ec,ec->e", normals[first // 3], normals[second // 3])


def hinges(faces: np.ndarray) -> np.ndarray:
    """Hinges (H, 4) = (i, j, k, l): the shared edge i -> j, the vertex k opposite in one face, l in the other."""
    halves, first, second = edge_pairs(faces)
    return np.column_stack([halves[first], halves[second, 2]])


def hinge_faces(faces: np.ndarray) -> np.ndarray:
    """The two faces (H, 2) of every hinge, in the order of ``hinges``."""
    _, first, second = edge_pairs(faces)
    return np.column_stack([first // 3, second // 3])


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Vertex indices of every closed boundary, following the orientation of the faces, longest first.

    Where two boundaries touch in a vertex the walk takes either branch; where
    neighbouring faces disagree in orientation a boundary falls into open chains.
    """
    halves = half_edges(faces)[:, :2]
    number, counts = edges_of_halves(halves)
    border = halves[counts[number] == 1]
    following: dict[int, list[int]] = {}
    for start, end in border.tolist():
        following.setdefault(start, []).append(end)
    loops = []
    while following:
        start = min(following)
        loop, at = [], start
        while at in following:
            loop.append(at)
            branches = following[at]
            step = branches.pop()
            if not branches:
                del following[at]
            at = step
        loops.append(np.array(loop, dtype=np.int64))
    return sorted(loops, key=len, reverse=True)


def in_use(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (U,) that ``faces`` (F, 3) have, in order, and the faces by their numbers among these."""
    used, numbers = np.unique(faces, return_inverse=True)
    return used, numbers.reshape(-1, 3)


def subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Midpoint subdivision: vertices (N, 3), faces (4F, 3) and the two ``parents`` (N, 2) of every vertex.

    The original vertices come first, in their order, and are their own parents;
    any attribute follows as the mean of its parents'. Face ``4 f + c`` is the
    corner c of face f, ``4 f + 3`` its middle.
    """
    count = len(vertices)
    ends = np.sort(half_edges(faces)[:, :2], axis=1)
    edges, inverse = np.unique(ends, axis=0, return_inverse=True)
    middle = count + inverse.reshape(-1, 3)  # of the edges 01, 12, 20
    parents = np.concatenate([np.repeat(np.arange(count)[:, None], 2, axis=1), edges])
    a, b, c = faces.T
    ab, bc, ca = middle.T
    split = [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    fine = np.stack([np.stack(corners, axis=1) for corners in split], axis=1).reshape(-1, 3)
    return vertices[parents].mean(axis=1), fine, parents


# --- geometry of positions -------------------------------------------------------------------------------------------


def corner_edges(vertices: Array, faces: np.ndarray) -> tuple[Array, Array]:
    """The two edge vectors [m] (..., F, 3) that leave the first corner of every face."""
    origin = _take(vertices, faces[:, 0])
    return _take(vertices, faces[:, 1]) - origin, _take(vertices, faces[:, 2]) - origin


def area_vectors(vertices: Array, faces: np.ndarray) -> Array:
    """Face normals times face areas [m^2] (..., F, 3)."""
    return 0.5 * cross(*corner_edges(vertices, faces))


def face_areas(vertices: Array, faces: np.ndarray) -> Array:
    """Face areas [m^2] (..., F)."""
    return _length(area_vectors(vertices, faces))[..., 0]


def face_normals(vertices: Array, faces: np.ndarray) -> Array:
    """Unit face normals (..., F, 3); zero where a face is degenerate."""
    return _unit(area_vectors(vertices, faces))


def edge_lengths(vertices: Array, edges: np.ndarray) -> Array:
    """Lengths [m] (..., E) of ``edges`` (E, 2)."""
    return _length(_take(vertices, edges[:, 1]) - _take(vertices, edges[:, 0]))[..., 0]


def face_table(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Faces around every vertex (V, D), D the largest number there; free places hold F."""
    corners = faces.reshape(-1)
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=vertex_count)
    place = np.arange(len(corners)) - np.repeat(np.cumsum(counts) - counts, counts)
    table = np.full((vertex_count, counts.max(initial=0)), len(faces), dtype=np.int64)
    table[corners[order], place] = order // 3
    return table


def vertex_sums(values: Array, table: np.ndarray) -> Array:
    """Sums (..., V, C) over the faces around every vertex of face values (..., F, C)."""
    xp = namespace(values)
    padded = xp.concat([values, xp.zeros_like(values[..., :1, :])], axis=-2)
    total = _take(padded, table[:, 0])
    for column in range(1, table.shape[1]):
        total = total + _take(padded, table[:, column])
    return total


def vertex_normals(vertices: Array, faces: np.ndarray, *, table: np.ndarray | None = None) -> Array:
    """Unit vertex normals (..., V, 3), the face normals around a vertex weighted by area.

    Pass ``face_table(faces, V)`` as ``table`` where the same mesh comes again.
    """
    table = face_table(faces, vertices.shape[-2]) if table is None else table
    return _unit(vertex_sums(area_vectors(vertices, faces), table))


def signed_areas(uv: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas [m^2] (F,) of triangles in the plane ``uv`` [m] (..., 2); negative where one is turned over."""
    a, b, c = (uv[faces[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def vertex_areas(vertices: Array, faces: np.ndarray) -> Array:
    """Areas [m^2] (..., V): a third of every face around the vertex."""
    areas = face_areas(vertices, faces)[..., None] / 3.0
    return vertex_sums(areas, face_table(faces, vertices.shape[-2]))[..., 0]


def _take(values: Array, index: np.ndarray) -> Array:
    xp = namespace(values)
    return xp.take(values, xp.asarray(index, device=device(values)), axis=-2)


def _length(vectors: Array) -> Array:
    # The guard keeps the gradient of a vanishing length finite.
    xp = namespace(vectors)
    return xp.sqrt(xp.sum(vectors * vectors, axis=-1, keepdims=True) + like(vectors, 1e-36))


def _unit(vectors: Array) -> Array:
    return vectors / _length(vectors)
