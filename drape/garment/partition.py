"""Splits a mesh into K compact clusters of vertices: weighted approximated centroidal Voronoi diagrams.

Valette and Chassery (2004): clusters minimise ``sum_i w_i |x_i - c(i)|^2`` by moving
boundary vertices between neighbouring clusters. Here a sweep tests every boundary edge
at once with array operations; a random half of the improving moves is taken, since two
neighbours that move together may undo each other. Clusters that a move has torn are
mended at the end: every piece but the largest joins its neighbours.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from drape.errors import MeshError
from drape.geometry import mesh_graphs, meshes

MAX_SWEEPS = 120
MOVE_SHARE = 0.5
PATCH_AREA_M2 = 0.008  # OneFit, appendix A.2
PATCH_COUNT_RANGE = (100, 400)


def patch_count_for(area_m2: float, share: float = 1.0) -> int:
    """Returns the number of patches for cloth of ``area_m2``: ``share`` times clamp(area / 0.008, 100, 400), rounded
    (OneFit, appendix A.2)."""
    low, high = PATCH_COUNT_RANGE
    return round(share * int(np.clip(area_m2 / PATCH_AREA_M2, low, high)))


def vertex_graph(vertices: np.ndarray, faces: np.ndarray) -> scipy.sparse.csr_matrix:
    """Returns the sparse symmetric matrix (N, N) of edge lengths [m], and of the lengths of the diagonals across each
    edge. A diagonal joins the two vertices opposite an edge by their straight distance. Diagonals take most of the
    direction bias out of shortest paths on a triangle mesh."""
    sides = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])
    low, high = np.minimum(sides[:, 0], sides[:, 1]), np.maximum(sides[:, 0], sides[:, 1])
    key = low.astype(np.int64) * len(vertices) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    diagonal = np.stack([sides[order[same], 2], sides[order[same + 1], 2]], axis=1)
    edges = np.unique(np.concatenate([np.stack([low, high], axis=1), np.sort(diagonal, axis=1)]), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    length = np.maximum(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1), 1e-9)
    return mesh_graphs.edge_matrix(edges, length, len(vertices))


def partition(
    vertices: np.ndarray,
    faces: np.ndarray,
    weight: np.ndarray,
    count: int,
    *,
    seed: int,
    graph: scipy.sparse.csr_matrix | None = None,
) -> np.ndarray:
    """Returns the cluster (N,) int of each vertex, from 0 to K - 1; every cluster is connected and none is empty.

    ``weight`` (N,) is the mass of a vertex: its area, times a density where clusters should be smaller. Every connected
    piece of the mesh gets at least one cluster, so K may exceed ``count`` on meshes of many pieces. ``seed`` decides
    the random draws; ``graph`` is the ``vertex_graph``, if known. Raises ``MeshError`` for a ``count`` below 1 or above
    N.
    """
    if not 1 <= count <= len(vertices):
        raise MeshError(
            "patch count",
            expected=f"between 1 and the vertex count {len(vertices)}",
            got=str(count),
            cure="Subdivide the mesh or ask for fewer patches.",
        )
    rng = np.random.default_rng(seed)
    graph = vertex_graph(vertices, faces) if graph is None else graph
    seeds = _spread_seeds(vertices, weight, graph, count, rng)
    _, _, nearest = dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)
    slot = np.full(len(vertices), -1)
    slot[seeds] = np.arange(len(seeds))
    label = slot[nearest]
    edges = meshes.unique_edges(faces)
    label = _minimise(label, vertices, weight, edges, len(seeds), rng)
    return _connect(label, edges, len(seeds))


def _spread_seeds(
    vertices: np.ndarray, weight: np.ndarray, graph: scipy.sparse.csr_matrix, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Seeds per component in proportion to its weight, drawn by weight and spread as k-means++ does."""
    components, component = connected_components(graph, directed=False)
    mass = np.bincount(component, weight, components)
    share = mass / mass.sum() * count
    number = np.maximum(1, np.floor(share)).astype(int)
    size = np.bincount(component)
    # Largest remainders take what flooring left over.
    for index in np.argsort(number - share)[: max(0, count - number.sum())]:
        number[index] += 1
    number = np.minimum(number, size)
    # A heavy piece of few vertices cannot hold its share: the others take it over.
    for _ in range(count - int(number.sum())):
        number[np.argmax(np.where(number < size, share - number, -np.inf))] += 1
    seeds: list[int] = []
    for index in range(components):
        members = np.flatnonzero(component == index)
        probability = np.maximum(weight[members], 1e-12)
        picked = [int(rng.choice(members, p=probability / probability.sum()))]
        distance = np.linalg.norm(vertices[members] - vertices[picked[0]], axis=1)
        while len(picked) < number[index]:
            # k-means++: far places are likelier, so seeds spread but stay random.
            chance = probability * distance**2
            total = chance.sum()
            if total > 0:
                candidate = int(rng.choice(members, p=chance / total))
            else:
                candidate = int(members[~np.isin(members, picked)][0])
            picked.append(candidate)
            distance = np.minimum(distance, np.linalg.norm(vertices[members] - vertices[candidate], axis=1))
        seeds += picked
    return np.asarray(seeds)


def _minimise(
    label: np.ndarray, vertices: np.ndarray, weight: np.ndarray, edges: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    weighted = weight[:, None] * vertices
    for _ in range(MAX_SWEEPS):
        mass = np.bincount(label, weight, count)
        moment = np.stack([np.bincount(label, weighted[:, axis], count) for axis in range(3)], axis=1)
        size = np.bincount(label, minlength=count)
        differing = label[edges[:, 0]] != label[edges[:, 1]]
        crossing = edges[differing]
        mover = np.concatenate([crossing[:, 0], crossing[:, 1]])
        target = label[np.concatenate([crossing[:, 1], crossing[:, 0]])]
        source = label[mover]
        m, p = weight[mover], weighted[mover]
        # E = const - sum_c |moment_c|^2 / mass_c, so a move's gain needs only the two clusters.
        left_mass, right_mass = mass[source] - m, mass[target] + m
        left, right = moment[source] - p, moment[target] + p
        before = (moment[source] ** 2).sum(1) / mass[source] + (moment[target] ** 2).sum(1) / mass[target]
        after = (left**2).sum(1) / np.maximum(left_mass, 1e-18) + (right**2).sum(1) / right_mass
        gain = np.where(size[source] > 1, after - before, -1.0)
        improving = np.flatnonzero(gain > 1e-15)
        if not len(improving):
            break
        improving = improving[rng.random(len(improving)) < MOVE_SHARE]
        improving = improving[np.argsort(gain[improving])]  # the best move of a vertex is written last
        label = label.copy()
        label[mover[improving]] = target[improving]
        emptied = np.bincount(label, minlength=count) == 0
        for cluster in np.flatnonzero(emptied):
            # A single heavy vertex cannot give: it would leave its own cluster empty.
            giving = np.bincount(label, minlength=count) > 1
            largest = int(np.argmax(np.where(giving, np.bincount(label, weight, count), -1.0)))
            label[np.flatnonzero(label == largest)[0]] = cluster
    return label


def _connect(label: np.ndarray, edges: np.ndarray, count: int) -> np.ndarray:
    label = label.copy()
    while True:
        inside = edges[label[edges[:, 0]] == label[edges[:, 1]]]
        graph = scipy.sparse.coo_matrix((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=(len(label),) * 2)
        _, piece = connected_components(graph, directed=False)
        size = np.bincount(piece)
        order = np.argsort(size[piece], kind="stable")
        keeper = np.zeros(count, dtype=int)
        keeper[label[order]] = piece[order]  # the largest piece of each cluster is written last
        stray = piece != keeper[label]
        if not stray.any():
            break
        crossing = edges[stray[edges[:, 0]] ^ stray[edges[:, 1]]]
        first = stray[crossing[:, 0]]
        mover = np.where(first, crossing[:, 0], crossing[:, 1])
        host = np.where(first, crossing[:, 1], crossing[:, 0])
        if not len(mover):
            break
        label[mover] = label[host]
    return label
