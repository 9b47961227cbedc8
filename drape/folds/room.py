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
from drape.folds.contact import cells_of
from drape.folds.sheet import LANES
from drape.folds.sweeps import HELD_ROW, PLANES, SLACK_ROW
from drape.solver.compiled import kernel
from drape.solver.elements import at, dot, sub

NEAR_M = 0.02  # along the cloth: nearer vertices, and those of one triangle, are one sheet
FOLDED = 0.6  # of the way along the cloth: what is no nearer than that through the air is one sheet, pressed together
ROOM_M, TIGHT_M = 0.018, 0.012  # distance from which a vertex is held closer, and at which slack is the least
LEAST_M = 0.0002
HELD, STIFFEST = 1.5, 4.0  # of contact's stiffness; with more of either held cloth rattles
PER_CELL = 1.0 / ROOM_M


class Near(NamedTuple):
    """Vertices that may be of one sheet with v, v itself too: ``vertex[start[v] : start[v + 1]]``, and the ``square``
    of the distance [m^2] from which each is: 0 of those near along the cloth."""

    start: np.ndarray
    vertex: np.ndarray
    square: np.ndarray


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
    return Near(start, vertex, np.where(beside | (along <= NEAR_M), 0.0, (FOLDED * along) ** 2).astype(np.float32))


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

    Each pair is looked at once, from the earlier cell of a grid, points in the order of their cells.
    """
    dtype = points.dtype.type
    room[:] = dtype(ROOM_M)
    start, member, low, size = cells_of(points, PER_CELL)
    if len(start) == 1:
        return
    ordered = np.empty((len(points), 3), points.dtype)
    for e in range(len(points)):
        for i in range(3):
            ordered[e, i] = points[member[e], i]
    most = dtype(ROOM_M) * dtype(ROOM_M)
    square = np.full(len(points), most)
    for e in range(len(points)):
        own = at(ordered, e)
        x = int((own[0] - low[0]) * PER_CELL)
        y = int((own[1] - low[1]) * PER_CELL)
        z = int((own[2] - low[2]) * PER_CELL)
        first, last = max(z - 1, 0), min(z + 2, size[2])
        for i in range(x, min(x + 2, size[0])):
            for j in range(y if i == x else max(y - 1, 0), min(y + 2, size[1])):
                row = (i * size[1] + j) * size[2]
                begin = e + 1 if i == x and j == y else start[row + first]
                for other in range(begin, start[row + last]):
                    way = sub(own, at(ordered, other))
                    far = dot(way, way)
                    if far < max(square[e], square[other]) and not _is_near(near, member[e], member[other], far):
                        square[e], square[other] = min(square[e], far), min(square[other], far)
    for e in range(len(points)):
        if square[e] < most:  # the root of the square of what nobody is within may be less than it
            room[member[e]] = np.sqrt(square[e])


@kernel
def _is_near(near, v, u, far):
    hit = False
    for entry in range(near.start[v], near.start[v + 1]):
        hit |= near.vertex[entry] == u and far >= near.square[entry]
    return hit
