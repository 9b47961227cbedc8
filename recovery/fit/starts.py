"""Drapes that a search can start from: at rest, and with every part of the body in the opening that is meant for it.

Closing threads can pull a sleeve past its arm, and Newton can stick, on one mesh and not on the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.garment.contours import lost_parts
from recovery import progress as watch
from recovery.drape.pattern_drape import Draped, SewingOptions, drape_pattern
from recovery.drape.placement import posed_joints
from recovery.fit.laying import DressedDrape, Dressing, Shown
from recovery.pattern.sewing_pattern import Pattern
from recovery.progress import Say
from recovery.sim.skin_contact import SignedDistance

LENGTHS_TRIED = (1.0, 0.93, 1.07, 0.87)  # edge lengths of the meshes that are tried, over the one asked for
FINER = 0.6  # the one tried next where a part is lost: edges of 5 cm cut through a wrist, and its sleeve slips off


@dataclass(frozen=True, eq=False)
class DrapeStart:
    """The settings that drapes have in common: the ``body``, the options ``drape``, the ``pose`` [rad] (24, 3), None
    for the T-pose, and the body's signed distance ``skin`` in the T-pose, None if it has to be computed.

    ``parts`` names parts of the body that should go through the garment's openings, by default the limbs that have one.
    ``cloth`` replaces the fabric of the options, and ``report`` gets lines on every drape.
    """

    body: BodyModel
    drape: SewingOptions
    pose: np.ndarray | None
    skin: SignedDistance | None
    parts: tuple[str, ...] = ()
    cloth: OrthotropicMaterial | None = None
    report: Say | None = None

    def lost(self, draped: Draped) -> tuple[str, ...]:
        """Returns the names of the ``parts`` of the body that are beside their openings; empty if all go through."""
        parts = self.parts or draped.placed.limbs
        return lost_parts(*draped.surface, posed_joints(self.body, self.pose), parts)


def drape_worn(
    pattern: Pattern,
    start: DrapeStart,
    *,
    rest: bool = True,
    mended: Callable[[Draped], Draped] = lambda draped: draped,
    off_mm: Callable[[Draped], float] = lambda draped: 0.0,
    enough_mm: float = 0.0,
) -> Draped:
    """Returns a drape of ``pattern``, changed by ``mended``, in which every part of the body is in its opening.

    If a part is lost, if with ``rest`` the cloth still moves, or if the distance ``off_mm`` of a drape is above
    ``enough_mm`` [mm], other meshes are tried: a much finer one first for a lost part, then a little finer and coarser
    ones. If none is right, the best is returned: one with all parts before one at rest, and that before one with a
    lower ``off_mm``. Raises ``InputError`` where the pattern cannot be sewn on any.
    """
    tried: list[tuple[tuple[int, int, float, int], Draped]] = []
    refused: list[InputError] = []
    shares, number = list(LENGTHS_TRIED), -1
    while shares:
        share, number = shares.pop(0), number + 1
        options = replace(start.drape, edge_length_m=share * start.drape.edge_length_m)
        try:
            given = {"pose": start.pose, "cloth": start.cloth, "skin": start.skin, "report": start.report}
            draped = mended(drape_pattern(pattern, start.body, options, **given))
        except InputError as error:
            refused.append(error)
            continue
        lost, moves, off = len(start.lost(draped)), int(not draped.at_rest), off_mm(draped)
        tried.append(((lost, moves, off, number), draped))
        if (not lost and not (rest and moves) and off <= enough_mm) or watch.over():
            break
        if lost and number == 0:
            shares.insert(0, FINER)
    if not tried:
        raise refused[0]
    return min(tried, key=lambda pair: pair[0])[1]


def sew_and_dress(
    pattern: Pattern,
    start: DrapeStart,
    dressing: Dressing,
    shown: Shown,
    *,
    rest: bool = True,
    off_mm: Callable[[Draped], float] = lambda draped: 0.0,
    enough_mm: float = 0.0,
) -> DressedDrape:
    """Returns ``pattern`` sewn from flat panels, and put on by ``dressing`` as ``shown`` lies, on the best of several
    meshes.

    ``rest``, ``off_mm`` and ``enough_mm`` say which that is, as in ``drape_worn``. Raises ``InputError`` where the
    pattern cannot be sewn.
    """
    pairs: list[DressedDrape] = []

    def mended(loose: Draped) -> Draped:
        pairs.append(DressedDrape(loose, dressing.worn_as(loose, shown)))
        return pairs[-1].worn

    worn = drape_worn(pattern, start, rest=rest, mended=mended, off_mm=off_mm, enough_mm=enough_mm)
    return next(pair for pair in pairs if pair.worn is worn)


def needed_length(draped: Draped, options: SewingOptions) -> float:
    """Returns the longest edges [m] on which a garment like ``draped`` is worn: those of its own mesh if ``drape_worn``
    had to take a much finer one than ``options`` ask for, otherwise infinity.

    A part of the body that a coarse mesh has lost once would be lost in every drape of a search.
    """
    length = draped.figures["edge_length_m"]
    return length if length <= FINER * options.edge_length_m else math.inf


def drape_at_rest(pattern: Pattern, start: DrapeStart) -> Draped:
    """Returns a drape of ``pattern`` at rest with every part of the body in its opening, on the mesh that
    ``drape_worn`` takes. Raises ``InputError`` where none comes to rest."""
    draped = drape_worn(pattern, start)
    if not draped.at_rest:
        left = max(drape.report.residual_n for drape in (draped.rest, draped.posed) if drape is not None)
        raise InputError(
            "graded pattern",
            expected="a drape at rest to start from",
            got=f"{left:.1e} N left at a node, on the best of {len(LENGTHS_TRIED)} meshes",
            cure="Take another mesh (edge_length_m), more iterations, or a base nearer to the target.",
        )
    return draped
