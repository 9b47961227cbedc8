"""Colours of vertices: no two of one colour share an element, so a sweep in their order is one of parallel steps."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.kernels.compiled import kernel


def colour_order(graph: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V,) of ``graph`` colour by colour, int32, and where each colour begins (C + 1,)."""
    colour = greedy_colours(graph.indptr, graph.indices)
    start = np.concatenate([[0], np.cumsum(np.bincount(colour))])
    return np.argsort(colour, kind="stable").astype(np.int32), start.astype(np.int32)


@kernel
def greedy_colours(start, neighbour):
    """The least colour (V,) that no earlier neighbour has; neighbours of v from ``start[v]`` on, itself allowed."""
    count = len(start) - 1
    colour = np.full(count, -1, np.int64)
    taken = np.full(count + 1, -1, np.int64)
    for v in range(count):
        for k in range(start[v], start[v + 1]):
            if colour[neighbour[k]] >= 0:
                taken[colour[neighbour[k]]] = v
        least = 0
        while taken[least] == v:
            least += 1
        colour[v] = least
    return colour
