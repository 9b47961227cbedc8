"""Colours of vertices: no two of one colour share an element, so that all of a colour may move at once."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.kernels.compiled import kernel


def colour_order(graph: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V,) int32 of ``graph`` colour by colour, and where each colour begins (C + 1,)."""
    colour = greedy_colours(graph.indptr, graph.indices)
    start = np.concatenate([[0], np.cumsum(np.bincount(colour))])
    return np.argsort(colour, kind="stable").astype(np.int32), start.astype(np.int32)


@kernel
def greedy_colours(start, neighbour):
    """For each vertex the least colour (V,) that no earlier neighbour has.

    The neighbours of v are ``neighbour[start[v] : start[v + 1]]``, which may have v itself.
    """
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
