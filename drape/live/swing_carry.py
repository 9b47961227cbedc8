"""How the nodes of a swing mesh carry the cloth between them: by their ways, and by how they have turned.

The folds of still cloth are finer than the mesh. Nodes that only moved them would flatten folds where cloth turns, and
it would lose area. So each node j turns what is around it (Sumner, Schmid and Pauly 2007, "Embedded Deformation for
Shape Manipulation", ACM TOG 26(3)). With X the still nodes, c the swung ones, R their turns and w the weights,

    v = x + sum of w (c - X + (R - 1) (x - X)).

R is the rotation nearest to the sum of M over the node and its neighbours,

    M = sum of b a^T + n N^T |a|^2 / 2,

a and b the sides of the node's coarse triangles in X and in c, N and n its normals there. It is found by turning about
the sum of r x m over the columns of R and M (Mueller, Bender, Chentanez and Macklin 2016, "A Robust Method to Extract
the Rotational Part of Deformations", MIG), which has a result for every M.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.affine import put_moved
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, cross, dot, mix, scaled, sub
from drape.kernels.lanes import (
    LANES,
    most,
    points_at,
    points_in,
    put,
    put3,
    put_points,
    root,
    row_at,
    where_above,
)
from drape.live.swing_mesh import SHARED
from drape.live.swing_rows import placed

ROUNDS, ENOUGH = 8, 1e-9  # of turning, fewer where the square of the last half turn was less [rad^2]
LEAST = 1e-3  # of the squared sides: a smaller sum of r . m says little of a rotation, and turns it less


@kernel
def move_vertices(vertices, still, swung, mesh, share, out):
    """Writes ``vertices`` [m] (V, 3), moved by a ``share`` of the nodes' way and turn from ``still`` to ``swung`` [m]
    (N, 3), to ``out``."""
    table = np.zeros(LANES * len(still), vertices.dtype)
    _write_turns(still, swung, mesh, share, table)
    node, weight = mesh.weight_node.reshape(-1), mesh.weight.reshape(-1)
    for v in range(len(vertices)):
        e = SHARED * v
        # Two sums, so that none waits for the one before.
        first, second = weight[e] * row_at(table, LANES * node[e]), weight[e + 1] * row_at(table, LANES * node[e + 1])
        for n in range(2, SHARED, 2):
            first = first + weight[e + n] * row_at(table, LANES * node[e + n])
            second = second + weight[e + n + 1] * row_at(table, LANES * node[e + n + 1])
        put_moved(out, vertices, v, first + second)


@kernel
def _write_turns(still, swung, mesh, share, table):
    """Writes a ``share`` of R - 1 and of c - X - (R - 1) X of every node to ``table``, ``LANES`` numbers each: four
    columns of four numbers, as ``put_moved`` takes them."""
    rows, x, c = mesh.rows, placed(still, mesh.rows), placed(swung, mesh.rows)
    first, second, third = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    square, s = np.empty(len(x), x.dtype), np.empty(12 * LANES, x.dtype)
    for block in range(len(rows.start) - 1):
        m, found = _sides(x, c, block, rows)
        put_points(first, LANES * block, m[0])
        put_points(second, LANES * block, m[1])
        put_points(third, LANES * block, m[2])
        put(square, LANES * block, found)
    for block in range(len(rows.start) - 1):
        place = LANES * block
        a, b, d = points_in(first, place), points_in(second, place), points_in(third, place)
        for row in range(2 * rows.start[block], 2 * rows.start[block + 1]):
            # An empty row has the place itself, and no area.
            real = where_above(row_at(rows.slope, 5 * LANES * (row // 2) + 4 * LANES), 0.0, 1.0, 0.0)
            a = add(a, scaled(real, points_at(first, rows.other, LANES * row)))
            b = add(b, scaled(real, points_at(second, rows.other, LANES * row)))
            d = add(d, scaled(real, points_at(third, rows.other, LANES * row)))
        own = points_in(x, place)
        e, f, g = rotation(a, b, d, LEAST * row_at(square, place), s)
        e, f, g = (e[0] - 1.0, e[1], e[2]), (f[0], f[1] - 1.0, f[2]), (g[0], g[1], g[2] - 1.0)
        turned = add(mix(own[0], e, own[1], f), scaled(own[2], g))
        put3(s, 0, scaled(share, e))
        put3(s, 3 * LANES, scaled(share, f))
        put3(s, 6 * LANES, scaled(share, g))
        put3(s, 9 * LANES, scaled(share, sub(sub(points_in(c, place), own), turned)))
        for lane in range(LANES):
            for column in range(4):
                for axis in range(3):
                    entry = LANES * rows.node[place + lane] + 4 * column + axis
                    table[entry] = s[LANES * (3 * column + axis) + lane]


@part
def _sides(x, c, block, rows):
    """The columns of M of the nodes of a ``block``, and the sums of the squares of their sides in still cloth."""
    own, moved = points_in(x, LANES * block), points_in(c, LANES * block)
    none = 0.0 * own[0]
    zero, square = (none, none, none), none
    m, before, after = (zero, zero, zero), zero, zero
    for row in range(rows.start[block], rows.start[block + 1]):
        a = sub(points_at(x, rows.other, 2 * LANES * row), own)
        b = sub(points_at(c, rows.other, 2 * LANES * row), moved)
        p = sub(points_at(x, rows.other, 2 * LANES * row + LANES), own)
        q = sub(points_at(c, rows.other, 2 * LANES * row + LANES), moved)
        m = add(m[0], mix(a[0], b, p[0], q)), add(m[1], mix(a[1], b, p[1], q)), add(m[2], mix(a[2], b, p[2], q))
        before, after = add(before, cross(a, p)), add(after, cross(b, q))
        square = square + dot(a, a) + dot(p, p)
    length = root(dot(before, before) * dot(after, after))
    after = scaled(where_above(length, 0.0, 0.5 * square / where_above(length, 0.0, length, 1.0), 0.0), after)
    m = add(m[0], scaled(before[0], after)), add(m[1], scaled(before[1], after)), add(m[2], scaled(before[2], after))
    return m, square


@part
def rotation(a, b, c, least, s):
    """The columns of the rotations nearest to matrices with the columns ``a``, ``b``, ``c``; of 1 where that is zero.

    Sums of r . m below ``least`` turn it less. ``s`` is scratch for a row.
    """
    one, zero = 0.0 * least + 1.0, 0.0 * least
    e, f, g = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(ROUNDS):
        turn = add(add(cross(e, a), cross(f, b)), cross(g, c))
        along = dot(e, a) + dot(f, b) + dot(g, c)
        along = most(most(along, -along), least)
        q = scaled(0.5 / where_above(along, 0.0, along, 1.0), turn)
        w = 1.0 / root(1.0 + dot(q, q))  # the unit quaternion (w, w q)
        e, f, g = _turned(w, q, e), _turned(w, q, f), _turned(w, q, g)
        put(s, 0, dot(q, q))
        turns = 0
        for lane in range(LANES):
            turns |= 1 if s[lane] > ENOUGH else 0
        if not turns:
            break
    return e, f, g


@part
def _turned(w, q, a):
    """The vector ``a`` turned by the quaternion ``w`` (1, ``q``) of length 1."""
    b = scaled(w + w, cross(scaled(w, q), a))
    return add(a, add(b, cross(q, b)))
