"""A coarse step: patches move as wholes, so that what is far away settles within a frame.

The basis are the charts; the matrix is the cloth's Laplacian at rest with its greater stiffness, on the basis once
(Galerkin), and per frame k n n^T of the contacts that are closed now. Three unknowns per patch. Patches are numbered so
that neighbours are near each other (reverse Cuthill-McKee), and the Cholesky factor is kept within the rows' envelopes
(George and Liu 1981, "Computer Solution of Large Sparse Positive Definite Systems"): a tenth of a dense one's work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.folds.sheet import LANES, Sheet
from drape.folds.sweeps import PLANES, row3
from drape.solver.compiled import kernel
from drape.solver.elements import at, dot, sub
from drape.solver.linear import Charts, prolong, restrict

SHARE = 0.7  # of the step that the model asks for: the rest shape's stiffness is not today's
CLAMP_M = 0.01  # the most that a patch moves; without it fast motion ends in numbers that are none
FLOOR_N_PER_M = 1e-3  # on every patch, so that one that touches nothing has a solution


class Coarse(NamedTuple):
    """``charts`` of the places, and the Laplacian [N/m] on their K patches.

    Row I of the lower triangle has the blocks of the patches ``first[I]`` to I (K,); its three rows of numbers lie one
    after the other in ``matrix``, from ``row[I]`` on.
    """

    charts: Charts
    first: np.ndarray
    row: np.ndarray
    matrix: np.ndarray


def coarse(cloth: ClothMesh, material: Material, charts: Charts, sheet: Sheet) -> Coarse:
    """The coarse level of ``cloth`` with ``charts`` of its vertices, in the order of ``sheet``."""
    small, coupled = galerkin(cloth, material, charts)
    order = reverse_cuthill_mckee(scipy.sparse.csr_matrix(coupled), symmetric_mode=True)
    place = np.argsort(order).astype(np.int32)
    first = coupled[np.ix_(order, order)].argmax(axis=1)
    size = 9 * (np.arange(len(first)) - first + 1)
    whole = np.kron(small[np.ix_(order, order)], np.eye(3))
    rows = [whole[3 * i : 3 * i + 3, 3 * first[i] : 3 * i + 3].reshape(-1) for i in range(len(first))]
    dtype = sheet.own.dtype
    real = np.zeros(len(sheet.vertex), bool)
    real[sheet.place] = True
    weight = np.where(real[:, None], charts.weight[sheet.vertex], 0.0).astype(dtype)
    return Coarse(
        Charts(np.ascontiguousarray(place[charts.patch[sheet.vertex]]), weight),
        first.astype(np.int32),
        (np.cumsum(size) - size).astype(np.int32),
        np.concatenate(rows).astype(dtype),
    )


def galerkin(cloth: ClothMesh, material: Material, charts: Charts) -> tuple[np.ndarray, np.ndarray]:
    """The Laplacian at rest on the patches (K, K) [N/m], one number for all three axes, and which are coupled at all.

    Those that share a vertex are, by its contact, whatever the Laplacian says.
    """
    a, b, c, d = cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d]), np.stack([a, c]), np.stack([b, d])])  # (corner, axis, F)
    stiffness = max(float(material.warp_n_per_m), float(material.weft_n_per_m)) * cloth.face_area
    entries = stiffness * np.einsum("iaf,jaf->ijf", slopes, slopes)
    shape = (3, 3, len(cloth.faces))
    rows, columns = (np.broadcast_to(i, shape) for i in (cloth.faces.T[:, None], cloth.faces.T[None]))
    count = cloth.vertex_count
    laplacian = scipy.sparse.coo_matrix(
        (entries.reshape(-1), (rows.reshape(-1), columns.reshape(-1))), shape=(count, count)
    )
    vertices = np.repeat(np.arange(count), charts.patch.shape[1])
    patch_count = int(charts.patch.max()) + 1
    basis = scipy.sparse.coo_matrix(
        (charts.weight.reshape(-1).astype(np.float64), (vertices, charts.patch.reshape(-1))),
        shape=(count, patch_count),
    ).tocsr()
    small = (basis.T @ laplacian.tocsr() @ basis).toarray() + FLOOR_N_PER_M * np.eye(patch_count)
    small = 0.5 * (small + small.T)
    return small, (small != 0.0) | ((basis.T @ basis).toarray() > 0.0)


@kernel
def coarse_step(x, level, sheet, planes, gradient, share):
    """Moves ``x`` [m] (P, 3) in place by a ``share`` of what the patches answer to ``gradient`` [N] (P, 3) there.

    Nothing moves where there is no factor.
    """
    k = sheet.constants
    matrix, force = level.matrix.copy(), np.empty((len(level.first), 3), x.dtype)
    _add_contacts(x, level, sheet, planes, matrix)
    restrict(level.charts, gradient, force)
    if not _solve(level.first, level.row, matrix, force):
        return
    most = k.zero
    for i in range(len(force)):
        for axis in range(3):
            force[i, axis] *= -share
            most = max(most, abs(force[i, axis]))
    if not most < np.inf:
        return
    if most > CLAMP_M:
        force *= CLAMP_M / most
    prolong(level.charts, force, x)


@kernel
def _add_contacts(x, level, sheet, planes, matrix):
    """k n n^T of each vertex nearer than the gap, at its patches."""
    k = sheet.constants
    for v in range(len(x)):
        for side in range(2):
            start, lane = PLANES * (v // LANES) + 6 * LANES * side, v % LANES
            n = row3(planes, start + 3 * LANES, lane)
            if dot(n, n) > k.zero and dot(sub(at(x, v), row3(planes, start, lane)), n) < k.gap:
                _add_contact(v, n, sheet.own[4 * LANES * (v // LANES) + 2 * LANES + lane], level, matrix)


@kernel
def _add_contact(v, n, stiffness, level, matrix):
    patch, weight = level.charts.patch, level.charts.weight
    for a in range(patch.shape[1]):
        i = patch[v, a]
        length = 3 * (i - level.first[i] + 1)
        for b in range(patch.shape[1]):
            j = patch[v, b]
            if j > i:
                continue
            w = stiffness * weight[v, a] * weight[v, b]
            corner = level.row[i] + 3 * (j - level.first[i])
            for r in range(3):
                for c in range(3):
                    matrix[corner + r * length + c] += w * n[r] * n[c]


@kernel
def _solve(first, row, matrix, y):
    """The factor L of ``matrix`` over it, row after row within its envelope, and L^-T L^-1 y over ``y`` (K, 3).

    False where there is none. On the diagonal of L stand its inverse numbers.
    """
    count = len(first)
    for i in range(count):
        rows_i = _rows_of(first, row, matrix, i)
        for j in range(first[i], i + 1):
            rows_j = _rows_of(first, row, matrix, j)
            start = max(first[i], first[j])
            a, b = 3 * (start - first[i]), 3 * (start - first[j])
            own_i, own_j, width = 3 * (j - first[i]), 3 * (j - first[j]), 3 * (j - start)
            for r in range(3):
                along = rows_i[r, a : a + width]
                sums = _three(along, rows_j[0, b : b + width], rows_j[1, b : b + width], rows_j[2, b : b + width])
                for c in range(3 if j < i else r + 1):
                    total = rows_i[r, own_i + c] - sums[c]
                    for k in range(c):
                        total -= rows_i[r, own_i + k] * rows_j[c, own_j + k]
                    if j < i or c < r:
                        rows_i[r, own_i + c] = total * rows_j[c, own_j + c]
                    elif total > 0.0:
                        rows_i[r, own_i + c] = 1.0 / np.sqrt(total)
                    else:
                        return False
    for i in range(count):
        rows = _rows_of(first, row, matrix, i)
        for r in range(3):
            total = y[i, r]
            for j in range(first[i], i + 1):
                for c in range(3 if j < i else r):
                    total -= rows[r, 3 * (j - first[i]) + c] * y[j, c]
            y[i, r] = total * rows[r, 3 * (i - first[i]) + r]
    for i in range(count - 1, -1, -1):
        rows = _rows_of(first, row, matrix, i)
        for r in range(2, -1, -1):
            y[i, r] *= rows[r, 3 * (i - first[i]) + r]
            for j in range(first[i], i + 1):
                for c in range(3 if j < i else r):
                    y[j, c] -= rows[r, 3 * (j - first[i]) + c] * y[i, r]
    return True


@kernel
def _rows_of(first, row, matrix, i):
    """The three rows (3, n) of patch i."""
    length = 3 * (i - first[i] + 1)
    return matrix[row[i] : row[i] + 3 * length].reshape(3, length)


@kernel
def _three(a, b, c, d):
    """a . b, a . c and a . d."""
    s, t, u = a.dtype.type(0), a.dtype.type(0), a.dtype.type(0)
    for k in range(len(a)):
        s += a[k] * b[k]
        t += a[k] * c[k]
        u += a[k] * d[k]
    return s, t, u
