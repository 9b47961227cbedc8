"""The stiffness by which a step of the whole cloth spreads over all of it what is too long or too short anywhere.

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
from drape.engine.library import LANES
from drape.live.dissection import COSTS, dissection_order, runs
from drape.live.sheet import Sheet

# The spring on every vertex, as a share of contact's stiffness: K does not know which contacts are closed. With 0.07
# cloth in contact rattles; with more than this folds come more slowly.
SPRING = 0.2


class PanelLevels(NamedTuple):
    """The order in which a card multiplies the N panels of a ``StiffnessFactor``: all of a level at once. A panel is a
    level above those that have members among its columns. There are L levels.

    Level n has the entries ``row_start[n]`` to ``row_start[n + 1]`` of ``row_panel`` and ``row``. Each entry stands for
    ``LANES`` rows of that panel, from that row on. The columns of level n are ``column`` (V,) from ``column_start[n]``
    to ``column_start[n + 1]``. ``panel`` (V,) is the panel of each column.

    A card's scratch has the products of panels: those for column j from ``left[j]`` (V + 1,) on, in the order of the
    panels. V numbers follow, one a column. ``to`` says where in the scratch the number of each entry of
    ``StiffnessFactor.member`` goes, -1 for entries that only fill up.
    """

    row_start: np.ndarray
    row_panel: np.ndarray
    row: np.ndarray
    column_start: np.ndarray
    column: np.ndarray
    panel: np.ndarray
    left: np.ndarray
    to: np.ndarray


NO_LEVELS = PanelLevels(*[np.zeros(0, np.int32)] * 8)  # of a processor, which needs none


class StiffnessFactor(NamedTuple):
    """The factor L D L^T of the stiffness K of V vertices; ``inverse`` (V,) is the diagonal of 1 / D. Rows and columns
    have an order of their own: ``place`` (V,) is the place in a ``Sheet`` of each.

    L is stored as N panels, dense matrices of columns that have nearly the same rows. Panel p has the columns
    ``column[p]`` to ``column[p + 1]`` (N + 1,). Its members are these columns and the rows below them that have
    entries, together ``size[p]`` (N,). They are in ``member`` from ``start[p]`` (N + 1,) on, filled up with the panel's
    first column to a multiple of ``LANES``. The panel's numbers are in ``value`` from ``entry[p]`` (N,) on, column
    after column. ``levels`` is the order of a card, empty for a processor.
    """

    place: np.ndarray
    column: np.ndarray
    size: np.ndarray
    start: np.ndarray
    member: np.ndarray
    entry: np.ndarray
    value: np.ndarray
    inverse: np.ndarray
    levels: PanelLevels = NO_LEVELS


def stiffness(cloth: ClothMesh, material: Material, band_n_per_m: np.ndarray) -> Any:
    """Returns the stiffness K [N/m] (V, V) at rest, a sparse matrix in compressed columns, of ``cloth`` with springs of
    ``band_n_per_m`` [N/m] (V,) on its vertices."""
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
    """Returns the factor of the stiffness K of ``cloth`` of ``material``, with floats of the type of ``sheet`` and its
    places. ``band_n_per_m`` [N/m] (V,) are springs on the vertices."""
    matrix = stiffness(cloth, material, band_n_per_m).tocsr()
    order = dissection_order(matrix.indptr, matrix.indices)
    # A symmetric positive matrix needs no pivots, and without them U is D L^T.
    lu = scipy.sparse.linalg.splu(
        matrix[order][:, order].tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
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
