"""A coarse step: patches move as wholes, so that what is far away settles within a frame.

The basis are the charts; the matrix is the cloth's Laplacian at rest with its greater stiffness, on the basis once, and
per frame k n n^T of the contacts that are closed now. Three unknowns per patch, one dense Cholesky factor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.solver.compiled import kernel
from drape.solver.elements import at, dot, sub
from drape.solver.linear import Charts, prolong, restrict
from drape.solver.problem import Problem, Surroundings

SHARE = 0.7  # of the step that the model asks for: the rest shape's stiffness is not today's
CLAMP_M = 0.01  # the most that a patch moves; without it fast motion ends in numbers that are none
FLOOR_N_PER_M = 1e-3  # on every patch, so that one that touches nothing has a solution


class Coarse(NamedTuple):
    """``charts`` of the cloth and the Laplacian on them, ``matrix`` (K, 3, K, 3) [N/m]."""

    charts: Charts
    matrix: np.ndarray


def coarse(cloth: ClothMesh, material: Material, charts: Charts) -> Coarse:
    """The coarse level of ``cloth``, in the type of the charts' weights."""
    a, b, c, d = cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d]), np.stack([a, c]), np.stack([b, d])])  # (corner, axis, F)
    stiffness = max(float(material.warp_n_per_m), float(material.weft_n_per_m)) * cloth.face_area
    entries = stiffness * np.einsum("iaf,jaf->ijf", slopes, slopes)
    rows, columns = (
        np.broadcast_to(i, (3, 3, len(cloth.faces))) for i in (cloth.faces.T[:, None], cloth.faces.T[None])
    )
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
    matrix = np.einsum("kl,ij->kilj", small, np.eye(3)).astype(charts.weight.dtype)
    return Coarse(charts, np.ascontiguousarray(matrix))


def coarse_step(x: np.ndarray, level: Coarse, problem: Problem, around: Surroundings, gradient: np.ndarray) -> None:
    """Moves ``x`` [m] (V, 3) in place by what the patches answer to ``gradient`` [N] (V, 3) there."""
    count = len(level.matrix)
    matrix, force = level.matrix.copy(), np.empty((count, 3), x.dtype)
    _add_contacts(x, problem, around, level.charts, matrix)
    restrict(level.charts, gradient, force)
    factorise, solve = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), (matrix,))
    factor, failed = factorise(matrix.reshape(3 * count, 3 * count), lower=1)
    if failed:
        return
    moved, _ = solve(factor, force.reshape(-1, 1), lower=1)
    step = (-SHARE * moved).reshape(count, 3)
    most = float(np.abs(step).max())
    if most > CLAMP_M:
        step *= CLAMP_M / most
    prolong(level.charts, np.ascontiguousarray(step, dtype=x.dtype), x)


@kernel
def _add_contacts(x, problem, around, charts, matrix):
    patch, weight = charts.patch, charts.weight
    for v in range(len(x)):
        normal = at(around.normal, v)
        if dot(sub(at(x, v), at(around.point, v)), normal) >= problem.constants.gap:
            continue
        for a in range(patch.shape[1]):
            for b in range(patch.shape[1]):
                w = problem.contact_n_per_m[v] * weight[v, a] * weight[v, b]
                for i in range(3):
                    for j in range(3):
                        matrix[patch[v, a], i, patch[v, b], j] += w * normal[i] * normal[j]
