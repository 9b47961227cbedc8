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

from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, cross, dot, scaled, sub
from drape.kernels.lanes import LANES, put, row_at

ROUNDS, ENOUGH = 8, 1e-9  # of turning, fewer where the square of the last half turn was less [rad^2]
LEAST = 1e-3  # of the squared sides: a smaller sum of r . m says little of a rotation, and turns it less


@kernel
def move_vertices(vertices, still, swung, mesh, share, out):
    """Writes ``vertices`` [m] (V, 3), moved by a ``share`` of the nodes' way and turn from ``still`` to ``swung`` [m]
    (N, 3), to ``out``."""
    table = np.zeros(LANES * len(still), vertices.dtype)
    _write_turns(still, swung, mesh, share, table)
    sums = np.empty(LANES, vertices.dtype)
    for v in range(len(vertices)):
        first, last = mesh.weight_start[v], mesh.weight_start[v + 1]
        x = at(vertices, v)
        if first == last:
            out[v, 0], out[v, 1], out[v, 2] = x
            continue
        total = mesh.weight[first] * row_at(table, LANES * mesh.weight_node[first])
        for e in range(first + 1, last):
            total = total + mesh.weight[e] * row_at(table, LANES * mesh.weight_node[e])
        put(sums, 0, total)
        for axis in range(3):
            turn = (sums[3 + 3 * axis], sums[4 + 3 * axis], sums[5 + 3 * axis])
            out[v, axis] = x[axis] + sums[axis] + dot(turn, x)


@kernel
def _write_turns(still, swung, mesh, share, table):
    """Writes a ``share`` of c - X - (R - 1) X and of R - 1 of every node to ``table``, ``LANES`` numbers each."""
    one = still.dtype.type(1)
    sides, square = np.zeros((len(still), 3, 3), still.dtype), np.zeros(len(still), still.dtype)
    for i in range(len(still)):
        square[i] = _sum_sides(still, swung, mesh, i, sides[i])
    m = np.empty((3, 3), still.dtype)
    for i in range(len(still)):
        m[:] = sides[i]
        for e in range(mesh.start[i], mesh.start[i + 1]):
            m += sides[mesh.other[e, 0]]
            m += sides[mesh.other[e, 1]]
        r = rotation(m, still.dtype.type(LEAST) * square[i])
        x, way = at(still, i), sub(at(swung, i), at(still, i))
        for axis in range(3):
            row = (r[0][axis], r[1][axis], r[2][axis])
            table[LANES * i + axis] = share * (way[axis] + x[axis] - dot(row, x))
            for other in range(3):
                table[LANES * i + 3 + 3 * axis + other] = share * (row[other] - (one if axis == other else one - one))


@kernel
def _sum_sides(still, swung, mesh, i, m):
    """Writes the columns of M of node ``i`` to ``m`` (3, 3); the sum of the squares of its sides in still cloth."""
    zero = still.dtype.type(0)
    own, moved = at(still, i), at(swung, i)
    before, after, square = (zero, zero, zero), (zero, zero, zero), zero
    for e in range(mesh.start[i], mesh.start[i + 1]):
        a, b = sub(at(still, mesh.other[e, 0]), own), sub(at(swung, mesh.other[e, 0]), moved)
        p, q = sub(at(still, mesh.other[e, 1]), own), sub(at(swung, mesh.other[e, 1]), moved)
        for column in range(3):
            for row in range(3):
                m[column, row] += b[row] * a[column] + q[row] * p[column]
        before, after = add(before, cross(a, p)), add(after, cross(b, q))
        square += dot(a, a) + dot(p, p)
    length = np.sqrt(dot(before, before) * dot(after, after))
    if length > zero:
        for column in range(3):
            for row in range(3):
                m[column, row] += still.dtype.type(0.5) * square / length * after[row] * before[column]
    return square


@kernel
def rotation(m, least):
    """The columns of the rotation nearest to the matrix with the columns ``m`` (3, 3); of 1 where that is zero.

    Sums of r . m below ``least`` turn it less.
    """
    zero, one, half = m.dtype.type(0), m.dtype.type(1), m.dtype.type(0.5)
    r = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    a, b, c = at(m, 0), at(m, 1), at(m, 2)
    for _ in range(ROUNDS):
        turn = add(add(cross(r[0], a), cross(r[1], b)), cross(r[2], c))
        along = max(abs(dot(r[0], a) + dot(r[1], b) + dot(r[2], c)), least)
        if not along > zero:
            break
        q = scaled(half / along, turn)
        w = one / np.sqrt(one + dot(q, q))  # the unit quaternion (w, w q)
        r = _turned(w, q, r[0]), _turned(w, q, r[1]), _turned(w, q, r[2])
        if dot(q, q) < m.dtype.type(ENOUGH):
            break
    return r


@kernel
def _turned(w, q, a):
    """The vector ``a`` turned by the quaternion ``w`` (1, ``q``) of length 1."""
    b = scaled(w + w, cross(scaled(w, q), a))
    return add(a, add(b, cross(q, b)))
