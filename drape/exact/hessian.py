"""The Hessian of a cloth's energy as 3 x 3 blocks in rows (CSR), compiled: exact, or a positive part of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.exact.surroundings import outside
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import (
    angle_gradient,
    at,
    cross,
    dot,
    fold,
    mix,
    scaled,
    stress,
    sub,
)
from drape.kernels.problem import stencil


class Pattern(NamedTuple):
    """The places of the blocks. Row v has the columns ``column[start[v] : start[v + 1]]``, sorted, its own at
    ``diagonal``. ``face`` (F, 3, 3) and ``hinge`` (H, 4, 4) name the block of every pair of corners.
    """

    start: np.ndarray
    column: np.ndarray
    diagonal: np.ndarray
    face: np.ndarray
    hinge: np.ndarray


def pattern(cloth: ClothMesh) -> Pattern:
    """The pattern of all vertices that share a triangle or a hinge."""
    graph = stencil(cloth)
    graph.sort_indices()
    graph.data = np.arange(graph.nnz, dtype=np.float64) + 1.0

    def blocks(corner: np.ndarray) -> np.ndarray:
        count = corner.shape[1]
        rows, columns = np.repeat(corner, count, axis=1), np.tile(corner, (1, count))
        found = np.asarray(graph[rows.reshape(-1), columns.reshape(-1)]).reshape(-1, count, count)
        return (found - 1.0).astype(np.int32)

    return Pattern(
        graph.indptr.astype(np.int32),
        graph.indices.astype(np.int32),
        (graph.diagonal() - 1.0).astype(np.int32),
        blocks(cloth.faces),
        blocks(cloth.hinge_index.reshape(4, -1).T),
    )


@kernel
def assemble(x, problem, around, pattern, exact, blocks):
    """Writes the Hessian [N/m] at ``x`` to ``blocks`` (N, 3, 3), the N blocks of the pattern.

    It is the exact one for ``exact`` 1. For 0 it is positive: only tensile stress counts, hinges are as stiff as
    unfolded ones, and the curvature of their angle is left out. Values between mix the two.
    """
    blocks[:] = problem.constants.zero
    _membrane_blocks(x, problem, pattern, exact, blocks)
    _hinge_blocks(x, problem, pattern, exact, blocks)
    _outside_blocks(x, problem, around, pattern.diagonal, blocks)


@part
def _outside_blocks(x, problem, around, place, blocks):
    for v in range(len(x)):
        h = outside(at(x, v), v, problem, around)[2]
        z = place[v]
        blocks[z, 0, 0] += h[0]
        blocks[z, 0, 1] += h[1]
        blocks[z, 0, 2] += h[2]
        blocks[z, 1, 0] += h[1]
        blocks[z, 1, 1] += h[3]
        blocks[z, 1, 2] += h[4]
        blocks[z, 2, 0] += h[2]
        blocks[z, 2, 1] += h[4]
        blocks[z, 2, 2] += h[5]


@part
def _membrane_blocks(x, problem, pattern, exact, blocks):
    k, t = problem.constants, problem.triangles
    slope = np.empty((3, 2), x.dtype)
    twice = k.one + k.one
    for f in range(len(t.corner)):
        origin = at(x, t.corner[f, 0])
        first, second = sub(at(x, t.corner[f, 1]), origin), sub(at(x, t.corner[f, 2]), origin)
        a, b, c, d = t.inverse[f, 0], t.inverse[f, 1], t.inverse[f, 2], t.inverse[f, 3]
        along, across = mix(a, first, b, second), mix(c, first, d, second)
        area = t.area[f]
        pp, tt, pt, _ = stress(along, across, area, k)
        pulled = tension(pp, tt, pt, k)
        pp, tt, pt = mix(exact, (pp, tt, pt), k.one - exact, pulled)
        slope[0, 0], slope[0, 1], slope[1, 0], slope[1, 1], slope[2, 0], slope[2, 1] = -a - b, -c - d, a, c, b, d
        for m in range(3):
            mp, mt = slope[m, 0], slope[m, 1]
            for n in range(3):
                np_, nt = slope[n, 0], slope[n, 1]
                z = pattern.face[f, m, n]
                by_along = area * (twice * k.warp * mp * np_ + k.shear * mt * nt)
                by_across = area * (twice * k.weft * mt * nt + k.shear * mp * np_)
                mixed = area * (twice * k.cross * mp * nt + k.shear * mt * np_)
                mixed_back = area * (twice * k.cross * mt * np_ + k.shear * mp * nt)
                add_to_block(blocks, z, along, mix(by_along, along, mixed, across))
                add_to_block(blocks, z, across, mix(mixed_back, along, by_across, across))
                pull = pp * mp * np_ + tt * mt * nt + pt * (mp * nt + mt * np_)
                blocks[z, 0, 0] += pull
                blocks[z, 1, 1] += pull
                blocks[z, 2, 2] += pull


@part
def _hinge_blocks(x, problem, pattern, exact, blocks):
    """k (cos d g g^T + sin d G) of every hinge, d the turn from rest, g and G the derivatives of the angle."""
    k, hinges = problem.constants, problem.hinges
    angle = np.empty((4, 4, 3, 3), x.dtype)  # second derivatives of the angle
    for h in range(len(hinges.corner)):
        corner, cosine, sine = hinges.corner[h], hinges.cosine[h], hinges.sine[h]
        points = (at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3]))
        folded, vectors, scalars = fold(points, cosine, sine, k)
        g = angle_gradient(vectors, k)
        _, _, scale, length, rise, _ = scalars
        e, a, b, n1, n2 = vectors
        curve = hinges.stiffness[h] * (k.one - exact * folded)
        force = -exact * hinges.stiffness[h] * scale * (length * rise * cosine + dot(n1, n2) * sine)
        angle[:] = k.zero
        _angle_hessian_side(angle, 2, e, a, n1, k.one, k)
        _angle_hessian_side(angle, 3, e, b, n2, -k.one, k)
        for m in range(4):
            for n in range(4):
                z = pattern.hinge[h, m, n]
                add_to_block(blocks, z, g[m], scaled(curve, g[n]))
                for i in range(3):
                    for j in range(3):
                        blocks[z, i, j] += force * angle[m, n, i, j]


@kernel
def _angle_hessian_side(angle, third, e, arm, n, sign, k):
    """Adds d(c_i n / q) = n / q dc_i + c_i (I - 2 n n^T / q) dn / q of one triangle to ``angle`` (4, 4, 3, 3)."""
    q = dot(n, n) + k.degenerate
    square = dot(e, e) + k.degenerate
    length = np.sqrt(square)
    u = scaled(k.one / length, e)
    along = dot(arm, u)
    height = scaled(k.one / length, sub(arm, scaled(along, u)))
    minus = scaled(-k.one, u)
    zero = (k.zero, k.zero, k.zero)
    normal = scaled(k.per_edge * k.per_edge / q, n)
    factor = k.per_edge * k.per_edge / q
    places = (0, 1, third)
    coefficient = (length - along, along, -length)
    slopes = (
        (height, sub(u, height), minus),
        (sub(minus, height), height, u),
        (u, minus, zero),
    )
    opposite = (scaled(sign, sub(arm, e)), scaled(-sign, arm), scaled(sign, e))
    for i in range(3):
        for j in range(3):
            o = opposite[j]
            turned = scaled((k.one + k.one) / q, cross(n, o))
            c = coefficient[i] * factor
            block = angle[places[i], places[j]]
            s = slopes[i][j]
            block[0, 0] += normal[0] * s[0] - c * n[0] * turned[0]
            block[0, 1] += normal[0] * s[1] - c * (n[0] * turned[1] + o[2])
            block[0, 2] += normal[0] * s[2] - c * (n[0] * turned[2] - o[1])
            block[1, 0] += normal[1] * s[0] - c * (n[1] * turned[0] - o[2])
            block[1, 1] += normal[1] * s[1] - c * n[1] * turned[1]
            block[1, 2] += normal[1] * s[2] - c * (n[1] * turned[2] + o[0])
            block[2, 0] += normal[2] * s[0] - c * (n[2] * turned[0] + o[1])
            block[2, 1] += normal[2] * s[1] - c * (n[2] * turned[1] - o[0])
            block[2, 2] += normal[2] * s[2] - c * n[2] * turned[2]


@kernel
def tension(pp, tt, pt, k):
    """The stress (pp, tt, pt) without what pushes: principal values below zero are zero."""
    mean = k.half * (pp + tt)
    radius = np.sqrt(k.half * k.half * (pp - tt) * (pp - tt) + pt * pt)
    if mean >= radius:
        return pp, tt, pt
    if mean <= -radius or radius == k.zero:
        return k.zero, k.zero, k.zero
    share, low = k.half * (mean + radius) / radius, mean - radius
    return share * (pp - low), share * (tt - low), share * pt


@kernel
def add_to_block(blocks, z, a, b):
    """Adds a b^T to block z."""
    for i in range(3):
        for j in range(3):
            blocks[z, i, j] += a[i] * b[j]
