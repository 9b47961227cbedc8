"""The physics optimum of cloth that may not pass through itself: it judges folds that keep cloth apart.

Energy and method are those of ``drape.exact.apart``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.judge import physics, physics_cache
from drape.engine.build import SOURCE
from drape.exact import apart
from drape.exact.newton import Band, Cloth
from drape.exact.settling import State
from drape.geometry import triangle_pairs

STEPS = 120  # at most; drapes end a few hundredths of a joule above their optimum


def stored_apart(task: physics.OptimumTask, folder: Path | None) -> tuple[physics.Optimum, bool]:
    """Returns the optimum of ``minimise_apart`` for ``task``, and whether it was in ``folder`` already
    (``physics_cache.cached``)."""
    plain = physics_cache.cache_key(task, STEPS, physics.TOLERANCE)
    own = [Path(__file__), *(Path(str(module.__file__)) for module in (apart, triangle_pairs))]
    headers = [SOURCE / f"{name}.hpp" for name in ("apart", "pairs", "triangle")]
    key = physics_cache.key_of([plain], (), [*own, *headers])
    return physics_cache.cached(key, lambda: minimise_apart(task, step_limit=STEPS), folder)


def minimise_apart(
    task: physics.OptimumTask, *, step_limit: int = STEPS, tolerance: float = physics.TOLERANCE
) -> physics.Optimum:
    """Returns the drapes of least energy that are reached from the first start of ``task`` without the cloth passing
    through itself, in ``step_limit`` steps at most.

    Energies are of cloth and body, without the barrier. ``converged`` and ``residual_n`` count the barrier's force, of
    which ``tolerance`` times the weight may be left.
    """

    def descend(cloth: Cloth, posed: np.ndarray, starts: list[np.ndarray], band: Band | None) -> State:
        descent = apart.ApartDescent(cloth, task.contact, posed, starts[0], band=band)
        return descent.run(step_limit, tolerance * cloth.weight_n)

    return physics.descend_from_starts(task, descend)
