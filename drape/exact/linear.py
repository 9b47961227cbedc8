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
    """A basis of patches that each carry one displacement: C ``patch`` (V, C) per vertex with ``weight`` (V, C),
    whose rows sum to one."""

    patch: np.ndarray
    weight: np.ndarray


def no_charts(vertex_count: int, dtype: type[np.floating]) -> Charts:
    """The empty basis."""
    return Charts(np.zeros((vertex_count, 0), np.int32), np.zeros((vertex_count, 0), dtype))


def galerkin(charts: Charts, pattern: Pattern, blocks: np.ndarray, out: np.ndarray) -> None:
    """Writes P^T H P to ``out`` (3K, 3K), P the basis of the K ``charts``, H of ``blocks`` (N, 3, 3)."""
    call("galerkin", blocks.dtype, Record("Charts", charts), pattern, blocks, out, len(out))


@dataclass(frozen=True, eq=False)
class System(Recorded):
    """A block matrix and its preconditioner: the ``inverse`` (V, 3, 3) of positive diagonal blocks, and ``coarse``
    (3K, 3K), the inverse of the matrix on the charts, of size zero if there are none."""

    pattern: Pattern
    blocks: np.ndarray
    inverse: np.ndarray
    charts: Charts
    coarse: np.ndarray


def conjugate_gradients(system: System, force: np.ndarray, share: float, limit: int, moved: np.ndarray) -> int:
    """Solves H x = ``force`` (V, 3) approximately, writes x (V, 3) to ``moved``, and returns the number of iterations:
    negative if H was found to have negative curvature.

    Ends when the norm of the residual is ``share`` of that of ``force``, after ``limit`` iterations, or on a direction
    of negative curvature, which is left out unless it is the first (Steihaug 1983, "The conjugate gradient method and
    trust regions in large scale optimization", SIAM J. Numer. Anal. 20(3)).
    """
    iterations = np.empty(1, np.int64)
    call_with_scratch("solve", force.dtype, system, force, float(share), limit, moved, iterations)
    return int(iterations[0])
