"""Energy, gradient and sweeps of a cloth in float64 (``drape/engine/source/physics.hpp``).

Vertex block descent: Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4). One vertex after the other goes to the
minimum of its own quadratic model.
"""

from __future__ import annotations

import numpy as np

from drape.cloth.problem import Problem
from drape.engine.calls import call
from drape.exact.surroundings import Around


def energy_and_gradient(x: np.ndarray, problem: Problem, around: Around, gradient: np.ndarray) -> float:
    """Energy [J] at ``x`` [m] (V, 3); its gradient [N] is written to ``gradient`` (V, 3)."""
    energy = np.empty(1)
    call("energy", np.float64, x, problem, around, gradient, energy)
    return float(energy[0])


def sweep(x: np.ndarray, problem: Problem, around: Around, guarded: bool, order: np.ndarray | None = None) -> None:
    """One sweep of vertex block descent over ``x`` [m] (V, 3), in place; bending by hinges.

    ``guarded``: a vertex whose step does not lower the energy halves it, and stays after six halvings. The vertices are
    swept in their ``order`` (n,) int32, all of them colour by colour where there is none.
    """
    order = problem.order if order is None else order
    call("sweep", np.float64, x, problem, around, order, len(order), guarded)


def diagonal_blocks(x: np.ndarray, problem: Problem, around: Around, blocks: np.ndarray) -> None:
    """Writes the positive Hessian ``blocks`` [N/m] (V, 3, 3) with which ``sweep`` moves the vertices."""
    call("diagonal", np.float64, x, problem, around, blocks)
