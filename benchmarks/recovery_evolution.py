"""A search without gradients: CMA-ES (Hansen and Ostermeier 2001; the package cma) on a loss, within a given time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cma
import numpy as np

from drape.arrays import check_finite
from drape.errors import InputError

FAILED = 10.0  # times the largest loss of a generation: only ranks count


class Best(NamedTuple):
    """The best ``values`` (Z,) and their ``loss`` after ``evaluations``, at ``spent`` on the clock.

    ``failed`` of the evaluations had no loss; ``stopped`` are the criteria by which the search ended before its time.
    """

    values: np.ndarray
    loss: float
    evaluations: int
    failed: int
    spent: float
    stopped: tuple[str, ...] = ()


def evolve(
    loss: Callable[[np.ndarray], float | None],
    start: np.ndarray,
    sigma: float,
    budgets: Sequence[float],
    *,
    seed: int,
    clock: Callable[[], float] = time.process_time,
) -> list[Best]:
    """The best of one search when each of the rising ``budgets`` of ``clock`` was spent, [s] of the processor.

    ``loss`` is None where there is none, as for a pattern that folds. The search is in units in which ``sigma`` is a
    step in any of the unknowns; population and rates are the package's. The start counts as the first evaluation, so
    nothing worse is returned. The same for the same ``seed``, as long as the clock is. Raises ``InputError`` for
    budgets that do not rise from above 0, or a start without loss.
    """
    start = np.asarray(start, dtype=np.float64)
    check_finite("start", start)
    if not len(budgets) or not (np.diff([0.0, *budgets]) > 0.0).all():
        raise InputError("budgets", expected="rising times > 0", got=f"{list(budgets)}", cure="Sort them.")
    began = clock()
    first = loss(start)
    if first is None:
        raise InputError("start", expected="unknowns that have a loss", got="none", cure="Start elsewhere.")
    rng = np.random.default_rng(seed)
    # Numbers of our own generator: the package would seed NumPy's global one.
    options = {"seed": np.nan, "randn": lambda *size: rng.standard_normal(size), "verbose": -9, "verb_log": 0}
    search = cma.CMAEvolutionStrategy(start, sigma, options)
    best = Best(start, first, 1, 0, clock() - began)
    found: list[Best] = []
    while not search.stop():
        candidates, losses = search.ask(), []
        for candidate in candidates:
            value = loss(candidate)
            losses.append(value)
            spent = clock() - began
            best = best._replace(evaluations=best.evaluations + 1, failed=best.failed + (value is None), spent=spent)
            if value is not None and value < best.loss:
                best = best._replace(values=np.array(candidate), loss=value)
            while len(found) < len(budgets) and spent >= budgets[len(found)]:
                found.append(best)
            if len(found) == len(budgets):
                return found
        known = [value for value in losses if value is not None]
        worst = FAILED * (max(known) if known else best.loss)
        search.tell(candidates, [worst if value is None else value for value in losses])
    best = best._replace(stopped=tuple(search.stop() or ()))
    return found + [best] * (len(budgets) - len(found))
