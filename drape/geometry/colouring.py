"""Colours of vertices: no two of one colour share an element, so that all of a colour may move at once."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.engine.calls import call_with_scratch


def colour_order(graph: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices (V,) int32 of the symmetric matrix ``graph`` (V, V) sorted by colour, and where each of C
    colours begins among them, (C + 1,) int32 with V at the end. Two vertices with an entry in ``graph`` have different
    colours."""
    colour = greedy_colours(graph.indptr, graph.indices)
    start = np.concatenate([[0], np.cumsum(np.bincount(colour))])
    return np.argsort(colour, kind="stable").astype(np.int32), start.astype(np.int32)


def greedy_colours(start: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """Returns for each vertex a colour (V,) int32 from 0: in the order of vertices, the least that no earlier neighbour
    has. The neighbours of v are ``neighbour[start[v] : start[v + 1]]``, which may have v itself."""
    graph = np.ascontiguousarray(start, np.int32), np.ascontiguousarray(neighbour, np.int32)
    colour = np.empty(len(start) - 1, np.int32)
    call_with_scratch("greedy_colours", np.float64, *graph, len(colour), colour)
    return colour
