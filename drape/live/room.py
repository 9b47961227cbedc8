"""Room between sheets: cloth keeps within what the network's drape leaves it, so that a garment does not cross itself.

Under an arm, in a groin and behind a knee the network lays cloth close together, and hardly ever through itself. Such a
place has too little room for the cloth there. Steps that give the cloth its area crumple it through itself, at the size
of its triangles. A vertex is therefore held the closer to its place in the network's drape, the less room that drape
has there. With d the distance from a vertex of the network to the nearest other one that is not of its sheet,

    tight = (ROOM_M - d) / (ROOM_M - TIGHT_M), from 0 to 1,
    slack = k.slack + tight (LEAST_M - k.slack),
    stiffness = leash + HELD min(ROOM_M / d - 1, STIFFEST) contact's stiffness,

and the leash's energy has these. Where there is room nothing changes. Two vertices are of one sheet where the way
through the air is nearly as long as that along the cloth: the network only presses such cloth together. Sheets that the
network keeps apart stay apart, from whichever side they are pressed. The room follows from the network alone, and needs
neither a memory nor sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import row3
from drape.kernels.problem import rest_edges
from drape.live.clusters import POINT_ROWS, boxes_around, clusters, find_close, laid, less, squared
from drape.live.sheet import LANES
from drape.live.sweeps import HELD_ROW, PLANES, SLACK_ROW

NEAR_M = 0.02  # vertices nearer than that along the cloth, and those of one triangle, are one sheet
FOLDED = 0.6  # so are those whose way through the air is at least this share of that along the cloth
ROOM_M, TIGHT_M = 0.018, 0.012  # distance from which a vertex is held closer, and at which slack is the least
LEAST_M = 0.0002
HELD, STIFFEST = 1.5, 4.0  # times contact's stiffness; with more of either held cloth rattles
FREE = 255  # a bound that no pair within ROOM_M is below; FREE - 1 stands for ROOM_M
BOUND_M2 = ROOM_M**2 / (FREE - 1)

# Rows of the scratch: the points of two clusters, the least square for each point of the second one, and the bounds of
# four lanes of the first one.
FOUR = 4
OWN, OTHER, LEAST, BOUND = 0, 3 * LANES, 6 * LANES, 7 * LANES
SCRATCH = (7 + FOUR) * LANES


class SheetNeighbours(NamedTuple):
    """For every vertex the vertices that may be of one sheet with it.

    Those of v are ``vertex[start[v] : start[v + 1]]``, v itself too. Each is of its sheet from the ``square`` [m^2] of
    a distance through the air on: from 0 on where it is near along the cloth.

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
    """The lists of ``cloth``: all vertices so near over its edges at rest that ``FOLDED`` of the way is within
    ``ROOM_M``, and the ends of every edge."""
    first, second = rest_edges(cloth).transpose(1, 0, 2)
    length = np.linalg.norm(np.concatenate([first, second - first, second]), axis=-1)
    ends = np.concatenate([cloth.faces[:, [0, 1]], cloth.faces[:, [1, 2]], cloth.faces[:, [0, 2]]])
    count = cloth.vertex_count
    _, once = np.unique(np.sort(ends, axis=1) @ (count, 1), return_index=True)
    pairs = np.concatenate([ends[once], ends[once][:, ::-1]])
    graph = scipy.sparse.coo_matrix((np.tile(length[once], 2), pairs.T), shape=(count, count)).tocsr()
    graph.sort_indices()
    start, vertex, along = reached(graph.indptr, graph.indices, graph.data, ROOM_M / FOLDED)
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


@kernel
def reached(start, other, length, most):
    """Where each vertex's list begins, the lists of what is within ``most`` [m] over edges of ``length``, and the ways
    there; found by relaxing."""
    count = len(start) - 1
    way, listed = np.full(count, np.inf), np.empty(count, np.int32)
    begins, found, ways = np.zeros(count + 1, np.int32), np.empty(0, np.int32), np.empty(0)
    for v in range(count):
        way[v], listed[0], filled = 0.0, v, 1
        changed = True
        while changed:
            changed = False
            i = 0
            while i < filled:
                here = listed[i]
                i += 1
                for e in range(start[here], start[here + 1]):
                    u, far = other[e], way[here] + length[e]
                    if far < way[u] and (far <= most or here == v):
                        if way[u] == np.inf:
                            listed[filled] = u
                            filled += 1
                        way[u], changed = far, True
        total = begins[v] + filled
        if total > len(found):
            longer, farther = np.empty(2 * total, np.int32), np.empty(2 * total)
            longer[: begins[v]], farther[: begins[v]] = found[: begins[v]], ways[: begins[v]]
            found, ways = longer, farther
        for i in range(filled):
            found[begins[v] + i], ways[begins[v] + i] = listed[i], way[listed[i]]
            way[listed[i]] = np.inf
        begins[v + 1] = total
    return begins, found[: begins[count]].copy(), ways[: begins[count]].copy()


@kernel
def hold_within(network, sheet, neighbours, planes):
    """Tightens the leash in ``planes`` where the drape of the ``network`` [m] (P, 3) comes near to itself."""
    k = sheet.constants
    points = np.empty((len(sheet.place), 3), network.dtype)
    for v in range(len(points)):
        for i in range(3):
            points[v, i] = network[sheet.place[v], i]
    room = np.empty(len(points), network.dtype)
    rooms(points, neighbours, room)
    dtype = network.dtype.type
    for v in range(len(points)):
        tight = (dtype(ROOM_M) - room[v]) / dtype(ROOM_M - TIGHT_M)
        if not tight > k.zero:
            continue
        block, lane = sheet.place[v] // LANES, sheet.place[v] % LANES
        contact = sheet.own[4 * LANES * block + 2 * LANES + lane]
        stiff = min(dtype(ROOM_M) / max(room[v], dtype(LEAST_M)) - k.one, dtype(STIFFEST))
        planes[PLANES * block + HELD_ROW + lane] += dtype(HELD) * stiff * contact
        planes[PLANES * block + SLACK_ROW + lane] += min(tight, k.one) * (dtype(LEAST_M) - k.slack)


@kernel
def rooms(points, neighbours, room):
    """Writes the distance [m] from each of ``points`` (V, 3) to the nearest one that is not of its sheet to ``room``
    (V,), ``ROOM_M`` where none is within that.

    Every pair of clusters whose boxes come near each other is tested once. Hardly any has vertices that count.
    """
    dtype, count = points.dtype.type, len(neighbours.clusters)
    rows = laid(points, neighbours.clusters)
    boxes, groups = boxes_around(rows, POINT_ROWS, 0, 0)
    most = dtype(ROOM_M) * dtype(ROOM_M)
    square, bound = np.full(LANES * count, most), neighbours.bound.reshape(-1)
    table, s = np.full(count, -1, np.int32), np.empty(SCRATCH, points.dtype)
    found = np.empty(count, np.int32)
    for a in range(count):
        for entry in range(neighbours.other_start[a], neighbours.other_start[a + 1]):
            table[neighbours.other[entry]] = entry
        for entry in range(POINT_ROWS):
            s[OWN + entry] = rows[POINT_ROWS * a + entry]
        for number in range(find_close(a, count, boxes, groups, most, found)):
            b = found[number]
            for entry in range(POINT_ROWS):
                s[OTHER + entry] = rows[POINT_ROWS * b + entry]
            if _may_count(s, bound, table[b], most):
                _count(s, neighbours, a, b, table[b] >= 0, square)
        for entry in range(neighbours.other_start[a], neighbours.other_start[a + 1]):
            table[neighbours.other[entry]] = -1
    for e in range(LANES * count):
        # The root of the square of ROOM_M may be less than ROOM_M.
        room[neighbours.clusters[e // LANES, e % LANES]] = np.sqrt(square[e]) if square[e] < most else dtype(ROOM_M)


@part
def _far(own, s, lane):
    x, y, z = s[OTHER + lane], s[OTHER + LANES + lane], s[OTHER + 2 * LANES + lane]
    return squared(own[0] - x, own[1] - y, own[2] - z)


@part
def _may_count(s, bound, table, most):
    """Whether any two points of the clusters are within the root of ``most`` [m^2] and, if a ``table`` has bounds,
    below theirs; the least square for each point of the second cluster is left in ``LEAST``.

    Points of the first cluster are taken four at a time and read before anything is written: such loops are compiled to
    vector instructions.
    """
    for lane in range(LANES):
        s[LEAST + lane] = most
    if table < 0:
        for i in range(0, LANES, FOUR):
            a, b, c, d = row3(s, OWN, i), row3(s, OWN, i + 1), row3(s, OWN, i + 2), row3(s, OWN, i + 3)
            for lane in range(LANES):
                p, q, r, t = _far(a, s, lane), _far(b, s, lane), _far(c, s, lane), _far(d, s, lane)
                s[LEAST + lane] = less(less(less(p, q), less(r, t)), s[LEAST + lane])
    else:
        step = s.dtype.type(BOUND_M2)
        for i in range(0, LANES, FOUR):
            a, b, c, d = row3(s, OWN, i), row3(s, OWN, i + 1), row3(s, OWN, i + 2), row3(s, OWN, i + 3)
            for entry in range(FOUR * LANES):
                s[BOUND + entry] = step * bound[LANES * LANES * table + LANES * i + entry]
            for lane in range(LANES):
                p, q, r, t = _far(a, s, lane), _far(b, s, lane), _far(c, s, lane), _far(d, s, lane)
                p = p if p < s[BOUND + lane] else most
                q = q if q < s[BOUND + LANES + lane] else most
                r = r if r < s[BOUND + 2 * LANES + lane] else most
                t = t if t < s[BOUND + 3 * LANES + lane] else most
                s[LEAST + lane] = less(less(less(p, q), less(r, t)), s[LEAST + lane])
    some = 0
    for lane in range(LANES):
        some |= 1 if s[LEAST + lane] < most else 0
    return some > 0


@part
def _count(s, neighbours, a, b, listed, square):
    """Lowers ``square`` [m^2] to the distances of all pairs of clusters a and b that count; ``listed``: whether some of
    them may be of one sheet."""
    for j in range(LANES):
        # A bound is no less than the square of its list: a point that is below no bound counts in no pair.
        if not s[LEAST + j] < s.dtype.type(ROOM_M) * s.dtype.type(ROOM_M):
            continue
        for i in range(LANES):
            own, other, far = LANES * a + i, LANES * b + j, _far(row3(s, OWN, i), s, j)
            if far < max(square[own], square[other]) and not (
                listed and _is_near(neighbours, neighbours.clusters[a, i], neighbours.clusters[b, j], far)
            ):
                square[own], square[other] = min(square[own], far), min(square[other], far)


@part
def _is_near(neighbours, v, u, far):
    hit = False
    for entry in range(neighbours.start[v], neighbours.start[v + 1]):
        hit |= neighbours.vertex[entry] == u and far >= neighbours.square[entry]
    return hit
