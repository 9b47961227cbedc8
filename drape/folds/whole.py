"""A step of the whole cloth at once: what is too long or too short anywhere is shared out over all of it.

    K q = -dE/dx,   x += q

K is the cloth's stiffness with every triangle as at rest and alike in all three axes, one number per pair of vertices:

    K = sum of A (k_warp p p^T + k_weft t t^T) + springs,   k each with the shear,

p and t the slopes of a triangle's corners along warp and weft. It never changes, so that its factor L D L^T is made
once (Liu, Bouaziz and Kavan 2017, "Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials", ACM TOG
36(3)).

Sweeps from vertex to vertex give way where that takes the shortest distance, and leave cloth that is pushed together
crumpled at the size of its triangles. Here a buckle of any length grows as fast as any other, and bending decides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from drape.cloth.energies import ClothMesh, contact_n_per_m
from drape.cloth.material import Material
from drape.folds.sheet import Sheet
from drape.solver.compiled import kernel

CLAMP_M = 0.02  # the most that a vertex moves
# Of contact's stiffness, a spring on every vertex: K does not know what is closed now. With 0.07 what is in contact
# rattles, with more folds come more slowly.
SPRING = 0.2


class Whole(NamedTuple):
    """The factor of K in its own order: unit lower L by columns, without diagonal, and 1 / D.

    Column j has the rows ``row[start[j]:start[j + 1]]`` with ``value``; ``place`` (V,) is where each row is in a sheet.
    """

    place: np.ndarray
    start: np.ndarray
    row: np.ndarray
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
    matrix = stiffness(cloth, material, band_n_per_m)
    # A symmetric positive matrix needs no pivots, and without them U is D L^T.
    factor = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    lower = scipy.sparse.tril(factor.L, -1).tocsc()
    lower.sort_indices()
    dtype = sheet.own.dtype
    return Whole(
        sheet.place[np.argsort(factor.perm_c)].astype(np.int32),
        lower.indptr.astype(np.int32),
        lower.indices.astype(np.int32),
        lower.data.astype(dtype),
        (1.0 / factor.U.diagonal()).astype(dtype),
    )


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
    start, row, value = level.start, level.row, level.value
    count = len(y)
    for j in range(count):
        a, b, c = y[j, 0], y[j, 1], y[j, 2]
        for z in range(start[j], start[j + 1]):
            i = row[z]
            y[i, 0] -= value[z] * a
            y[i, 1] -= value[z] * b
            y[i, 2] -= value[z] * c
    for j in range(count - 1, -1, -1):
        a, b, c = level.inverse[j] * y[j, 0], level.inverse[j] * y[j, 1], level.inverse[j] * y[j, 2]
        for z in range(start[j], start[j + 1]):
            i = row[z]
            a -= value[z] * y[i, 0]
            b -= value[z] * y[i, 1]
            c -= value[z] * y[i, 2]
        y[j, 0], y[j, 1], y[j, 2] = a, b, c
