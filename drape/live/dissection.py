"""The order in which a sparse matrix is factored, and runs of its columns that are taken together.

The order is nested dissection (George 1973, "Nested Dissection of a Regular Finite Element Mesh", SIAM J. Numer. Anal.
10(2)): the vertices halfway between the two ends of a garment cut it in two, each half is cut again, and the vertices
of a cut come after both halves. The factor has few more entries than one by least degree, and they lie in long runs of
columns with the same rows, which vector instructions take at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.lanes import LANES

LEAF = 16  # a part of so few vertices is not cut
WIDEST = 32  # the most columns of a run


class Costs(NamedTuple):
    """About how many cycles a run of columns takes: for each ``row`` of ``LANES`` entries of a column, for each
    ``column``, for each row of ``members``, and for the ``run`` itself."""

    row: float
    column: float
    members: float
    run: float


COSTS = Costs(4.0, 15.0, 30.0, 40.0)


def dissected(start: np.ndarray, neighbour: np.ndarray) -> np.ndarray:
    """The vertices (V,) of a graph in the order of nested dissection; neighbours of v from ``start[v]`` on, itself
    allowed."""
    order = np.arange(len(start) - 1)
    part, one, two = np.zeros_like(order), np.empty_like(order), np.empty_like(order)
    waiting, number = [(0, len(order))], 0
    while waiting:
        low, high = waiting.pop()
        nodes, half = order[low:high].copy(), (high - low) // 2
        if len(nodes) <= LEAF:
            continue
        number += 1
        part[nodes] = number
        met = _by_distance(start, neighbour, part, nodes, nodes[0], one)
        if len(met) < len(nodes):  # parts that are not connected need no cut
            order[low:high] = np.concatenate([met, nodes[one[nodes] < 0]])
            waiting += [(low, low + len(met)), (low + len(met), high)]
            continue
        end = _by_distance(start, neighbour, part, nodes, met[-1], one)[-1]
        _by_distance(start, neighbour, part, nodes, end, two)
        nodes = nodes[np.argsort(one[nodes] - two[nodes], kind="stable")]
        part[nodes[:half]] = -number
        near = _at_the_other(start, neighbour, part, nodes)
        if near[:half].sum() < near[half:].sum():
            near[half:] = False
        else:
            near[:half] = False
        first, second = nodes[:half][~near[:half]], nodes[half:][~near[half:]]
        order[low:high] = np.concatenate([first, second, nodes[near]])
        middle, last = low + len(first), low + len(first) + len(second)
        waiting += [(low, middle), (middle, last)] if len(first) and len(second) else []
    return order


@kernel
def _by_distance(start, neighbour, part, nodes, first, distance):
    """Those of ``nodes``, which are one ``part``, that are connected with ``first``, the nearest first. Writes the
    ``distance`` of each node in edges, -1 where there is no way."""
    line = np.empty_like(nodes)
    for v in nodes:
        distance[v] = -1
    line[0], distance[first] = first, 0
    count, here = 1, 0
    while here < count:
        v = line[here]
        here += 1
        for z in range(start[v], start[v + 1]):
            w = neighbour[z]
            if part[w] == part[first] and distance[w] < 0:
                distance[w], line[count] = distance[v] + 1, w
                count += 1
    return line[:count]


@kernel
def _at_the_other(start, neighbour, part, nodes):
    """Which of ``nodes`` have a neighbour in the part with the other sign."""
    near = np.zeros(len(nodes), np.bool_)
    for i in range(len(nodes)):
        for z in range(start[nodes[i]], start[nodes[i] + 1]):
            if part[neighbour[z]] == -part[nodes[i]]:
                near[i] = True
    return near


@kernel
def runs(start, row, costs):
    """The beginnings (N + 1,) of runs of columns that together take the least time by ``costs``.

    Column j of the lower triangle has the rows ``row[start[j] : start[j + 1]]`` below its diagonal.
    """
    count = len(start) - 1
    least, begin, met = np.full(count + 1, np.inf), np.zeros(count + 1, np.int64), np.full(count, -1, np.int64)
    least[0] = 0.0
    for first in range(count):
        below = 0
        for j in range(first, min(first + WIDEST, count)):
            below -= met[j] == first  # it was below the run's columns, and is one now
            for z in range(start[j], start[j + 1]):
                if met[row[z]] != first:
                    met[row[z]] = first
                    below += 1
            width = j + 1 - first
            rows = (width + below + LANES - 1) // LANES
            cost = least[first] + costs.run + width * costs.column + rows * (costs.members + width * costs.row)
            if cost < least[j + 1]:
                least[j + 1], begin[j + 1] = cost, first
    found = [count]
    while found[-1] > 0:
        found.append(begin[found[-1]])
    return np.array(found[::-1])
