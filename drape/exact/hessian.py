"""The Hessian of a cloth's energy as 3 x 3 blocks in rows (CSR): exact, or a positive part of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.problem import Problem, stencil
from drape.engine.calls import call
from drape.engine.packer import Recorded
from drape.exact.surroundings import Around


@dataclass(frozen=True, eq=False)
class Pattern(Recorded):
    """The sparsity of a symmetric matrix of N blocks (3, 3) in compressed rows.

    Row v has the blocks ``start[v]`` to ``start[v + 1]`` at the columns ``column`` (N,), ascending; block
    ``diagonal[v]`` is on the diagonal. ``face`` (F, 3, 3) and ``hinge`` (H, 4, 4) are the blocks of every two corners
    of a triangle and of a hinge.
    """

    start: np.ndarray
    column: np.ndarray
    diagonal: np.ndarray
    face: np.ndarray
    hinge: np.ndarray


def pattern(cloth: ClothMesh) -> Pattern:
    """Returns the sparsity of the Hessian of ``cloth``: a block for every two vertices that share a triangle or a
    hinge."""
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


def assemble(
    x: np.ndarray, problem: Problem, around: Around, pattern: Pattern, exact: float, blocks: np.ndarray
) -> None:
    """Writes the Hessian [N/m] of the cloth's energy at ``x`` [m] (V, 3) to ``blocks`` (N, 3, 3) float64, the blocks of
    ``pattern``.

    ``exact`` is 0 to 1. At 1 it is the exact Hessian. At 0 it is positive: only tensile stress counts, hinges are as
    stiff as unbent ones, and the curvature of their angle is left out. Values between mix the two.
    """
    call("hessian", np.float64, x, problem, around, pattern, float(exact), blocks)
