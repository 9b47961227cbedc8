"""What a recovery found: its rounds, and all that led to the best of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recovery.drape.pipeline import Draped
from recovery.fit.cloth import Fabric
from recovery.fit.contours import Match
from recovery.fit.grading import Graded
from recovery.fit.optimise import Fitted, PatternSearch
from recovery.pattern.symmetry import Symmetries


@dataclass(frozen=True, eq=False)
class Round:
    """One search: the drape at its ``start``, how contours were paired there, and what was ``fitted``.

    Its mesh was asked for with ``edge_length_m`` [m]. It took ``seconds`` by the clock and ``processor_s`` of the
    processor, over all threads; its mesh and the drape at its start count with it. Base, grading and choice of the
    fabric count with the first round.
    """

    start: Draped
    matches: list[Match]
    search: PatternSearch
    fitted: Fitted
    edge_length_m: float
    seconds: float
    processor_s: float

    @property
    def least(self) -> np.ndarray:
        """The row of the search's history that its pattern is of."""
        return self.fitted.history[self.fitted.history[:, 0].argmin()]

    @property
    def apart_m2(self) -> float:
        """The loss of its pattern but for the reach, which may differ from round to round."""
        weights = self.search.objective.weights
        return float(self.least[1:4] @ (1.0, weights.contours, weights.seam_term))


@dataclass(frozen=True, eq=False)
class Recovered:
    """A recovery: the drape of the ``base``, the ``graded`` pattern, and what was ``fitted``.

    ``start``, ``matches``, ``search``, ``fitted`` and ``edge_length_m`` are those of the best of the ``rounds``; rounds
    with a free cloth go before others. ``left`` says which rounds were left out and why, empty for none or where they
    would find the same. ``matches`` pair the start's contours with the target's; ``holes`` are contours of the target
    without a partner. ``fabric`` is the named one nearest to the cloth of the drape; ``fabric_losses`` [m^2] is the
    loss that was left with each fabric that was tried.
    """

    symmetries: Symmetries
    base: Draped
    graded: Graded
    start: Draped
    matches: list[Match]
    holes: list[int]
    search: PatternSearch
    fitted: Fitted
    edge_length_m: float
    rounds: tuple[Round, ...]
    left: str
    fabric: Fabric
    fabric_losses: dict[str, float]


def apart_mm(squared: float) -> float:
    """Root mean square distance [mm] of two surfaces whose squared distances of both directions sum to this [m^2]."""
    return 1e3 * float(np.sqrt(0.5 * squared))
