"""Cloth against the colliders of a scene (``drape.geometry.colliders``), compiled.

*Nodes of swing.* A collider is convex, and the tangent plane at its point nearest to where a node was in the frame
before has it on one side. The node stays on the other side, so that it passes through nothing however fast it is. A
node without a past that is in a box, or behind it, leaves it by the face through which the way from the skin below
enters it: what hangs from a thigh lies on the seat.

*Folds.* A vertex near a collider has its tangent plane in the place of the plane of another part of the body, where the
collider is nearer. At the end of a frame what is still inside goes all of the way out.

Skin that is itself in a collider keeps the cloth on it there, ``THIN_M`` deeper than it is: bodies sit into the seats
that are beneath them, and skin must not show.
"""

from __future__ import annotations

import numpy as np

from drape.geometry.colliders import AXES, CENTRE, HALF, RADIUS
from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, scaled, sub
from drape.live.sheet import LANES
from drape.live.sweeps import OTHER_PLANE, PLANES

NEAR_M, NODE_NEAR_M = 0.01, 0.12  # a collider within this distance has a plane: sweeps move vertices and nodes less
WORN_M = 0.04  # cloth nearer to skin than that is on it
THIN_M = 0.003  # the room that cloth takes between skin and collider


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
def put_planes(x, colliders, planes):
    """Writes the tangent planes of ``colliders`` near ``x`` [m] (P, 3) to those of other parts in ``planes``."""
    near = _near(x, colliders)
    for m in range(len(colliders)):
        if not near[m]:
            continue
        for v in range(len(x)):
            place = PLANES * (v // LANES) + v % LANES
            distance, normal = outside(colliders, m, at(x, v))
            if distance >= NEAR_M:
                continue
            distance += _sunk(x, v, colliders, m, planes)
            n, p = _three(planes, place + OTHER_PLANE + 3 * LANES), _three(planes, place + OTHER_PLANE)
            if dot(n, n) > 0.0 and dot(n, sub(at(x, v), p)) < distance:
                continue
            for axis in range(3):
                planes[place + OTHER_PLANE + LANES * axis] = x[v, axis] - distance * normal[axis]
                planes[place + OTHER_PLANE + LANES * (3 + axis)] = normal[axis]


@kernel
def leave(x, colliders, planes, clearance):
    """Moves ``x`` [m] (P, 3) in place out of ``colliders``, up to the ``clearance`` [m]; wherever the skin is where
    there are no ``planes``."""
    near = _near(x, colliders)
    for m in range(len(colliders)):
        if not near[m]:
            continue
        for v in range(len(x)):
            distance, normal = outside(colliders, m, at(x, v))
            if distance < clearance:
                way = max(clearance - distance - _sunk(x, v, colliders, m, planes), 0.0)
                for axis in range(3):
                    x[v, axis] += way * normal[axis]


@kernel
def _sunk(x, v, colliders, m, planes):
    """How deep [m] in collider ``m`` vertex ``v`` may be, for the skin that it is on."""
    if not len(planes):
        return 0.0
    foot = _three(planes, PLANES * (v // LANES) + v % LANES)
    off = sub(at(x, v), foot)
    return max(THIN_M - outside(colliders, m, foot)[0], 0.0) if dot(off, off) < WORN_M * WORN_M else 0.0


@kernel
def _near(x, colliders):
    """Whether the box around ``x`` comes near that around each of ``colliders``, (M,)."""
    near = np.ones(len(colliders), np.bool_)
    for axis in range(3 if len(colliders) else 0):
        low, high = np.inf, -np.inf
        for v in range(len(x)):
            low, high = min(low, x[v, axis]), max(high, x[v, axis])
        for m in range(len(colliders)):
            half = colliders[m, RADIUS] + NEAR_M
            for n in range(3):
                half += abs(colliders[m, AXES + 3 * n + axis]) * colliders[m, HALF + n]
            near[m] &= not (low > colliders[m, axis] + half or high < colliders[m, axis] - half)
    return near


@kernel
def _centre(colliders, m):
    return colliders[m, CENTRE], colliders[m, CENTRE + 1], colliders[m, CENTRE + 2]


@kernel
def _axis(colliders, m, n):
    return colliders[m, AXES + 3 * n], colliders[m, AXES + 3 * n + 1], colliders[m, AXES + 3 * n + 2]


@kernel
def _three(planes, place):
    return planes[place], planes[place + LANES], planes[place + 2 * LANES]
