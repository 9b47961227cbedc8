"""Settling: descent by the cloth's stiffness at rest. It goes far in little time and does not end at rest.

    v' = m v - K^-1 dE/dx (x + m v),   x' = x + v'

K is that of ``drape.live.whole``. It never changes, so that one factor serves all poses, and a buckle of any length
grows as fast as any other. The memory m of a heavy ball (Polyak 1964) also brings waves as long as a leg, for which
Newton's method needs hundreds of its short steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import scipy.sparse.linalg

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.live.whole import stiffness

MEMORY = 0.98
LONGEST_M = 0.02  # of a vertex's step, and of its way that is remembered
LOOK = 25  # rounds after which the energy is looked at
LEAST_GAIN = 2e-3  # of all that was gained: less in LOOK rounds, twice running, and it ends


class At(Protocol):
    """A place ``x`` [m] (V, 3), its ``energy`` [J], and the gradient of the energy there, ``force`` [N] (V, 3)."""

    @property
    def x(self) -> np.ndarray: ...

    @property
    def energy(self) -> float: ...

    @property
    def force(self) -> np.ndarray: ...


Place = TypeVar("Place", bound=At)


def inverse(
    cloth: ClothMesh, material: Material, *, n_per_m: np.ndarray | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """K^-1 of ``cloth`` of ``material``, as a function of forces [N] (V, 3); ``n_per_m`` (V,) springs are in K too."""
    matrix: Any = stiffness(cloth, material, np.zeros(cloth.vertex_count) if n_per_m is None else n_per_m)
    factor = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return factor.solve


def settle(
    start: Place, found: Callable[[np.ndarray], Place], solve: Callable[[np.ndarray], np.ndarray], rounds: int
) -> Place:
    """Settles from ``start`` for at most ``rounds``. Returns the place of least energy that it met, ``start`` itself if
    none is lower.

    ``found`` gives energy and force of a place; ``solve`` is the function that ``inverse`` returns.
    """
    x, way = start.x.copy(), np.zeros_like(start.x)
    best, idle, last = start, 0, start.energy
    for number in range(1, rounds + 1):
        ahead = x + MEMORY * way
        push = -solve(found(ahead).force)
        push *= LONGEST_M / max(float(np.linalg.norm(push, axis=1).max()), LONGEST_M)
        way = ahead + push - x
        way *= LONGEST_M / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), LONGEST_M)
        x = x + way
        if number % LOOK and number != rounds:
            continue
        here = found(x)
        if not np.isfinite(here.energy):
            break
        if here.energy < best.energy:
            best = here
        idle = 0 if last - here.energy > LEAST_GAIN * max(start.energy - best.energy, 0.0) else idle + 1
        last = here.energy
        if idle == 2:
            break
    return best
