"""The coarse mesh on which cloth swings: nodes spread evenly along the cloth, triangles between them, and weights that
move the vertices by the nodes' displacements.

A node is a vertex of the garment. Distances are along the cloth at rest: the shortest way over edges and over the
diagonals of two triangles laid flat. Every vertex belongs to its nearest node. A triangle of the garment whose corners
belong to three nodes stands for a coarse triangle, with the distances between these nodes as sides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.cloth.problem import rest_edges, unfold_hinges
from drape.geometry import meshes
from drape.live.coarse_weights import list_entries
from drape.live.swing_rows import SwingRows, swing_rows

SPACING_M = 0.07  # between nodes; less gives the same swing for more time
REACH = 1.5  # in spacings: the distance within which a node moves a vertex
SHARED = 8  # the most nodes that move a vertex, the nearest ones
DETOUR = 1.02  # a way over edges and diagonals is that much longer, on average, than the shortest along the cloth
ACROSS = 0.05  # ratio of the tension across the fall to that along it: columns of cloth hardly hold each other
SLIVER = 0.15  # a coarse triangle with a corner of a smaller sine is left out
LINE = 0.01  # added to the moments, so that the weights' linear fit is regular where nodes lie in a line


class SwingMesh(NamedTuple):
    """The coarse mesh on which a garment of V vertices swings: N nodes, at which the garment has the vertices
    ``vertex`` (N,).

    ``mass_kg`` and ``area_m2`` (N,) are those of a node's cell. ``order`` are the nodes that may move, from those next
    to held ones outwards. The coarse triangles of node i are rows ``start[i]`` to ``start[i + 1]`` of ``other`` (n, 2),
    the two other corners, and ``slope`` (n, 5): their slopes [1/m] along both axes, and the area [m^2]. ``pull_start``
    (N + 1,), ``pull_node`` and ``pull`` [N/m] are compressed rows of the matrix by which weight pulls nodes back.
    ``weight_node`` and ``weight`` (V, ``SHARED``) are the nodes that move each vertex, and its share of each node's
    displacement. ``rows`` has nodes and triangles once more, in blocks.
    """

    vertex: np.ndarray
    mass_kg: np.ndarray
    area_m2: np.ndarray
    order: np.ndarray
    start: np.ndarray
    other: np.ndarray
    slope: np.ndarray
    weight_node: np.ndarray
    weight: np.ndarray
    pull_start: np.ndarray
    pull_node: np.ndarray
    pull: np.ndarray
    rows: SwingRows


def swing_mesh(
    cloth: ClothMesh, material: Material, rest: np.ndarray, held: np.ndarray, *, dtype: type[np.floating] = np.float32
) -> SwingMesh | None:
    """Returns the coarse mesh of ``cloth`` of ``material`` that lies at ``rest`` [m] (V, 3), floats of ``dtype``.

    ``held`` (V,) bool says which vertices never swing. The mesh is None where no coarse triangle has a node that may
    move, as in cloth that is held as a whole or is too small for a triangle, and where no vertex is held: cloth that
    nothing holds does not hang.
    """
    graph = along_cloth(cloth)
    chosen, ways = _spread(graph, rest)
    near, away = _sorted_ways(*ways, len(rest))
    own, apart = near[:, 0], _apart(*ways, chosen)
    faces = _coarse_faces(own[cloth.faces], apart)
    movable = ~held[chosen]
    kept = np.zeros(len(chosen), bool)
    kept[faces[movable[faces].any(axis=1)]] = True
    if not (kept & movable).any() or not held.any():
        return None
    number = np.cumsum(kept) - 1
    faces = number[faces[kept[faces].all(axis=1)]]
    chosen, movable, sides = chosen[kept], movable[kept], apart[np.ix_(kept, kept)] / DETOUR
    start, other, slope = _fans(faces, sides, len(chosen))
    cell = np.where(kept[own], number[own], len(chosen))
    mass, area = (
        np.bincount(cell, weights=values, minlength=len(chosen) + 1)[: len(chosen)]
        for values in (cloth.vertex_mass(material), cloth.vertex_area)
    )
    there = kept[ways.node]
    near, away = _sorted_ways(ways.vertex[there], number[ways.node[there]], ways.length[there], len(rest))
    weight_node, weight = _weights(near, away, rest, np.asarray(meshes.vertex_normals(rest, cloth.faces)), chosen)
    order = _outwards(faces, sides, movable)
    return SwingMesh(
        chosen.astype(np.int32), mass.astype(dtype), area.astype(dtype), order,
        start, other, slope.astype(dtype), weight_node, weight.astype(dtype),
        *_pull(start, other, slope, _weight_below(graph, cloth, held, material)[chosen], float(area.sum()), dtype),
        swing_rows(order, start, other, slope.astype(dtype)),
    )  # fmt: skip


def along_cloth(cloth: ClothMesh) -> Any:
    """Returns a sparse symmetric matrix (V, V) of the lengths [m] at rest of edges, and of diagonals between two
    triangles laid flat."""
    edges, flat = rest_edges(cloth), unfold_hinges(cloth)
    place = np.concatenate([np.zeros((len(edges), 1, 2)), edges], axis=1)  # corners (F, 3, 2)
    faces, hinges = cloth.faces, cloth.hinge_index.reshape(4, -1).T
    ends = [(faces[:, i], faces[:, (i + 1) % 3]) for i in range(3)]
    lengths = [np.linalg.norm(place[:, i] - place[:, (i + 1) % 3], axis=1) for i in range(3)]
    along, up = flat.along / flat.length, flat.height
    high = np.maximum(up[0] + up[1], 1e-12)
    crossing = along[0] + (along[1] - along[0]) * up[0] / high
    inside = (crossing > 0.0) & (crossing < flat.length.min(axis=0))
    ends.append((hinges[inside, 2], hinges[inside, 3]))
    lengths.append(np.hypot(along[0] - along[1], high)[inside])
    first, second, length = (np.concatenate(parts) for parts in (*zip(*ends, strict=True), lengths))
    count = cloth.vertex_count
    key = np.minimum(first, second).astype(np.int64) * count + np.maximum(first, second)
    shortest = np.lexsort((length, key))[np.unique(np.sort(key), return_index=True)[1]]
    low, high_end = np.divmod(key[shortest], count)
    matrix = scipy.sparse.coo_matrix((length[shortest], (low, high_end)), shape=(count, count)).tocsr()
    return matrix + matrix.T


class _Ways(NamedTuple):
    """The vertex and the node (E,) of every pair within reach, node by node, and the ``length`` [m] (E,) of the way."""

    vertex: np.ndarray
    node: np.ndarray
    length: np.ndarray


def _spread(graph: Any, rest: np.ndarray) -> tuple[np.ndarray, _Ways]:
    """Vertices (N,) no two of which are nearer than ``SPACING_M``, and the ways from all vertices to them, as nodes.
    They are chosen from the lowest up, so that hems have theirs."""
    nearest, chosen, rows_of_nodes = np.full(len(rest), np.inf), [], []
    for vertex in np.argsort(rest[:, 1], kind="stable"):
        if nearest[vertex] >= SPACING_M:
            distance = dijkstra(graph, indices=int(vertex), limit=(REACH + 0.5) * SPACING_M)
            np.minimum(nearest, distance, out=nearest)
            rows = np.flatnonzero(np.isfinite(distance))
            rows_of_nodes.append((rows, np.full(len(rows), len(chosen)), distance[rows]))
            chosen.append(int(vertex))
    return np.array(chosen), _Ways(*map(np.concatenate, zip(*rows_of_nodes, strict=True)))


def _sorted_ways(vertex: np.ndarray, node: np.ndarray, length: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The nodes nearest to each of ``count`` vertices, the nearest first, and the ways there [m], infinite beyond
    reach: (V, ``SHARED``) each."""
    order = np.argsort(vertex, kind="stable")
    row, rank = list_entries(np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=count))]))
    shape = count, max(SHARED, int(rank.max(initial=0)) + 1)
    nodes, ways = np.zeros(shape, np.int64), np.full(shape, np.inf)
    nodes[row, rank], ways[row, rank] = node[order], length[order]
    near = np.argsort(ways, axis=1, kind="stable")[:, :SHARED]
    return np.take_along_axis(nodes, near, axis=1), np.take_along_axis(ways, near, axis=1)


def _apart(vertex: np.ndarray, node: np.ndarray, length: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The ways [m] (N, N) between the nodes ``chosen`` (N,), infinite beyond reach."""
    at = np.full(max(vertex.max(), chosen.max()) + 1, -1)
    at[chosen] = np.arange(len(chosen))
    there, ways = at[vertex] >= 0, np.full((len(chosen), len(chosen)), np.inf)
    ways[at[vertex[there]], node[there]] = length[there]
    return ways


def _coarse_faces(cells: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The triangles (n, 3) of nodes that a triangle of the garment joins, each once, without slivers; ``cells`` (F, 3)
    are the nodes of the garment's corners."""
    distinct = (cells != np.roll(cells, 1, axis=1)).all(axis=1)
    cells = cells[distinct]
    first = cells.argmin(axis=1)
    turned = np.unique(cells[np.arange(len(cells))[:, None], (first[:, None] + np.arange(3)) % 3], axis=0)
    a, b, c = (sides[turned[:, i], turned[:, (i + 1) % 3]] for i in range(3))
    with np.errstate(invalid="ignore"):
        cosines = [(x * x + y * y - z * z) / (2.0 * x * y) for x, y, z in ((a, c, b), (a, b, c), (b, c, a))]
        good = np.isfinite(a + b + c) & (np.abs(cosines) < np.sqrt(1.0 - SLIVER**2)).all(axis=0)
    return turned[good]


def _fans(faces: np.ndarray, sides: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``start``, ``other`` and ``slope`` of ``SwingMesh`` for triangles of these ``sides`` (N, N) [m]."""
    corner = faces[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]].reshape(-1, 3)  # once with each corner in front
    corner = corner[np.argsort(corner[:, 0], kind="stable")]
    first, second, across = (sides[corner[:, i], corner[:, j]] for i, j in ((0, 1), (0, 2), (1, 2)))
    cosine = (first**2 + second**2 - across**2) / (2.0 * first * second)
    sine = np.sqrt(1.0 - cosine**2)
    zero = np.zeros_like(first)
    # The columns of the inverse of [[first, second cos], [0, second sin]] are both corners' slopes along one axis.
    slope = np.stack(
        [1.0 / first, zero, -cosine / (first * sine), 1.0 / (second * sine), 0.5 * first * second * sine], axis=1
    )
    start = np.concatenate([[0], np.cumsum(np.bincount(corner[:, 0], minlength=count))])
    return start.astype(np.int32), corner[:, 1:].astype(np.int32), slope


def _outwards(faces: np.ndarray, sides: np.ndarray, movable: np.ndarray) -> np.ndarray:
    """The nodes that are ``movable`` (N,), the nearest along the cloth to one that is held first."""
    first, second = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    graph = scipy.sparse.coo_matrix((sides[first, second], (first, second)), shape=sides.shape).tocsr()
    held = np.flatnonzero(~movable)
    if len(held):
        distance = dijkstra(graph.maximum(graph.T), indices=held, min_only=True)
    else:
        distance = np.zeros(len(movable))
    order = np.argsort(distance, kind="stable")
    return order[movable[order]].astype(np.int32)


def _weights(
    near: np.ndarray, away: np.ndarray, rest: np.ndarray, normals: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``weight_node`` and ``weight`` of ``SwingMesh``, (V, ``SHARED``) each, from what ``_sorted_ways`` finds: moving
    least squares of degree one at rest, without a slope along the surface's ``normals`` (V, 3)."""
    bump = (1.0 - np.minimum(away / (REACH * SPACING_M), 1.0) ** 2) ** 2
    near = np.where(bump > 0.0, near, 0)
    ways = (rest[chosen[near]] - rest[:, None]) / SPACING_M
    basis = np.concatenate([np.ones((*near.shape, 1)), ways], axis=2)
    moments = np.einsum("vk,vka,vkb->vab", bump, basis, basis)
    flat = normals[:, :, None] * normals[:, None, :] + LINE * np.eye(3)
    moments[:, 1:, 1:] += moments[:, :1, :1] * flat
    row, some = np.zeros((len(rest), 4)), moments[:, 0, 0] > 0.0
    row[some] = np.linalg.inv(moments[some])[:, 0]
    return near.astype(np.int32), bump * np.einsum("vka,va->vk", basis, row)


def _weight_below(graph: Any, cloth: ClothMesh, held: np.ndarray, material: Material) -> np.ndarray:
    """Tension [N/m] (V,) in cloth that hangs from what is ``held`` (V,), at least one vertex.

    It is the weight of the strip that goes on from a vertex, by the steepest way away from what is held, to its end.
    """
    away = dijkstra(graph, indices=np.flatnonzero(held), min_only=True)
    away = np.where(np.isfinite(away), away, 0.0)
    links = graph.tocoo()
    rise = (away[links.col] - away[links.row]) / links.data
    order = np.lexsort((-rise, links.row))
    first = order[np.unique(links.row[order], return_index=True)[1]]
    end = np.arange(cloth.vertex_count)
    end[links.row[first]] = np.where(rise[first] > 0.0, links.col[first], links.row[first])
    while not np.array_equal(end, end[end]):
        end = end[end]
    return float(material.density_kg_m2) * material.gravity_m_s2 * (away[end] - away)


def _pull(
    start: np.ndarray,
    other: np.ndarray,
    slope: np.ndarray,
    tension: np.ndarray,
    area_m2: float,
    dtype: type[np.floating],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows ``pull`` of ``SwingMesh`` for the ``tension`` [N/m] (N,) at the nodes.

    The stiffness of a string under tension, on a surface: the sum of A T (s . grad u)^2 / 2 over the triangles, s the
    unit vector along which the tension falls, and a share of that across. The triangles end at the outermost nodes, so
    that their area is scaled up to the whole ``area_m2``.
    """
    count = len(tension)
    own = np.repeat(np.arange(count), np.diff(start))
    corner = np.concatenate([own[:, None], other], axis=1)  # each triangle three times
    by_p = np.stack([-slope[:, 0] - slope[:, 1], slope[:, 0], slope[:, 1]], axis=1)
    by_t = np.stack([-slope[:, 2] - slope[:, 3], slope[:, 2], slope[:, 3]], axis=1)
    values = tension[corner]
    down = np.stack([(by_p * values).sum(axis=1), (by_t * values).sum(axis=1)], axis=1)
    down /= np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-9)
    along = by_p * down[:, :1] + by_t * down[:, 1:]
    across = by_p * down[:, 1:] - by_t * down[:, :1]
    # Both sums count every triangle three times.
    strength = values.mean(axis=1) * slope[:, 4] * (area_m2 / slope[:, 4].sum())
    entries = strength[:, None, None] * (
        along[:, :, None] * along[:, None, :] + ACROSS * across[:, :, None] * across[:, None, :]
    )
    index = np.repeat(corner, 3, axis=1).reshape(-1), np.tile(corner, (1, 3)).reshape(-1)
    matrix = scipy.sparse.coo_matrix((entries.reshape(-1), index), shape=(count, count)).tocsr()
    matrix.sum_duplicates()
    matrix.sort_indices()
    return matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), matrix.data.astype(dtype)
