"""Clusters of ``LANES`` vertices or triangles side by side on the cloth.

They follow from the cloth alone and are the same in every frame. Distances along the cloth are therefore stored by
pairs of clusters, and a frame compares two clusters at once (``source/clusters.hpp`` of the engine).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from drape.engine.library import LANES

LANDMARKS = 6  # distances along the cloth to so many vertices say where on it a vertex is


def clusters(graph: scipy.sparse.csr_array) -> np.ndarray:
    """Returns the vertices (C, ``LANES``) int32 of clusters that lie together on a cloth; ``graph`` (V, V) has the
    lengths [m] of its edges. Each vertex is in one cluster; one that is not full repeats a vertex.

    The cloth is halved again and again by distances along it to landmarks.
    """
    count = len(graph.indptr) - 1
    ways, nearest, landmark = np.empty((count, LANDMARKS)), np.full(count, np.inf), 0
    for number in range(LANDMARKS):
        way = dijkstra(graph, indices=landmark)
        nearest = np.minimum(nearest, way)
        landmark = int(np.argmax(nearest))  # the farthest vertex; infinite where no landmark is connected with it
        ways[:, number] = np.where(np.isfinite(way), way, 1.0 + 2.0 * way[np.isfinite(way)].max())
    groups = _halved(np.arange(count), ways)
    begins = np.concatenate([[0], np.cumsum([len(group) for group in groups])])
    entry = np.minimum(begins[:-1, None] + np.arange(LANES), begins[1:, None] - 1)
    return np.concatenate(groups)[entry].astype(np.int32)


def _halved(vertices: np.ndarray, ways: np.ndarray) -> list[np.ndarray]:
    if len(vertices) <= LANES:
        return [vertices]
    there = ways[vertices]
    order = vertices[np.argsort(there[:, np.argmax(np.ptp(there, axis=0))], kind="stable")]
    half = LANES * (-(-len(vertices) // LANES) // 2)
    return _halved(order[:half], ways) + _halved(order[half:], ways)
