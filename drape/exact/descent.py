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
    """Returns the energy [J] of the cloth ``problem`` at ``x`` [m] (V, 3) in the surroundings ``around``, and writes
    its gradient [N] to ``gradient`` (V, 3)."""
    energy = np.empty(1)
    call("energy", np.float64, x, problem, around, gradient, energy)
    return float(energy[0])


def sweep(x: np.ndarray, problem: Problem, around: Around, guarded: bool, order: np.ndarray | None = None) -> None:
    """Moves the vertices ``x`` [m] (V, 3) in place by one sweep of vertex block descent.

    ``guarded``: a vertex whose step does not lower the energy halves it, and stays after six halvings. ``order`` (n,)
    int32 are the vertices that are swept, one after the other; left out, all are, colour by colour.
    """
    order = problem.order if order is None else order
    call("sweep", np.float64, x, problem, around, order, len(order), guarded)


def diagonal_blocks(x: np.ndarray, problem: Problem, around: Around, blocks: np.ndarray) -> None:
    """Writes to ``blocks`` [N/m] (V, 3, 3) the Hessian of each vertex by its own place, made positive definite, with
    which ``sweep`` moves it: the terms that could make it indefinite are left out."""
    call("diagonal", np.float64, x, problem, around, blocks)
