"""What a recovery found: its rounds, and all that led to the best of them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from drape.garment.contours import Match
from recovery.drape.pattern_drape import Draped
from recovery.fit.grading import Graded
from recovery.fit.optimise import Fitted, PatternSearch
from recovery.pattern.coordinates import control_points
from recovery.pattern.symmetry import Symmetries

SETTLED_M = 1e-4  # of every control point in a round: where the mesh stays as well, the next would find the same
NOT_AT_REST = "no drape at rest"
SAME = "it would find the same"  # no fault


class Sewn(NamedTuple):
    """A pattern sewn from flat panels: ``loose`` as it closes by itself, ``worn`` with its belt at the target's."""

    loose: Draped
    worn: Draped


@dataclass(frozen=True, eq=False)
class Round:
    """One search: the drape at its ``start``, how contours were paired there, and what was ``fitted``.

    ``sewn`` is the pattern that it found sewn anew, which the next round starts from; ``sewn_m2`` is the squared
    distance [m^2] of that from the target, both directions summed. Where nothing could be sewn it is None and infinite.
    Its mesh was asked for with ``edge_length_m`` [m]. It took ``seconds`` by the clock and ``processor_s`` of the
    processor, over all threads; its mesh and the drape at its start count with it. Base and grading count with the
    first round.
    """

    start: Draped
    matches: list[Match]
    search: PatternSearch
    fitted: Fitted
    edge_length_m: float
    seconds: float
    processor_s: float
    sewn: Sewn | None = None
    sewn_m2: float = math.inf

    @property
    def least(self) -> np.ndarray:
        """The row of the search's history that its pattern is of."""
        return self.fitted.history[self.fitted.history[:, 0].argmin()]

    @cached_property
    def surface_m2(self) -> float:
        """The squared distance [m^2] of its drape from the target, both directions summed, as the loss has it."""
        return float(self.search.objective.surface(torch.from_numpy(self.fitted.nodes)))

    @property
    def apart_m2(self) -> float:
        """The loss of its pattern but for the reach, which may differ from round to round."""
        return self.surface_m2 + float(self.least[2])

    @property
    def rank(self) -> tuple[float, float]:
        """What the best round has least of: a pattern that falls into other folds when it is sewn is of no use."""
        return self.apart_m2 + self.sewn_m2, self.apart_m2


@dataclass(frozen=True, eq=False)
class Recovered:
    """A recovery: the drape of the ``base``, the ``graded`` pattern, and what was ``fitted``.

    ``start``, ``matches``, ``search``, ``fitted``, ``edge_length_m`` and ``sewn`` are those of the best of the
    ``rounds``, whose distances from the target, searched and sewn, are least in sum. ``left`` says which rounds were
    left out and why, empty for none or where they would find the same. ``matches`` pair the start's contours with the
    target's; ``holes`` are contours of the target without a partner. ``fabric`` is the name of the drape's.
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
    sewn: Sewn | None
    rounds: tuple[Round, ...]
    left: str
    fabric: str


def clocks() -> np.ndarray:
    """Seconds of the clock and of the processor."""
    return np.array([time.perf_counter(), time.process_time()])


def why_left(rounds: Sequence[Round], start: Draped) -> str:
    """Why no search from ``start`` follows the last of ``rounds``; empty if one does."""
    if not start.at_rest:
        return NOT_AT_REST
    last = rounds[-1]
    moved = np.abs(last.fitted.positions - control_points(last.start.mesh.pattern).positions).max()
    same = np.array_equal(last.start.mesh.faces, start.mesh.faces) and moved <= SETTLED_M
    return SAME if same else ""


def apart_mm(squared: float) -> float:
    """Root mean square distance [mm] of two surfaces whose squared distances of both directions sum to this [m^2]."""
    return 1e3 * float(np.sqrt(0.5 * squared))
