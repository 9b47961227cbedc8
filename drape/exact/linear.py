"""Conjugate gradients for block systems, compiled: symmetric Gauss-Seidel and patch charts as preconditioner."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part


class Charts(NamedTuple):
    """A basis of patches that each carry one displacement: C ``patch`` (V, C) per vertex with ``weight`` (V, C),
    whose rows sum to one."""

    patch: np.ndarray
    weight: np.ndarray


def no_charts(vertex_count: int, dtype: type[np.floating]) -> Charts:
    """The empty basis."""
    return Charts(np.zeros((vertex_count, 0), np.int32), np.zeros((vertex_count, 0), dtype))


@kernel
def multiply(pattern, blocks, x, y):
    """y = H x (V, 3); returns x . y."""
    total = 0.0
    for v in range(len(x)):
        a = b = c = x[v, 0] - x[v, 0]
        for z in range(pattern.start[v], pattern.start[v + 1]):
            j = pattern.column[z]
            p, q, r = x[j, 0], x[j, 1], x[j, 2]
            a += blocks[z, 0, 0] * p + blocks[z, 0, 1] * q + blocks[z, 0, 2] * r
            b += blocks[z, 1, 0] * p + blocks[z, 1, 1] * q + blocks[z, 1, 2] * r
            c += blocks[z, 2, 0] * p + blocks[z, 2, 1] * q + blocks[z, 2, 2] * r
        y[v, 0], y[v, 1], y[v, 2] = a, b, c
        total += x[v, 0] * a + x[v, 1] * b + x[v, 2] * c
    return total


@kernel
def gauss_seidel(pattern, blocks, inverse, r, y):
    """y = (D + U)^-1 D (D + L)^-1 r, with ``inverse`` (V, 3, 3) of D: positive whatever L is."""
    count = len(r)
    for v in range(count):
        a, b, c = r[v, 0], r[v, 1], r[v, 2]
        for z in range(pattern.start[v], pattern.diagonal[v]):
            j = pattern.column[z]
            p, q, s = y[j, 0], y[j, 1], y[j, 2]
            a -= blocks[z, 0, 0] * p + blocks[z, 0, 1] * q + blocks[z, 0, 2] * s
            b -= blocks[z, 1, 0] * p + blocks[z, 1, 1] * q + blocks[z, 1, 2] * s
            c -= blocks[z, 2, 0] * p + blocks[z, 2, 1] * q + blocks[z, 2, 2] * s
        for i in range(3):
            y[v, i] = inverse[v, i, 0] * a + inverse[v, i, 1] * b + inverse[v, i, 2] * c
    for v in range(count - 1, -1, -1):
        a = b = c = r[v, 0] - r[v, 0]
        for z in range(pattern.diagonal[v] + 1, pattern.start[v + 1]):
            j = pattern.column[z]
            p, q, s = y[j, 0], y[j, 1], y[j, 2]
            a += blocks[z, 0, 0] * p + blocks[z, 0, 1] * q + blocks[z, 0, 2] * s
            b += blocks[z, 1, 0] * p + blocks[z, 1, 1] * q + blocks[z, 1, 2] * s
            c += blocks[z, 2, 0] * p + blocks[z, 2, 1] * q + blocks[z, 2, 2] * s
        for i in range(3):
            y[v, i] -= inverse[v, i, 0] * a + inverse[v, i, 1] * b + inverse[v, i, 2] * c


@kernel
def restrict(charts, g, out):
    """out (K, 3) = P^T g: what vertex forces ``g`` (V, 3) do to the patches."""
    out[:] = g[0, 0] - g[0, 0]
    for v in range(len(g)):
        for k in range(charts.patch.shape[1]):
            for i in range(3):
                out[charts.patch[v, k], i] += charts.weight[v, k] * g[v, i]


@kernel
def prolong(charts, d, y):
    """y += P d: patch displacements ``d`` (K, 3) at the vertices (V, 3)."""
    for v in range(len(y)):
        for k in range(charts.patch.shape[1]):
            for i in range(3):
                y[v, i] += charts.weight[v, k] * d[charts.patch[v, k], i]


@kernel
def galerkin(charts, pattern, blocks, out):
    """out (3K, 3K) = P^T H P."""
    out[:] = blocks[0, 0, 0] - blocks[0, 0, 0]
    patch, weight = charts.patch, charts.weight
    for v in range(len(patch)):
        for z in range(pattern.start[v], pattern.start[v + 1]):
            u = pattern.column[z]
            for a in range(patch.shape[1]):
                if weight[v, a] == 0.0:
                    continue
                for b in range(patch.shape[1]):
                    w = weight[v, a] * weight[u, b]
                    if w == 0.0:
                        continue
                    row, column = 3 * patch[v, a], 3 * patch[u, b]
                    for i in range(3):
                        for j in range(3):
                            out[row + i, column + j] += w * blocks[z, i, j]


@part
def precondition(system, r, y):
    """y = M^-1 r: Gauss-Seidel plus the solution on the charts; returns r . y."""
    gauss_seidel(system.pattern, system.blocks, system.inverse, r, y)
    if len(system.coarse) > 0:
        force = np.zeros((len(system.coarse) // 3, 3), r.dtype)
        restrict(system.charts, r, force)
        moved = np.dot(system.coarse, force.reshape(-1))
        prolong(system.charts, moved.reshape(-1, 3), y)
    total = 0.0
    for v in range(len(r)):
        total += r[v, 0] * y[v, 0] + r[v, 1] * y[v, 1] + r[v, 2] * y[v, 2]
    return total


class System(NamedTuple):
    """A block matrix and its preconditioner: the ``inverse`` (V, 3, 3) of positive diagonal blocks, and ``coarse``
    (3K, 3K), the inverse of the matrix on the charts, of size zero if there are none."""

    pattern: NamedTuple
    blocks: np.ndarray
    inverse: np.ndarray
    charts: Charts
    coarse: np.ndarray


@kernel
def _square(a):
    total = 0.0
    for v in range(len(a)):
        total += a[v, 0] * a[v, 0] + a[v, 1] * a[v, 1] + a[v, 2] * a[v, 2]
    return total


@kernel
def conjugate_gradients(system, force, share, limit, moved):
    """``moved`` (V, 3) with H moved near ``force``; returns the iterations, negative where H curved down.

    Ends when the norm of the residual is ``share`` of that of ``force``, after ``limit`` iterations, or on a direction
    of negative curvature, which is left out unless it is the first (Steihaug 1983).
    """
    moved[:] = force[0, 0] - force[0, 0]
    r, y, w = force.copy(), np.zeros_like(force), np.zeros_like(force)
    before = precondition(system, r, y)
    bound = share * share * _square(force)
    p = y.copy()
    for n in range(limit):
        curved = multiply(system.pattern, system.blocks, p, w)
        if not curved > 0.0:
            if n == 0:
                moved[:] = p
            return -n - 1
        step = before / curved
        for v in range(len(r)):
            for i in range(3):
                moved[v, i] += step * p[v, i]
                r[v, i] -= step * w[v, i]
        if _square(r) <= bound:
            return n + 1
        now = precondition(system, r, y)
        ratio = now / before
        before = now
        for v in range(len(r)):
            for i in range(3):
                p[v, i] = y[v, i] + ratio * p[v, i]
    return limit
