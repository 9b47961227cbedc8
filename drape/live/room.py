"""Room between sheets: cloth keeps within what the network's drape leaves it, so that a garment feels itself.

Under an arm, in a groin, behind a knee the network lays cloth close together and hardly ever through itself. There is
more cloth than such a place has room for, and steps that give it its area crumple it through itself, at the size of its
triangles. A vertex is therefore held the closer to where the network has it, the nearer that drape comes to itself
there. With d the distance between a vertex of the network and the nearest other one that is not of its sheet,

    tight = (ROOM_M - d) / (ROOM_M - TIGHT_M), from 0 to 1,
    slack = SLACK_M + tight (LEAST_M - SLACK_M),
    stiffness = leash + HELD min(ROOM_M / d - 1, STIFFEST) contact's stiffness,

in the leash's own energy, so that where there is room nothing changes. Cloth that the network only presses together is
one sheet, for which way through the air and along the cloth differ little. What the network has apart stays apart, in
either direction and whatever presses: the room follows from the network alone and needs no memory and no sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import row3
from drape.live.clusters import POINT_ROWS, boxes_of, clusters, find_close, laid, less, squared
from drape.live.sheet import LANES
from drape.live.sweeps import HELD_ROW, PLANES, SLACK_ROW

NEAR_M = 0.02  # along the cloth: nearer vertices, and those of one triangle, are one sheet
FOLDED = 0.6  # of the way along the cloth: what is no nearer than that through the air is one sheet, pressed together
ROOM_M, TIGHT_M = 0.018, 0.012  # distance from which a vertex is held closer, and at which slack is the least
LEAST_M = 0.0002
HELD, STIFFEST = 1.5, 4.0  # of contact's stiffness; with more of either held cloth rattles
FREE = 255  # bounds are whole numbers, the last but one of them ROOM_M
BOUND_M2 = ROOM_M**2 / (FREE - 1)

# Rows of the scratch, of ``LANES`` numbers each: points of two clusters, the least square for each of the second one,
# and bounds of four lanes of the first one.
FOUR = 4
OWN, OTHER, LEAST, BOUND = 0, 3 * LANES, 6 * LANES, 7 * LANES
SCRATCH = (7 + FOUR) * LANES


class Near(NamedTuple):
    """Vertices that may be of one sheet with v, v itself too: ``vertex[start[v] : start[v + 1]]``, and the ``square``
    of the distance [m^2] from which each is: 0 of those near along the cloth.

    The same by ``clusters`` (C, ``LANES``): ``other[other_start[a] : other_start[a + 1]]`` (K,) are a and those after
    it that have a vertex listed with one of a. For every pair of lanes, a's first, ``bound`` (K, ``LANES``, ``LANES``)
    uint8 is no less than the square, in ``BOUND_M2``: 0 near along the cloth, and ``FREE``, more than any that counts,
    where the pair is not listed.
    """

    start: np.ndarray
    vertex: np.ndarray
    square: np.ndarray
    clusters: np.ndarray
    other_start: np.ndarray
    other: np.ndarray
    bound: np.ndarray


def near_along(cloth: ClothMesh) -> Near:
    """What is within ``NEAR_M`` over the edges of ``cloth``, as long as without stress, and all ends of an edge; and
    what is so far that ``FOLDED`` of it is within ``ROOM_M``."""
    a, b, c, d = cloth.inverse_shape
    shape = np.linalg.inv(np.stack([np.stack([a, c], axis=-1), np.stack([b, d], axis=-1)], axis=-2))  # columns: edges
    first, second = shape[..., 0], shape[..., 1]
    length = np.linalg.norm(np.concatenate([first, second - first, second]), axis=-1)
    ends = np.concatenate([cloth.faces[:, [0, 1]], cloth.faces[:, [1, 2]], cloth.faces[:, [0, 2]]])
    count = cloth.vertex_count
    _, once = np.unique(np.sort(ends, axis=1) @ (count, 1), return_index=True)
    pairs = np.concatenate([ends[once], ends[once][:, ::-1]])
    graph = scipy.sparse.coo_matrix((np.tile(length[once], 2), pairs.T), shape=(count, count)).tocsr()
    graph.sort_indices()
    start, vertex, along = _reached(graph.indptr, graph.indices, graph.data, ROOM_M / FOLDED)
    own = np.repeat(np.arange(count), np.diff(start))
    beside = (own == vertex) | (np.asarray(graph[own, vertex]).reshape(-1) > 0.0)
    square = np.where(beside | (along <= NEAR_M), 0.0, (FOLDED * along) ** 2).astype(np.float32)
    member = clusters(graph)
    return Near(start, vertex, square, member, *_bounds(own, vertex, square, member))


def _bounds(
    own: np.ndarray, vertex: np.ndarray, square: np.ndarray, member: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``other_start``, ``other`` and ``bound`` of ``Near``, of pairs of ``own`` and ``vertex`` (N,)."""
    cluster, lane = np.empty((2, member.max() + 1), np.int64)
    cluster[member], lane[member] = np.arange(len(member))[:, None], np.arange(LANES)
    later = cluster[own] <= cluster[vertex]
    own, vertex, square = own[later], vertex[later], square[later]
    listed, entry = np.unique(cluster[own] * len(member) + cluster[vertex], return_inverse=True)
    a, b = np.divmod(listed, len(member))
    bound = np.full((len(listed), LANES, LANES), FREE, np.uint8)
    # A step more than the next one, for what rounding may do.
    steps = np.minimum(np.floor(square / BOUND_M2) + 2.0, FREE)
    bound[entry, lane[own], lane[vertex]] = np.where(square > 0.0, steps, 0.0)
    # Lanes that repeat a vertex know what the one of its entry knows.
    bound = bound[np.arange(len(listed))[:, None, None], lane[member[a]][:, :, None], lane[member[b]][:, None]]
    other_start = np.searchsorted(a, np.arange(len(member) + 1)).astype(np.int32)
    return other_start, b.astype(np.int32), bound


@kernel
def _reached(start, other, length, most):
    """Where each vertex's list begins, the lists, and the ways there, over edges of ``length``; by relaxing."""
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
def hold_within(network, sheet, near, planes):
    """Tightens the leash in ``planes`` where the ``network`` [m] (P, 3) comes near to itself."""
    k = sheet.constants
    points = np.empty((len(sheet.place), 3), network.dtype)
    for v in range(len(points)):
        for i in range(3):
            points[v, i] = network[sheet.place[v], i]
    room = np.empty(len(points), network.dtype)
    rooms(points, near, room)
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
def rooms(points, near, room):
    """The distance [m] in ``room`` (V,) from each of ``points`` (V, 3) to the nearest one that is not of its sheet,
    ``ROOM_M`` where none is within that.

    Each pair of clusters that may come near each other is looked at once; hardly any has vertices that count.
    """
    dtype, count = points.dtype.type, len(near.clusters)
    rows = laid(points, near.clusters)
    boxes, groups = boxes_of(rows)
    most = dtype(ROOM_M) * dtype(ROOM_M)
    square, bound = np.full(LANES * count, most), near.bound.reshape(-1)
    table, s = np.full(count, -1, np.int32), np.empty(SCRATCH, points.dtype)
    hit, found = np.empty(2 * LANES, np.int32), np.empty(count, np.int32)
    for a in range(count):
        for entry in range(near.other_start[a], near.other_start[a + 1]):
            table[near.other[entry]] = entry
        for entry in range(POINT_ROWS):
            s[OWN + entry] = rows[POINT_ROWS * a + entry]
        for number in range(find_close(a, count, boxes, groups, most, hit, found)):
            b = found[number]
            for entry in range(POINT_ROWS):
                s[OTHER + entry] = rows[POINT_ROWS * b + entry]
            if _may_count(s, bound, table[b], most):
                _count(s, near, a, b, table[b] >= 0, square)
        for entry in range(near.other_start[a], near.other_start[a + 1]):
            table[near.other[entry]] = -1
    for e in range(LANES * count):
        # The root of the square of what nobody is within may be less than it.
        room[near.clusters[e // LANES, e % LANES]] = np.sqrt(square[e]) if square[e] < most else dtype(ROOM_M)


@part
def _far(own, s, lane):
    x, y, z = s[OTHER + lane], s[OTHER + LANES + lane], s[OTHER + 2 * LANES + lane]
    return squared(own[0] - x, own[1] - y, own[2] - z)


@part
def _may_count(s, bound, table, most):
    """Whether a pair is within the root of ``most`` [m^2] and its bound, if a ``table`` has them; the least square for
    each of the others in ``LEAST``.

    Four of the own ones at a time: their points are read before anything is written, so that loops take vectors.
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


@kernel
def _count(s, near, a, b, listed, square):
    """Takes all pairs of clusters a and b that count into ``square`` [m^2], where some may have ``listed`` ones."""
    for j in range(LANES):
        # Bounds are those of the lists or more: where nothing is below them nothing counts.
        if not s[LEAST + j] < s.dtype.type(ROOM_M) * s.dtype.type(ROOM_M):
            continue
        for i in range(LANES):
            own, other, far = LANES * a + i, LANES * b + j, _far(row3(s, OWN, i), s, j)
            if far < max(square[own], square[other]) and not (
                listed and _is_near(near, near.clusters[a, i], near.clusters[b, j], far)
            ):
                square[own], square[other] = min(square[own], far), min(square[other], far)


@kernel
def _is_near(near, v, u, far):
    hit = False
    for entry in range(near.start[v], near.start[v + 1]):
        hit |= near.vertex[entry] == u and far >= near.square[entry]
    return hit
