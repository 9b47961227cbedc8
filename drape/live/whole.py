"""A step of the whole cloth at once: what is too long or too short anywhere is shared out over all of it.

    K q = -dE/dx,   x += q

K is the cloth's stiffness with every triangle as at rest and alike in all three axes, one number per pair of vertices:

    K = sum of A (k_warp p p^T + k_weft t t^T) + springs,   k each with the shear,

p and t the slopes of a triangle's corners along warp and weft. It never changes, so that its factor L D L^T is made
once (Liu, Bouaziz and Kavan 2017, "Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials", ACM TOG
36(3)).

Columns J of L whose rows R below are nearly the same are a panel, a dense matrix that stands for all of them,

    P = [ L_JJ^-1 - 1 ; -L_RJ L_JJ^-1 ],   y_JR += P y_J  on the way down,   y_J += P^T y_JR  on the way up,

so that no entry has an index, and rows of it are multiplied at once (partitioned inverse: Alvarado and Schreiber 1993,
"Optimal Parallel Solution of Sparse Triangular Systems", SIAM J. Sci. Comput. 14(2)).

Sweeps from vertex to vertex give way where that takes the shortest distance, and leave cloth that is pushed together
crumpled at the size of its triangles. Here a buckle of any length grows as fast as any other, and bending decides.
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

CLAMP_M = 0.02  # the most that a vertex moves
# Of contact's stiffness, a spring on every vertex: K does not know what is closed now. With 0.07 what is in contact
# rattles, with more folds come more slowly.
SPRING = 0.2


class Whole(NamedTuple):
    """The factor of K in its own order as N panels, and 1 / D.

    Panel p has the columns from ``column[p]`` to ``column[p + 1]`` (N + 1,); ``size`` (N,) members from
    ``start[p]`` (N + 1,) on in ``member``, which are its columns and the rows below, and its first column again up to a
    multiple of ``LANES``; ``value`` from ``entry[p]`` (N,) on, a column's members one after the other. ``place`` (V,)
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
    """K [N/m] (V, V), a sparse matrix, of ``cloth``, its waistband as stiff as ``band_n_per_m`` (V,)."""
    a, b, c, d = cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d]), np.stack([a, c]), np.stack([b, d])])  # (corner, axis, F)
    warp, weft, _, shear = (float(value) for value in material.membrane)
    entries = np.einsum("iaf,a,jaf,f->ijf", slopes, np.array([warp, weft]) + shear, slopes, cloth.face_area)
    shape, count = (3, 3, len(cloth.faces)), cloth.vertex_count
    rows, columns = (np.broadcast_to(i, shape).reshape(-1) for i in (cloth.faces.T[:, None], cloth.faces.T[None]))
    triangles = scipy.sparse.coo_matrix((entries.reshape(-1), (rows, columns)), shape=(count, count))
    springs = SPRING * contact_n_per_m(cloth, material) + band_n_per_m
    return (triangles + scipy.sparse.diags(springs)).tocsc()


def whole(cloth: ClothMesh, material: Material, band_n_per_m: np.ndarray, sheet: Sheet) -> Whole:
    """The factor for ``cloth`` made of ``material``, floats as those of ``sheet``."""
    matrix = stiffness(cloth, material, band_n_per_m).tocsr()
    order = dissected(matrix.indptr, matrix.indices)
    # A symmetric positive matrix needs no pivots, and without them U is D L^T.
    factor = scipy.sparse.linalg.splu(
        matrix[order][:, order].tocsc(),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    lower = scipy.sparse.tril(factor.L, -1).tocsc()
    lower.sort_indices()
    dtype = sheet.own.dtype
    column = runs(lower.indptr, lower.indices, COSTS)
    panels = [_panel(lower, *ends) for ends in pairwise(column)]
    members = [member for member, _ in panels]
    rows = np.array([-len(member) % LANES + len(member) for member in members])
    return Whole(
        place=sheet.place[order[np.argsort(factor.perm_c)]].astype(np.int32),
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
        inverse=(1.0 / factor.U.diagonal()).astype(dtype),
    )


def _panel(lower: Any, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Members (R,) and values (end - begin, R) of the panel of the columns from ``begin`` to ``end`` of L, ``lower``
    without its diagonal."""
    ends = lower.indptr[begin : end + 1]
    row, value = lower.indices[ends[0] : ends[-1]], lower.data[ends[0] : ends[-1]]
    member = np.union1d(np.arange(begin, end), row)
    dense = np.eye(len(member), end - begin)
    dense[np.searchsorted(member, row), np.repeat(np.arange(end - begin), np.diff(ends))] = value
    own, below = dense[: end - begin], dense[end - begin :]
    inverse = np.linalg.inv(own)
    return member, np.concatenate([inverse - np.eye(len(own)), -below @ inverse]).T


@kernel
def whole_step(x, level, gradient, share):
    """Moves ``x`` [m] (P, 3) in place by a ``share`` of what the cloth answers to ``gradient`` [N] (P, 3) there.

    Nothing moves where that is no number.
    """
    q = np.empty((len(level.place), 3), x.dtype)
    for i in range(len(q)):
        for axis in range(3):
            q[i, axis] = -gradient[level.place[i], axis]
    solve(level, q)
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
            x[level.place[i], axis] += share * q[i, axis]


@kernel
def solve(level, y):
    """K^-1 y over ``y`` (V, 3), in the factor's order."""
    scratch = np.empty(3 * (len(y) + LANES), y.dtype)  # as many rows of three as the largest panel may have
    for panel in range(len(level.size)):
        _down(level, panel, y, scratch)
    for i in range(len(y)):
        for axis in range(3):
            y[i, axis] *= level.inverse[i]
    for panel in range(len(level.size) - 1, -1, -1):
        _up(level, panel, y, scratch)


@kernel
def _down(level, panel, y, s):
    """What the columns of a ``panel`` take from its members."""
    first, last, begin, entry = level.column[panel], level.column[panel + 1], level.start[panel], level.entry[panel]
    rows = level.start[panel + 1] - begin
    for row in range(0, rows, LANES):
        value = row_at(level.value, entry + row)
        a, b, c = value * y[first, 0], value * y[first, 1], value * y[first, 2]
        for j in range(first + 1, last):
            value = row_at(level.value, entry + (j - first) * rows + row)
            a, b, c = a + value * y[j, 0], b + value * y[j, 1], c + value * y[j, 2]
        put3(s, 3 * row, (a, b, c))
    for row in range(0, rows, LANES):
        for lane in range(min(LANES, level.size[panel] - row)):
            i = level.member[begin + row + lane]
            for axis in range(3):
                y[i, axis] += s[3 * row + LANES * axis + lane]


@kernel
def _up(level, panel, y, s):
    """What the members of a ``panel`` give to its columns."""
    first, last, begin, entry = level.column[panel], level.column[panel + 1], level.start[panel], level.entry[panel]
    rows = level.start[panel + 1] - begin
    for row in range(0, rows, LANES):
        put3(s, 3 * row, points_at(y, level.member, begin + row))
    for j in range(first, last):
        a, b, c = scaled(row_at(level.value, entry), rows3_at(s, 0))
        for row in range(LANES, rows, LANES):
            value, other = row_at(level.value, entry + row), rows3_at(s, 3 * row)
            a, b, c = a + value * other[0], b + value * other[1], c + value * other[2]
        entry += rows
        add_to(y, j, sums(a, b, c))
