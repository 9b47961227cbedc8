"""Room between sheets: cloth that comes near to itself is kept apart, so that a garment does not cross itself.

Under an arm, in a groin and behind a knee the network lays cloth close together and leaves it too little area. Steps
that give the cloth its area back crumple it through itself, at the size of its triangles. So it keeps a distance. Of
each vertex v the vertex nearest to it that is not of its sheet is found, within ``SPACING`` mean edges. With p the
nearest point to v of that one's triangles, n the unit vector from p to v and D = ``KEPT`` mean edges, ``KEPT_M`` at
most, v stays half of D before the middle between them where it is nearer,

    n . (x - (v + p) / 2) >= D / 2,

with contact's energy. Both sheets give way, and the middle is another one in every frame. Sheets that lie on each other
slide freely: p slides along, and n is the normal of the sheet and not the way to one of its vertices. The plane takes
the place of that of another part of the body where it is the nearer one.
Two vertices are of one sheet where the way through the air is nearly as long as that along the cloth: such cloth is
only pressed together. Nothing is remembered. Where cloth already crosses itself these planes have no side to tell. What
is left to do there is untangling (``untangle``), and to go back to the network's smooth surface (``residual``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import at, dot, mix, scaled, sub
from drape.kernels.lanes import row3
from drape.kernels.problem import rest_edges
from drape.live.clusters import POINT_ROWS, boxes_around, clusters, find_close, laid, less, squared
from drape.live.sheet import LANES
from drape.live.sweeps import APART_ROW, OTHER_PLANE, PLANES

NEAR_M = 0.02  # vertices nearer than that along the cloth, and those of one triangle, are one sheet
FOLDED = 0.6  # so are those whose way through the air is at least this share of that along the cloth
# Mean edges within which vertices are looked for. Lists of what is of one sheet reach as far as ROOM_M.
SPACING, ROOM_M = 0.95, 0.018
# Mean edges from vertices to triangles: with less cloth passes through itself, with more it is kept from where physics
# lays it, at 3 to 6 mm. Coarse cloth needs no more than KEPT_M.
KEPT, KEPT_M = 0.5, 0.0085
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
def keep_apart(x, sheet, neighbours, planes):
    """Writes the planes that keep ``x`` [m] (P, 3) apart to those of other parts in ``planes``, with a 1 in
    ``APART_ROW``."""
    k, dtype = sheet.constants, x.dtype.type
    reach = min(dtype(SPACING) / k.per_edge, dtype(ROOM_M))
    kept = min(dtype(KEPT) / k.per_edge, dtype(KEPT_M))
    points, room = np.empty((len(sheet.place), 3), x.dtype), np.empty(len(sheet.place), x.dtype)
    for v in range(len(points)):
        for i in range(3):
            points[v, i] = x[sheet.place[v], i]
    nearest = np.empty(len(points), np.int32)
    rooms(points, neighbours, reach, room, nearest)
    for v in range(len(points)):
        if nearest[v] < 0:
            continue
        here = at(points, v)
        way = _from_triangles(x, sheet, sheet.place[nearest[v]], here)
        far = np.sqrt(dot(way, way))
        if not k.zero < far < kept:
            continue
        place = PLANES * (sheet.place[v] // LANES) + sheet.place[v] % LANES
        normal = scaled(k.one / far, way)
        height = k.half * (far - kept) + k.gap  # contact begins a gap over the plane
        foot, other = _three(planes, place + OTHER_PLANE), _three(planes, place + OTHER_PLANE + 3 * LANES)
        if dot(other, other) > k.zero and dot(sub(here, foot), other) < height:
            continue
        planes[place + APART_ROW] = k.one
        for axis in range(3):
            planes[place + OTHER_PLANE + LANES * axis] = here[axis] - height * normal[axis]
            planes[place + OTHER_PLANE + LANES * (3 + axis)] = normal[axis]


@part
def _from_triangles(x, sheet, u, point):
    """The shortest way to ``point`` [m] from the triangles of the place ``u``. Sides without a length, as empty rows
    have, lead nowhere: nothing is shorter than NaN."""
    corner, lane = at(x, u), u % LANES
    off = sub(point, corner)
    found = off
    for row in range(sheet.fan_start[u // LANES], sheet.fan_start[u // LANES + 1]):
        a = sub(at(x, sheet.fan_other[2 * LANES * row + lane]), corner)
        b = sub(at(x, sheet.fan_other[2 * LANES * row + LANES + lane]), corner)
        aa, ab, bb, ap, bp = dot(a, a), dot(a, b), dot(b, b), dot(a, off), dot(b, off)
        s, t = bb * ap - ab * bp, aa * bp - ab * ap
        square = aa * bb - ab * ab
        if s >= 0 and t >= 0 and s + t <= square:
            found = _shorter(sub(off, mix(s / square, a, t / square, b)), found)
        else:
            found = _shorter(_from_side(off, a, sheet.constants), found)
            found = _shorter(_from_side(off, b, sheet.constants), found)
            found = _shorter(_from_side(sub(off, a), sub(b, a), sheet.constants), found)
    return found


@part
def _from_side(off, side, k):
    return sub(off, scaled(min(max(dot(off, side) / dot(side, side), k.zero), k.one), side))


@part
def _shorter(way, other):
    return way if dot(way, way) < dot(other, other) else other


@part
def _three(planes, place):
    return planes[place], planes[place + LANES], planes[place + 2 * LANES]


@kernel
def rooms(points, neighbours, reach, room, nearest):
    """Writes the distance [m] from each of ``points`` (V, 3) to the nearest one that is not of its sheet to ``room``
    (V,), and that one to ``nearest`` (V,); ``reach`` [m], ``ROOM_M`` at most, and -1 where none is within that.

    Every pair of clusters whose boxes come near each other is tested once. Hardly any has vertices that count.
    """
    dtype, count = points.dtype.type, len(neighbours.clusters)
    rows = laid(points, neighbours.clusters)
    boxes, groups = boxes_around(rows, POINT_ROWS, 0, 0)
    most = dtype(reach) * dtype(reach)
    square, bound = np.full(LANES * count, most), neighbours.bound.reshape(-1)
    which, other = np.full(LANES * count, -1, np.int32), neighbours.clusters.reshape(-1)
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
                _count(s, neighbours, a, b, table[b] >= 0, NearestSoFar(most, square, which))
        for entry in range(neighbours.other_start[a], neighbours.other_start[a + 1]):
            table[neighbours.other[entry]] = -1
    for e in range(LANES * count - 1, -1, -1):  # a lane that repeats a vertex comes before its own
        # The root of the square of the reach may be less than the reach.
        room[other[e]] = np.sqrt(square[e]) if square[e] < most else dtype(reach)
        nearest[other[e]] = other[which[e]] if square[e] < most else -1


class NearestSoFar(NamedTuple):
    """For every lane of the clusters the ``square`` [m^2] of the distance to the nearest one, ``most`` at first, and
    ``which`` lane that is."""

    most: np.floating
    square: np.ndarray
    which: np.ndarray


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


@kernel
def _count(s, neighbours, a, b, listed, found):
    """Lowers ``found`` to the distances of all pairs of clusters a and b that count; ``listed``: whether some of them
    may be of one sheet."""
    square, which = found.square, found.which
    for j in range(LANES):
        # A bound is no less than the square of its list: a point that is below no bound counts in no pair.
        if not s[LEAST + j] < found.most:
            continue
        for i in range(LANES):
            own, other, far = LANES * a + i, LANES * b + j, _far(row3(s, OWN, i), s, j)
            if far < max(square[own], square[other]) and not (
                listed and _is_near(neighbours, neighbours.clusters[a, i], neighbours.clusters[b, j], far)
            ):
                if far < square[own]:
                    square[own], which[own] = far, other
                if far < square[other]:
                    square[other], which[other] = far, own


@part
def _is_near(neighbours, v, u, far):
    hit = False
    for entry in range(neighbours.start[v], neighbours.start[v + 1]):
        hit |= neighbours.vertex[entry] == u and far >= neighbours.square[entry]
    return hit
