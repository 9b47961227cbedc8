"""A step of the whole cloth: what is too long or too short anywhere is spread over all of it at once.

    K q = -dE/dx,   x += q

K is the stiffness of the cloth at rest, with the shear added to warp and weft and alike in all three axes, so that it
has one number for each pair of vertices:

    K = sum of A ((k_warp + k_shear) p p^T + (k_weft + k_shear) t t^T) + springs,

p and t the slopes of a triangle's corners along warp and weft. K never changes: its factor L D L^T is made once (Liu,
Bouaziz and Kavan 2017, "Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials", ACM TOG 36(3)).

Columns J of L whose rows R below are nearly the same make a panel, a dense matrix that stands for all of them,

    P = [ L_JJ^-1 - 1 ; -L_RJ L_JJ^-1 ],   y_JR += P y_J  on the way down,   y_J += P^T y_JR  on the way up.

Its entries need no indices, and several of its rows are multiplied at once (partitioned inverse: Alvarado and Schreiber
1993, "Optimal Parallel Solution of Sparse Triangular Systems", SIAM J. Sci. Comput. 14(2)).

Sweeps from vertex to vertex let each give way over the shortest distance. Cloth that is pushed together then crumples
at the size of its triangles. A step of the whole lets buckles of all lengths grow equally fast, and bending decides.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from drape.cloth.energies import ClothMesh, contact_n_per_m
from drape.cloth.material import Material
from drape.kernels.compiled import kernel
from drape.kernels.elements import add_to, scaled
from drape.kernels.lanes import LANES, points_at, put3, row_at, rows3_at, sums
from drape.live.dissection import COSTS, dissected, runs
from drape.live.sheet import Sheet

CLAMP_M = 0.02  # a step moves no vertex farther
# The spring on every vertex, as a share of contact's stiffness: K does not know which contacts are closed. With 0.07
# cloth in contact rattles; with more than this folds come more slowly.
SPRING = 0.2


class StiffnessFactor(NamedTuple):
    """The factor of K as N panels, and ``inverse`` (V,), which is 1 / D; rows in the order of the factor.

    Panel p has the columns from ``column[p]`` to ``column[p + 1]`` (N + 1,). Its ``size`` (N,) members are its columns
    and the rows below; they are in ``member`` from ``start[p]`` (N + 1,) on, followed by its first column up to a
    multiple of ``LANES``. Its numbers are in ``value`` from ``entry[p]`` (N,) on, column after column. ``place`` (V,)
    is where each row is in a sheet.
    """

    place: np.ndarray
    column: np.ndarray
    size: np.ndarray
    start: np.ndarray
    member: np.ndarray
    entry: np.ndarray
    value: np.ndarray
    inverse: np.ndarray


def stiffness(cloth: ClothMesh, material: Material, band_n_per_m: np.ndarray) -> Any:
    """K [N/m] (V, V), a sparse matrix, of ``cloth`` whose vertices are held by ``band_n_per_m`` (V,)."""
    a, b, c, d = cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d]), np.stack([a, c]), np.stack([b, d])])  # (corner, axis, F)
    warp, weft, _, shear = (float(value) for value in material.membrane)
    entries = np.einsum("iaf,a,jaf,f->ijf", slopes, np.array([warp, weft]) + shear, slopes, cloth.face_area)
    shape, count = (3, 3, len(cloth.faces)), cloth.vertex_count
    rows, columns = (np.broadcast_to(i, shape).reshape(-1) for i in (cloth.faces.T[:, None], cloth.faces.T[None]))
    triangles = scipy.sparse.coo_matrix((entries.reshape(-1), (rows, columns)), shape=(count, count))
    springs = SPRING * contact_n_per_m(cloth, material) + band_n_per_m
    return (triangles + scipy.sparse.diags(springs)).tocsc()


def stiffness_factor(cloth: ClothMesh, material: Material, band_n_per_m: np.ndarray, sheet: Sheet) -> StiffnessFactor:
    """The factor of the K of ``cloth``, for kernels on its ``sheet``; floats of the same type."""
    matrix = stiffness(cloth, material, band_n_per_m).tocsr()
    order = dissected(matrix.indptr, matrix.indices)
    # A symmetric positive matrix needs no pivots, and without them U is D L^T.
    lu = scipy.sparse.linalg.splu(
        matrix[order][:, order].tocsc(),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    lower = scipy.sparse.tril(lu.L, -1).tocsc()
    lower.sort_indices()
    dtype = sheet.own.dtype
    column = runs(lower.indptr, lower.indices, COSTS)
    panels = [_panel(lower, *ends) for ends in pairwise(column)]
    members = [member for member, _ in panels]
    rows = np.array([-len(member) % LANES + len(member) for member in members])
    return StiffnessFactor(
        place=sheet.place[order[np.argsort(lu.perm_c)]].astype(np.int32),
        column=column.astype(np.int32),
        size=np.array([len(member) for member in members], np.int32),
        start=np.concatenate([[0], np.cumsum(rows)]).astype(np.int32),
        member=np.concatenate([np.pad(m, (0, -len(m) % LANES), constant_values=m[0]) for m in members]).astype(
            np.int32
        ),
        entry=np.concatenate([[0], np.cumsum(rows * np.diff(column))])[:-1].astype(np.int32),
        value=np.concatenate([np.pad(v, ((0, 0), (0, -v.shape[1] % LANES))).reshape(-1) for _, v in panels]).astype(
            dtype
        ),
        inverse=(1.0 / lu.U.diagonal()).astype(dtype),
    )


def _panel(lower: Any, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Members (R,) and values (end - begin, R) of the panel of the columns ``begin`` to ``end``; ``lower`` is L without
    its diagonal."""
    ends = lower.indptr[begin : end + 1]
    row, value = lower.indices[ends[0] : ends[-1]], lower.data[ends[0] : ends[-1]]
    member = np.union1d(np.arange(begin, end), row)
    dense = np.eye(len(member), end - begin)
    dense[np.searchsorted(member, row), np.repeat(np.arange(end - begin), np.diff(ends))] = value
    own, below = dense[: end - begin], dense[end - begin :]
    inverse = np.linalg.inv(own)
    return member, np.concatenate([inverse - np.eye(len(own)), -below @ inverse]).T


@kernel
def whole_step(x, factor, gradient, share):
    """Moves ``x`` [m] (P, 3) in place by a ``share`` of -K^-1 ``gradient`` [N] (P, 3), scaled down to ``CLAMP_M``.

    Nothing moves where a number of that is not finite.
    """
    q = np.empty((len(factor.place), 3), x.dtype)
    for i in range(len(q)):
        for axis in range(3):
            q[i, axis] = -gradient[factor.place[i], axis]
    solve(factor, q)
    most = x.dtype.type(0)
    for i in range(len(q)):
        square = q[i, 0] * q[i, 0] + q[i, 1] * q[i, 1] + q[i, 2] * q[i, 2]
        if not square <= most:
            most = square
    if not most < np.inf:
        return
    clamp = x.dtype.type(CLAMP_M)
    share *= clamp / max(np.sqrt(most), clamp)
    for i in range(len(q)):
        for axis in range(3):
            x[factor.place[i], axis] += share * q[i, axis]


@kernel
def solve(factor, y):
    """Replaces ``y`` (V, 3), in the factor's order, by K^-1 y."""
    scratch = np.empty(3 * (len(y) + LANES), y.dtype)  # as many rows of three as the largest panel may have
    for panel in range(len(factor.size)):
        _down(factor, panel, y, scratch)
    for i in range(len(y)):
        for axis in range(3):
            y[i, axis] *= factor.inverse[i]
    for panel in range(len(factor.size) - 1, -1, -1):
        _up(factor, panel, y, scratch)


@kernel
def _down(factor, panel, y, s):
    """Adds what the columns of a ``panel`` say to its members: y_JR += P y_J."""
    first, last, begin, entry = factor.column[panel], factor.column[panel + 1], factor.start[panel], factor.entry[panel]
    rows = factor.start[panel + 1] - begin
    for row in range(0, rows, LANES):
        value = row_at(factor.value, entry + row)
        a, b, c = value * y[first, 0], value * y[first, 1], value * y[first, 2]
        for j in range(first + 1, last):
            value = row_at(factor.value, entry + (j - first) * rows + row)
            a, b, c = a + value * y[j, 0], b + value * y[j, 1], c + value * y[j, 2]
        put3(s, 3 * row, (a, b, c))
    for row in range(0, rows, LANES):
        for lane in range(min(LANES, factor.size[panel] - row)):
            i = factor.member[begin + row + lane]
            for axis in range(3):
                y[i, axis] += s[3 * row + LANES * axis + lane]


@kernel
def _up(factor, panel, y, s):
    """Adds what the members of a ``panel`` say to its columns: y_J += P^T y_JR."""
    first, last, begin, entry = factor.column[panel], factor.column[panel + 1], factor.start[panel], factor.entry[panel]
    rows = factor.start[panel + 1] - begin
    for row in range(0, rows, LANES):
        put3(s, 3 * row, points_at(y, factor.member, begin + row))
    for j in range(first, last):
        a, b, c = scaled(row_at(factor.value, entry), rows3_at(s, 0))
        for row in range(LANES, rows, LANES):
            value, other = row_at(factor.value, entry + row), rows3_at(s, 3 * row)
            a, b, c = a + value * other[0], b + value * other[1], c + value * other[2]
        entry += rows
        add_to(y, j, sums(a, b, c))
