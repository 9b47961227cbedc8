"""Which vertices are of one sheet: cloth that comes near to itself is kept apart, but not from cloth of its own sheet.

Two vertices are of one sheet where the way through the air is nearly as long as that along the cloth: such cloth is
only pressed together. How cloth keeps apart is in ``source/room.hpp`` of the engine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.cloth.problem import rest_edges
from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES
from drape.live.clusters import clusters

NEAR_M = 0.02  # vertices that are nearer along the cloth, and those of one triangle, are of one sheet
FOLDED = 0.6  # so are those whose distance through the air is at least this share of that along the cloth
ROOM_M = 0.018  # the distance through the air up to which cloth keeps apart from itself
ROOM = 200  # room at first, in entries a vertex: most lists are no longer
FREE = 255  # a bound that no pair within ROOM_M is below; FREE - 1 stands for ROOM_M
BOUND_M2 = ROOM_M**2 / (FREE - 1)


class SheetNeighbours(NamedTuple):
    """For each of V vertices the vertices near it along the cloth, from which it need not keep apart.

    Those of v are ``vertex[start[v] : start[v + 1]]``, v itself too. A pair need not keep apart while the square of
    its distance through the air is at least ``square`` [m^2]: less is a fold that closes. ``square`` is 0 where the two
    are so near along the cloth that they never keep apart.

    ``clusters`` (C, ``LANES``) are vertices side by side. ``other[other_start[a] : other_start[a + 1]]`` (K,) are
    cluster a and the clusters behind it that have a vertex listed with one of a. ``bound`` (K, ``LANES``, ``LANES``)
    uint8 has a number for every pair of lanes, a's lane first. It is an upper bound of the pair's ``square`` in units
    of ``BOUND_M2``: 0 where the pair is near along the cloth, ``FREE`` where it is not listed.
    """

    start: np.ndarray
    vertex: np.ndarray
    square: np.ndarray
    clusters: np.ndarray
    other_start: np.ndarray
    other: np.ndarray
    bound: np.ndarray


def sheet_neighbours(cloth: ClothMesh) -> SheetNeighbours:
    """Returns for each vertex of ``cloth`` the vertices near it along the edges at rest.

    A vertex is listed if ``FOLDED`` times its distance along the edges is at most ``ROOM_M``, and also if an edge joins
    the two.
    """
    first, second = rest_edges(cloth).transpose(1, 0, 2)
    length = np.linalg.norm(np.concatenate([first, second - first, second]), axis=-1)
    ends = np.concatenate([cloth.faces[:, [0, 1]], cloth.faces[:, [1, 2]], cloth.faces[:, [0, 2]]])
    count = cloth.vertex_count
    _, once = np.unique(np.sort(ends, axis=1) @ (count, 1), return_index=True)
    pairs = np.concatenate([ends[once], ends[once][:, ::-1]])
    graph = scipy.sparse.coo_matrix((np.tile(length[once], 2), pairs.T), shape=(count, count)).tocsr()
    graph.sort_indices()
    start, vertex, along = within_reach(graph.indptr, graph.indices, graph.data, ROOM_M / FOLDED)
    own = np.repeat(np.arange(count), np.diff(start))
    beside = (own == vertex) | (np.asarray(graph[own, vertex]).reshape(-1) > 0.0)
    square = np.where(beside | (along <= NEAR_M), 0.0, (FOLDED * along) ** 2).astype(np.float32)
    member = clusters(graph)
    return SheetNeighbours(start, vertex, square, member, *_bounds(own, vertex, square, member))


def _bounds(
    own: np.ndarray, vertex: np.ndarray, square: np.ndarray, member: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``other_start``, ``other`` and ``bound`` of ``SheetNeighbours``, of pairs of ``own`` and ``vertex`` (N,)."""
    cluster, lane = np.empty((2, member.max() + 1), np.int64)
    cluster[member], lane[member] = np.arange(len(member))[:, None], np.arange(LANES)
    later = cluster[own] <= cluster[vertex]
    own, vertex, square = own[later], vertex[later], square[later]
    listed, entry = np.unique(cluster[own] * len(member) + cluster[vertex], return_inverse=True)
    a, b = np.divmod(listed, len(member))
    bound = np.full((len(listed), LANES, LANES), FREE, np.uint8)
    # One step more than the next whole number, because distances are rounded.
    steps = np.minimum(np.floor(square / BOUND_M2) + 2.0, FREE)
    bound[entry, lane[own], lane[vertex]] = np.where(square > 0.0, steps, 0.0)
    # Lanes that repeat a vertex have the bounds of the lane in which it is an entry.
    bound = bound[np.arange(len(listed))[:, None, None], lane[member[a]][:, :, None], lane[member[b]][:, None]]
    other_start = np.searchsorted(a, np.arange(len(member) + 1)).astype(np.int32)
    return other_start, b.astype(np.int32), bound


def within_reach(
    start: np.ndarray, other: np.ndarray, length: np.ndarray, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns for each of V vertices the list of vertices within ``most`` [m] along edges: where each list begins (V +
    1,) int32, the vertices (n,) int32, and their distances [m] (n,). A vertex is in its own list.

    The ends of a vertex's own edges are listed however long these are. The edges of vertex v are ``start[v]`` to
    ``start[v + 1]`` of ``other`` and ``length`` [m].
    """
    graph = (
        *(np.ascontiguousarray(table, np.int32) for table in (start, other)),
        np.ascontiguousarray(length, np.float64),
    )
    count, room = len(start) - 1, ROOM * (len(start) - 1)
    while True:  # where there is too little room, the engine returns how much is needed
        begins, reached, ways = np.empty(count + 1, np.int32), np.empty(room, np.int32), np.empty(room)
        filled = call_with_scratch("reached", np.float64, *graph, count, float(most), begins, reached, ways, room)
        if filled <= room:
            return begins, reached[:filled], ways[:filled]
        room = filled
