"""Meshes as graphs: sparse matrices over their vertices, Laplacians, and pieces."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.geometry import meshes


def connected_components(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Returns the number (V,) int64 of the connected piece of every vertex, from 0; a vertex without a face is a piece
    of its own."""
    return csgraph.connected_components(adjacency(faces, vertex_count), directed=False)[1].astype(np.int64)


def joined_parts(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns for each of ``count`` things the number (``count``,) of its part, from 0. Things ``a[i]`` and ``b[i]``
    (n,) are joined, and joined things are one part."""
    graph = scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
    return csgraph.connected_components(graph, directed=False)[1]


def adjacency(faces: np.ndarray, vertex_count: int) -> scipy.sparse.csr_matrix:
    """Returns the sparse symmetric matrix (V, V) with 1 for every two vertices that an edge joins."""
    edges = meshes.unique_edges(faces)
    return edge_matrix(edges, np.ones(len(edges)), vertex_count)


def edge_matrix(edges: np.ndarray, values: np.ndarray, vertex_count: int) -> scipy.sparse.csr_matrix:
    """Returns the sparse symmetric matrix (V, V) with ``values`` (E,) at ``edges`` (E, 2), which name each edge
    once."""
    both = np.concatenate([edges, edges[:, ::-1]])
    entries = np.concatenate([values, values]), (both[:, 0], both[:, 1])
    return scipy.sparse.csr_matrix(entries, shape=(vertex_count, vertex_count))


def edge_graph(vertices: np.ndarray, faces: np.ndarray) -> scipy.sparse.csr_matrix:
    """Returns the sparse symmetric matrix (V, V) with the length [m] of every edge, at least 1e-9: zero would say that
    there is no edge."""
    edges = meshes.unique_edges(faces)
    return edge_matrix(edges, np.maximum(meshes.edge_lengths(vertices, edges), 1e-9), len(vertices))


def weighted_laplacian(weights: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    """Returns the sparse matrix D - W (V, V) of the symmetric matrix ``weights`` W, where D is the diagonal of its row
    sums."""
    return scipy.sparse.diags(np.asarray(weights.sum(axis=1)).reshape(-1)) - weights


def umbrella_laplacian(faces: np.ndarray, vertex_count: int) -> scipy.sparse.csr_matrix:
    """Returns the sparse matrix (V, V) whose product with positions is (mean of the neighbours) - (own position); the
    row of a vertex without neighbours is zero."""
    graph = adjacency(faces, vertex_count)
    degree = np.asarray(graph.sum(axis=1)).reshape(-1)
    averaging = scipy.sparse.diags(1.0 / np.maximum(degree, 1.0)) @ graph
    return (averaging - scipy.sparse.diags((degree > 0).astype(np.float64))).tocsr()
