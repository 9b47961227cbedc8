"""Colours: no two neighbours have the same one, and none is skipped."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.testing import assert_array_equal

from drape.geometry.colouring import colour_order, greedy_colours


def graph(*pairs: tuple[int, int]) -> scipy.sparse.csr_matrix:
    """A graph of ``pairs`` that has each vertex as its own neighbour too."""
    count = max(map(max, pairs)) + 1
    matrix = scipy.sparse.coo_matrix((np.ones(len(pairs)), tuple(zip(*pairs, strict=True))), shape=(count, count))
    return (matrix + matrix.T + scipy.sparse.identity(count)).tocsr()


def test_a_vertex_has_the_least_colour_that_its_earlier_neighbours_leave():
    made = graph((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (4, 3))  # two triangles and a tail
    assert_array_equal(greedy_colours(made.indptr, made.indices), [0, 1, 2, 1, 0])
    order, start = colour_order(made)
    assert_array_equal(order, [0, 4, 1, 3, 2])
    assert_array_equal(start, [0, 2, 4, 5])


def test_a_full_graph_needs_a_colour_for_each():
    every = graph(*((i, j) for i in range(20) for j in range(i)))
    assert_array_equal(greedy_colours(every.indptr, every.indices), np.arange(20))
