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
    """Returns the start, the end and the opposite vertex (3F, 3) of every half-edge; row ``3 f + c`` starts at corner c
    of face f."""
    return np.stack([faces, np.roll(faces, -1, axis=1), np.roll(faces, -2, axis=1)], axis=2).reshape(-1, 3)


def unique_edges(faces: np.ndarray) -> np.ndarray:
    """Returns the undirected edges (E, 2) of ``faces``, the smaller vertex first, in lexicographic order."""
    return edge_uses(faces)[0]


def edge_uses(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the undirected edges (E, 2) as ``unique_edges`` does, and the number (E,) of faces at each."""
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
    """Returns for each half-edge the number (n,) of its undirected edge, and for each of E edges the number (E,) of its
    half-edges. Edges are numbered in lexicographic order; the first two columns of ``halves`` are their ends."""
    _, inverse, counts = np.unique(_edge_keys(halves[:, 0], halves[:, 1])[0], return_inverse=True, return_counts=True)
    return inverse.reshape(-1), counts


def boundary_edges(faces: np.ndarray) -> np.ndarray:
    """Returns the undirected edges (B, 2), as ``unique_edges`` has them, that belong to a single face: the surface ends
    there."""
    edges, uses = edge_uses(faces)
    return edges[uses == 1]


def boundary_vertices(faces: np.ndarray) -> np.ndarray:
    """Returns the vertices (n,) on boundary edges, ascending."""
    return np.unique(boundary_edges(faces))


def edge_pairs(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the ``half_edges`` (3F, 3), and of P pairs of half-edges on one edge the rows (P,) of the first and the
    rows (P,) of the second. An edge with m faces has m - 1 pairs."""
    halves = half_edges(faces)
    key, _ = _edge_keys(halves[:, 0], halves[:, 1])
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    return halves, order[:-1][same], order[1:][same]


def edge_cosines(pairs: tuple[np.ndarray, np.ndarray, np.ndarray], normals: np.ndarray) -> np.ndarray:
    """Returns for each pair of faces at an edge the cosine (P,) between their ``normals`` (F, 3), as if both were wound
    alike. ``pairs``: what ``edge_pairs`` returns."""
    halves, first, second = pairs
    wound = np.where((halves[first, :2] == halves[second, :2]).all(axis=1), -1.0, 1.0)
    return wound * np.einsum("ec,ec->e", normals[first // 3], normals[second // 3])


def hinges(faces: np.ndarray) -> np.ndarray:
    """Returns the hinges (H, 4) = (i, j, k, l), edges between two faces: the edge i -> j, the vertex k opposite in one
    face, l in the other."""
    halves, first, second = edge_pairs(faces)
    return np.column_stack([halves[first], halves[second, 2]])


def hinge_faces(faces: np.ndarray) -> np.ndarray:
    """Returns the two faces (H, 2) at every hinge, in the order of ``hinges``."""
    _, first, second = edge_pairs(faces)
    return np.column_stack([first // 3, second // 3])


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Returns the vertices (n,) of every closed boundary in the order of its half-edges, the boundary with the most
    vertices first. Where two boundaries touch in a vertex the walk takes either branch. Where neighbouring faces
    disagree in orientation a boundary falls into open chains."""
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
    """Returns the vertices (U,) that ``faces`` (F, 3) use, ascending, and the faces (F, 3) as rows of these."""
    used, numbers = np.unique(faces, return_inverse=True)
    return used, numbers.reshape(-1, 3)


def subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices (N, C), faces (4F, 3) and the two parents (N, 2) of every vertex after midpoint subdivision. The
    original vertices come first, in their order, and are their own parents; any attribute of a vertex is the mean of
    its parents'. Face ``4 f + c`` is the corner c of face f, ``4 f + 3`` its middle."""
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
    """Returns the edge vectors [m] (..., F, 3) from the first corner of every face to its second corner, and to its
    third."""
    origin = _take(vertices, faces[:, 0])
    return _take(vertices, faces[:, 1]) - origin, _take(vertices, faces[:, 2]) - origin


def area_vectors(vertices: Array, faces: np.ndarray) -> Array:
    """Returns the unit normal of every face times its area [m^2] (..., F, 3)."""
    return 0.5 * cross(*corner_edges(vertices, faces))


def face_areas(vertices: Array, faces: np.ndarray) -> Array:
    """Returns the areas [m^2] (..., F) of faces."""
    return _length(area_vectors(vertices, faces))[..., 0]


def face_normals(vertices: Array, faces: np.ndarray) -> Array:
    """Returns the unit normals (..., F, 3) of faces; zero where a face is degenerate."""
    return _unit(area_vectors(vertices, faces))


def edge_lengths(vertices: Array, edges: np.ndarray) -> Array:
    """Returns the lengths [m] (..., E) of ``edges`` (E, 2)."""
    return _length(_take(vertices, edges[:, 1]) - _take(vertices, edges[:, 0]))[..., 0]


def face_table(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Returns the faces around every vertex (V, D) int64, where D is the largest number of them; places that are left
    hold F."""
    corners = faces.reshape(-1)
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=vertex_count)
    place = np.arange(len(corners)) - np.repeat(np.cumsum(counts) - counts, counts)
    table = np.full((vertex_count, counts.max(initial=0)), len(faces), dtype=np.int64)
    table[corners[order], place] = order // 3
    return table


def vertex_sums(values: Array, table: np.ndarray) -> Array:
    """Returns for every vertex the sum (..., V, C) of ``values`` (..., F, C) over the faces around it. ``table`` (V,
    D): what ``face_table`` returns."""
    xp = namespace(values)
    padded = xp.concat([values, xp.zeros_like(values[..., :1, :])], axis=-2)
    total = _take(padded, table[:, 0])
    for column in range(1, table.shape[1]):
        total = total + _take(padded, table[:, column])
    return total


def vertex_normals(vertices: Array, faces: np.ndarray, *, table: np.ndarray | None = None) -> Array:
    """Returns the unit normals (..., V, 3) of vertices: the normals of the faces around a vertex, weighted by area. It
    is zero for a vertex without faces. ``table``: what ``face_table(faces, V)`` returns, for a mesh that comes more
    than once."""
    table = face_table(faces, vertices.shape[-2]) if table is None else table
    return _unit(vertex_sums(area_vectors(vertices, faces), table))


def signed_areas(uv: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the areas [m^2] (F,) of triangles in the plane, with vertices at ``uv`` [m] (V, 2); negative where a
    triangle is clockwise."""
    a, b, c = (uv[faces[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def vertex_areas(vertices: Array, faces: np.ndarray) -> Array:
    """Returns for every vertex a third of the areas [m^2] (..., V) of the faces around it."""
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
