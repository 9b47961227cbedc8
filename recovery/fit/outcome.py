"""The result of a recovery: its rounds, and all that led to the best of them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from drape.garment.contours import Match
from recovery.drape.pattern_drape import Draped
from recovery.fit.grading import Graded
from recovery.fit.laying import DressedDrape, Shown
from recovery.fit.optimise import Fitted, PatternSearch
from recovery.pattern.coordinates import control_points
from recovery.pattern.symmetry import Symmetries

SETTLED_M = 1e-4  # move of control points in a round: if none is longer and the mesh stays, the next finds the same
NOT_AT_REST = "no drape at rest"
SAME = "it would find the same"  # no fault


@dataclass(frozen=True, eq=False)
class Round:
    """One search for the pattern: the drape at its ``start``, the ``matches`` of that drape's contours with the
    target's, the ``search``, and what it ``fitted``.

    ``sewn``: the fitted pattern sewn anew from flat panels; the next round starts from that. ``sewn_m2`` [m^2]: the
    squared distance of that from the target, both directions summed. If nothing could be sewn they are None and
    infinite. ``edge_length_m`` [m] is the mesh's. ``seconds`` (clock time) and ``processor_s`` (processor time of all
    threads) include the making of the mesh and of the drape at the start, in the first round also base and grading.
    """

    start: Draped
    matches: list[Match]
    search: PatternSearch
    fitted: Fitted
    edge_length_m: float
    seconds: float
    processor_s: float
    sewn: DressedDrape | None = None
    sewn_m2: float = math.inf

    @property
    def least(self) -> np.ndarray:
        """The row (4,) of the search's history with the least loss: total loss, surface, contours [m^2], and the number
        of halvings."""
        return self.fitted.history[self.fitted.history[:, 0].argmin()]

    @cached_property
    def surface_m2(self) -> float:
        """The squared distance [m^2] of its fitted drape from the target, both directions summed
        (``Objective.surface``)."""
        return float(self.search.objective.surface(torch.from_numpy(self.fitted.nodes)))

    @property
    def apart_m2(self) -> float:
        """The loss [m^2] of its fitted pattern, surface and contours, without the factor of the reach, which differs
        from round to round."""
        return self.surface_m2 + float(self.least[2])

    @property
    def rank(self) -> tuple[float, float]:
        """The sum of ``apart_m2`` and ``sewn_m2`` [m^2], and ``apart_m2`` alone, which decides between equal sums; the
        round with the least is the best."""
        return self.apart_m2 + self.sewn_m2, self.apart_m2


@dataclass(frozen=True, eq=False)
class Recovered:
    """A recovery: the drape of the ``base``, its ``symmetries``, the ``graded`` pattern, and the pattern that was
    ``fitted``.

    ``start``, ``matches``, ``search``, ``fitted``, ``edge_length_m`` and ``sewn`` are those of the best of the
    ``rounds``, by ``Round.rank``. ``left`` says which rounds were left out and why; it is empty if none were, or if
    they would find the same. ``matches`` pair the start's contours with the target's; ``holes`` are the numbers of the
    target's contours without a partner. ``fabric`` is the name of the fabric of all drapes.
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
    sewn: DressedDrape | None
    rounds: tuple[Round, ...]
    left: str
    fabric: str

    @property
    def shown(self) -> Shown:
        """The drape of the fitted pattern, in the target's pose."""
        return Shown(self.search.mesh_of(self.fitted), self.fitted.nodes)


def clocks() -> np.ndarray:
    """Returns two times [s] as an array (2,): that of a steady clock, and the processor time of all threads."""
    return np.array([time.perf_counter(), time.process_time()])


def why_left(rounds: Sequence[Round], start: Draped) -> str:
    """Returns why no further search begins at ``start``, after the ``rounds`` so far: ``NOT_AT_REST``, or ``SAME`` if
    it would find the same as the last one. The text is empty if a search does begin."""
    if not start.at_rest:
        return NOT_AT_REST
    last = rounds[-1]
    moved = np.abs(last.fitted.positions - control_points(last.start.mesh.pattern).positions).max()
    same = np.array_equal(last.start.mesh.faces, start.mesh.faces) and moved <= SETTLED_M
    return SAME if same else ""


def apart_mm(squared: float) -> float:
    """Returns the root mean square distance [mm] of two surfaces whose squared distances of both directions sum to
    ``squared`` [m^2]."""
    return 1e3 * float(np.sqrt(0.5 * squared))
