"""Conjugate gradients for block systems: symmetric Gauss-Seidel and patch charts as preconditioner.

Numbers are all of one type, float32 or float64; ``drape/engine/source/linear.hpp``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.engine.calls import call, call_with_scratch
from drape.engine.packer import Record, Recorded
from drape.exact.hessian import Pattern


class Charts(NamedTuple):
    """A coarse basis in which each patch has one displacement: vertex v moves by the mean of its C patches ``patch``
    (V, C) with the weights ``weight`` (V, C), which sum to one."""

    patch: np.ndarray
    weight: np.ndarray


def no_charts(vertex_count: int, dtype: type[np.floating]) -> Charts:
    """Returns a basis without patches, for V vertices."""
    return Charts(np.zeros((vertex_count, 0), np.int32), np.zeros((vertex_count, 0), dtype))


def galerkin(charts: Charts, pattern: Pattern, blocks: np.ndarray, out: np.ndarray) -> None:
    """Writes P^T H P [N/m] to ``out`` (3K, 3K): P is the basis of the K patches of ``charts``, H the matrix with the
    ``blocks`` (N, 3, 3) of ``pattern``."""
    call("galerkin", blocks.dtype, Record("Charts", charts), pattern, blocks, out, len(out))


@dataclass(frozen=True, eq=False)
class System(Recorded):
    """A matrix H of ``blocks`` (N, 3, 3) in a ``pattern`` and its preconditioner: ``inverse`` (V, 3, 3) of the positive
    diagonal blocks, and ``coarse`` (3K, 3K), the inverse of ``galerkin`` for ``charts``, of size zero if there is
    none."""

    pattern: Pattern
    blocks: np.ndarray
    inverse: np.ndarray
    charts: Charts
    coarse: np.ndarray


def conjugate_gradients(system: System, force: np.ndarray, share: float, limit: int, moved: np.ndarray) -> int:
    """Solves H x = ``force`` (V, 3) [N] approximately and writes x [m] (V, 3) to ``moved``. Returns the number of
    iterations, negative if it met a direction of negative curvature.

    It ends when the norm of the residual is ``share`` of that of ``force``, after ``limit`` iterations, or on a
    direction of negative curvature, which is left out unless it is the first (Steihaug 1983, "The conjugate gradient
    method and trust regions in large scale optimization", SIAM J. Numer. Anal. 20(3)).
    """
    iterations = np.empty(1, np.int64)
    call_with_scratch("solve", force.dtype, system, force, float(share), limit, moved, iterations)
    return int(iterations[0])
