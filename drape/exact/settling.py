"""Settling: descent by the cloth's stiffness at rest. It goes far in little time and does not end at rest.

    v' = m v - K^-1 dE/dx (x + m v),   x' = x + v'

K is that of ``drape.live.whole``. It never changes, so that one factor serves all poses, and a buckle of any length
grows as fast as any other. The memory m of a heavy ball (Polyak 1964) also brings waves as long as a leg, for which
Newton's method needs hundreds of its short steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse.linalg

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.live.whole import stiffness

MEMORY = 0.98
LONGEST_M = 0.02  # the longest step of a vertex, and the longest that is remembered
LOOK = 25  # the energy is looked at every so many rounds
LEAST_GAIN = 2e-3  # settling ends after twice LOOK rounds that each gain less than this share of all gain


class State(NamedTuple):
    """A state of a descent: the vertices ``x`` [m] (V, 3), their ``energy`` [J], and its ``gradient`` [N] (V, 3) there.
    The force on each vertex is the negative of that.

    ``at_rest``: the descent has ended there with as little force as it should. ``steps`` of Newton's method led
    there.
    """

    x: np.ndarray
    energy: float
    gradient: np.ndarray
    at_rest: bool = False
    steps: int = 0


def inverse(
    cloth: ClothMesh, material: Material, *, n_per_m: np.ndarray | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """Returns the function that solves K x = b: for forces b [N] (V, 3) it gives displacements x [m] (V, 3). K is the
    stiffness of ``cloth`` of ``material`` at rest, with springs of ``n_per_m`` [N/m] (V,) if given."""
    matrix: Any = stiffness(cloth, material, np.zeros(cloth.vertex_count) if n_per_m is None else n_per_m)
    factor = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return factor.solve


def settle(
    start: State, evaluate: Callable[[np.ndarray], State], solve: Callable[[np.ndarray], np.ndarray], rounds: int
) -> State:
    """Returns the state of least energy on at most ``rounds`` rounds of settling from ``start``; ``start`` itself if
    none is lower.

    ``evaluate`` gives the state at vertices [m] (V, 3); ``solve`` is the function that ``inverse`` returns.
    """
    x, way = start.x.copy(), np.zeros_like(start.x)
    best, idle, last = start, 0, start.energy
    for number in range(1, rounds + 1):
        ahead = x + MEMORY * way
        push = -solve(evaluate(ahead).gradient)
        push *= LONGEST_M / max(float(np.linalg.norm(push, axis=1).max()), LONGEST_M)
        way = ahead + push - x
        way *= LONGEST_M / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), LONGEST_M)
        x = x + way
        if number % LOOK and number != rounds:
            continue
        here = evaluate(x)
        if not np.isfinite(here.energy):
            break
        if here.energy < best.energy:
            best = here
        idle = 0 if last - here.energy > LEAST_GAIN * max(start.energy - best.energy, 0.0) else idle + 1
        last = here.energy
        if idle == 2:
            break
    return best
