"""What swing's kernels still call of folds', compiled. The engine has all of it: this file goes with those kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.geometry.colliders import AXES, CENTRE, HALF, RADIUS
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import at, dot, scaled, sub
from drape.kernels.lanes import LANES, number_at, points_at, points_in, put, put_points, samples_at, where_above
from drape.live.clock import SHORTEST_STEP_S
from drape.live.skin_walks import NEIGHBOURS

NODE_NEAR_M, WORN_M, THIN_M = 0.12, 0.04, 0.003
SCRATCH = 6 * LANES  # rows: which neighbour of each lane's sample is nearer than it, or what a plane has


class WalkLanes(NamedTuple):
    """``LANES`` walks at once: in each lane a place ``vertex`` and the ``sample`` (``LANES``,) that it is at, whose
    neighbours are ``near`` (8 ``LANES``,), a row each; ``scratch`` for rows of numbers."""

    vertex: np.ndarray
    sample: np.ndarray
    near: np.ndarray
    scratch: np.ndarray


@kernel
def walk_lanes(skin):
    return WalkLanes(
        np.empty(LANES, np.int32),
        np.empty(LANES, np.int32),
        np.empty(NEIGHBOURS * LANES, np.int32),
        np.empty(SCRATCH, skin.dtype),
    )


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    lanes = walk_lanes(skin)
    for block in range(len(network) // LANES):
        for lane in range(LANES):
            lanes.sample[lane] = touched.own[LANES * block + lane]
        walk(points_in(network, LANES * block), lanes, skin, graph.neighbour, len(skin))
        for lane in range(LANES):
            touched.own[LANES * block + lane] = lanes.sample[lane]


@part
def walk(points, lanes, skin, neighbour, steps):
    """``walked`` for a point in every lane, from ``lanes.sample``, moved in place."""
    own, near, nearer = lanes.sample, lanes.near, lanes.scratch
    square = squares(points, skin, own, 0)
    for _ in range(steps):
        look_around(own, neighbour, near)
        which = 0.0 * square - 1.0  # none
        for n in range(NEIGHBOURS):
            other = squares(points, skin, near, LANES * n)
            which = where_above(square, other, float(n), which)
            square = where_above(square, other, other, square)
        put(nearer, 0, which)
        moved = False
        for lane in range(LANES):
            if nearer[lane] >= 0.0:
                own[lane], moved = number_at(near, LANES * int(nearer[lane]) + lane), True
        if not moved:
            break


@part
def look_around(own, neighbour, near):
    """Writes the neighbours of the samples ``own`` (``LANES``,) to ``near``, a row each."""
    for lane in range(LANES):
        for n in range(NEIGHBOURS):
            near[LANES * n + lane] = number_at(neighbour, NEIGHBOURS * own[lane] + n)


@part
def squares(points, skin, index, start):
    """Squares of the distances from ``points`` to the samples of a row."""
    x, y, z, _ = samples_at(skin, index, start)
    way = sub((x, y, z), points)
    return dot(way, way)


@kernel
def step_between(before_s, after_s):
    """The step [s] from one frame to the next one."""
    return max(after_s - before_s, SHORTEST_STEP_S)


@kernel
def placed(vertices, vertex):
    """The ``vertices`` [m] (V, 3) at their places (P, 3); ``vertex`` (P,) is the one at each."""
    places, whole = np.empty((len(vertex), 3), vertices.dtype), len(vertex) // LANES * LANES
    for p in range(0, whole, LANES):
        put_points(places, p, points_at(vertices, vertex, p))
    for p in range(whole, len(vertex)):
        for axis in range(3):
            places[p, axis] = vertices[vertex[p], axis]
    return places


@kernel
def outside(colliders, m, point):
    """The distance [m] of ``point`` to collider ``m``, negative inside, and the unit normal that leads out of it."""
    first, second, third = _axis(colliders, m, 0), _axis(colliders, m, 1), _axis(colliders, m, 2)
    off = sub(point, _centre(colliders, m))
    a, b, c = dot(first, off), dot(second, off), dot(third, off)
    p, q, r = abs(a) - colliders[m, HALF], abs(b) - colliders[m, HALF + 1], abs(c) - colliders[m, HALF + 2]
    u, v, w = max(p, 0.0), max(q, 0.0), max(r, 0.0)
    length = np.sqrt(u * u + v * v + w * w)
    if length > 0.0:
        u, v, w, distance = u / length, v / length, w / length, length
    else:
        distance = max(p, q, r)
        u, v, w = 0.0, 0.0, 0.0
        if p == distance:
            u = 1.0
        elif q == distance:
            v = 1.0
        else:
            w = 1.0
    u, v, w = u if a >= 0.0 else -u, v if b >= 0.0 else -v, w if c >= 0.0 else -w
    normal = (
        u * first[0] + v * second[0] + w * third[0],
        u * first[1] + v * second[1] + w * third[1],
        u * first[2] + v * second[2] + w * third[2],
    )
    return distance - colliders[m, RADIUS], normal


@kernel
def entered(colliders, m, start, end):
    """The distance [m] of ``end`` to the face of box ``m`` by which the way from ``start`` enters it, negative, and the
    face's normal. Infinite for what is round, and where the way does not enter or leaves by a face beside that one."""
    if colliders[m, RADIUS] > 0.0:
        return np.inf, (0.0, 0.0, 0.0)
    enters, leaves, face, out, sign = -np.inf, np.inf, -1, -1, 0.0
    off, way = sub(start, _centre(colliders, m)), sub(end, start)
    for n in range(3):
        axis = _axis(colliders, m, n)
        a, d, h = dot(axis, off), dot(axis, way), colliders[m, HALF + n]
        if d == 0.0:
            if abs(a) > h:
                return np.inf, axis
            continue
        near, far = (-h - a) / d, (h - a) / d
        if near > far:
            near, far = far, near
        if near > enters:
            enters, face, sign = near, n, -1.0 if d > 0.0 else 1.0
        if far < leaves:
            leaves, out = far, n
    if not 0.0 <= enters <= min(leaves, 1.0) or (leaves < 1.0 and out != face):
        return np.inf, (0.0, 0.0, 0.0)
    axis = scaled(sign, _axis(colliders, m, face))
    return dot(axis, sub(end, _centre(colliders, m))) - colliders[m, HALF + face], axis


@kernel
def write_planes(c, came, first, colliders, skin, touched, planes):
    """Writes the planes that hold each node ``c`` [m] (N, 3) out of the two colliders in which it is deepest to
    ``planes`` (N, 2, 4): a normal n, zero where there is none, and n . x of its points.

    ``came`` [m] (N, 3) is where the nodes were, and ``first`` says that they were nowhere; ``touched`` (N,) are their
    samples of the ``skin`` (S, 8). Returns how many nodes are behind a plane.
    """
    inside = 0
    for i in range(len(c)):
        planes[i] = 0
        least, second, below = NODE_NEAR_M, NODE_NEAR_M, at(skin, touched[i])
        off = sub(at(c, i), below)
        worn = dot(off, off) < WORN_M * WORN_M
        for m in range(len(colliders)):
            before, normal = outside(colliders, m, at(came, i))
            distance = before - dot(normal, sub(at(came, i), at(c, i)))
            if first or before < 0.0:
                distance, normal = entered(colliders, m, below, at(c, i))
                near, way_out = outside(colliders, m, at(c, i))
                if near < distance:
                    distance, normal = near, way_out
            sunk = max(THIN_M - outside(colliders, m, below)[0], 0.0) if worn else 0.0
            distance += sunk
            if distance >= second:
                continue
            row, second = 1, distance
            if distance < least:
                planes[i, 1] = planes[i, 0]
                row, least, second = 0, distance, least
            planes[i, row, 0], planes[i, row, 1], planes[i, row, 2] = normal
            planes[i, row, 3] = dot(normal, at(c, i)) - distance
        inside += least < 0.0
    return inside


@kernel
def _centre(colliders, m):
    return colliders[m, CENTRE], colliders[m, CENTRE + 1], colliders[m, CENTRE + 2]


@kernel
def _axis(colliders, m, n):
    return colliders[m, AXES + 3 * n], colliders[m, AXES + 3 * n + 1], colliders[m, AXES + 3 * n + 2]
