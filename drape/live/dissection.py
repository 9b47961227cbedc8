"""The order in which a sparse matrix is factored, and runs of its columns that are taken together.

The order is nested dissection (George 1973, "Nested Dissection of a Regular Finite Element Mesh", SIAM J. Numer. Anal.
10(2)): the vertices halfway between the two ends of a garment cut it in two, each half is cut again, and the vertices
of a cut come after both halves. The factor has few more entries than one by least degree, and they lie in long runs of
columns with the same rows, which vector instructions take at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.engine.calls import call, call_with_scratch

LEAF = 16  # a part of so few vertices is not cut
WIDEST = 32  # the most columns of a run
Graph = tuple[np.ndarray, np.ndarray]


class Costs(NamedTuple):
    """What a run of columns (``runs``) costs, roughly, in cycles of a processor. It is the sum of ``run`` for the run,
    ``column`` for each of its columns, ``row`` for each sixteen entries of each column, and ``members`` for each
    sixteen rows."""

    row: float
    column: float
    members: float
    run: float


COSTS = Costs(4.0, 15.0, 30.0, 40.0)


def dissection_order(start: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """Returns the vertices (V,) int32 of a graph in the order of nested dissection. The neighbours of vertex v are
    ``neighbour[start[v] : start[v + 1]]``; v may be among them."""
    graph = _whole(start, neighbour)
    order = np.arange(len(start) - 1, dtype=np.int32)
    part, from_first, from_end = np.zeros_like(order), np.empty_like(order), np.empty_like(order)
    waiting, number = [(0, len(order))], 0
    while waiting:
        low, high = waiting.pop()
        nodes, half = order[low:high].copy(), (high - low) // 2
        if len(nodes) <= LEAF:
            continue
        number += 1
        part[nodes] = number
        line = _by_distance(graph, part, nodes, nodes[0], from_first)
        if len(line) < len(nodes):  # parts that are not connected need no cut
            order[low:high] = np.concatenate([line, nodes[from_first[nodes] < 0]])
            waiting += [(low, low + len(line)), (low + len(line), high)]
            continue
        end = _by_distance(graph, part, nodes, line[-1], from_first)[-1]
        _by_distance(graph, part, nodes, end, from_end)
        nodes = nodes[np.argsort(from_first[nodes] - from_end[nodes], kind="stable")]
        part[nodes[:half]] = -number
        near = _at_the_other(graph, part, nodes)
        if near[:half].sum() < near[half:].sum():
            near[half:] = False
        else:
            near[:half] = False
        first, second = nodes[:half][~near[:half]], nodes[half:][~near[half:]]
        order[low:high] = np.concatenate([first, second, nodes[near]])
        middle, last = low + len(first), low + len(first) + len(second)
        waiting += [(low, middle), (middle, last)] if len(first) and len(second) else []
    return order


def _by_distance(graph: Graph, part: np.ndarray, nodes: np.ndarray, first: int, distance: np.ndarray) -> np.ndarray:
    """Those of ``nodes``, which are one ``part``, that are connected with ``first``, the nearest first. Writes the
    ``distance`` of each node in edges, -1 where there is no way."""
    line = np.empty_like(nodes)
    return line[: call("by_distance", np.float64, *graph, part, nodes, len(nodes), int(first), distance, line)]


def _at_the_other(graph: Graph, part: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Which of ``nodes`` have a neighbour in the part with the other sign."""
    near = np.empty(len(nodes), bool)
    call("at_the_other", np.float64, *graph, part, nodes, len(nodes), near)
    return near


def runs(start: np.ndarray, row: np.ndarray, costs: Costs) -> np.ndarray:
    """Returns the first column of each of N runs, and last the number of columns, (N + 1,). A run is columns side by
    side that are taken as one dense panel (``whole``). All runs together cost the least by ``costs``.

    Column j of the lower triangle has the rows ``row[start[j] : start[j + 1]]`` below its diagonal.
    """
    begin, ends = np.empty(len(start), np.int32), [len(start) - 1]
    call_with_scratch("runs", np.float64, *_whole(start, row), len(start) - 1, WIDEST, *costs, begin)
    while ends[-1] > 0:
        ends.append(int(begin[ends[-1]]))
    return np.array(ends[::-1])


def _whole(start: np.ndarray, neighbour: np.ndarray) -> Graph:
    """A graph as the engine reads it."""
    return np.ascontiguousarray(start, np.int32), np.ascontiguousarray(neighbour, np.int32)
