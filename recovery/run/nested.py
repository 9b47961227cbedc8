"""A recovered pattern in other sizes: its corners move as those of its base do from size to size."""

from __future__ import annotations

from collections.abc import Mapping

from drape.errors import InputError
from recovery.fit.seams import sewable
from recovery.pattern.bases import BASES
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.model import Pattern
from recovery.pattern.size_grades import in_size
from recovery.pattern.symmetry import find_symmetries


def in_other_size(
    pattern: Pattern, base: str, body: BodyMeasurements, settings: Mapping[str, float], size: str
) -> Pattern:
    """``pattern``, which fits ``body`` as its M, in ``size``; its ``base`` was drafted for ``body`` with ``settings``.

    A corner moves by the difference of both sizes of the base, then as little as keeps the ratios of seams and the
    base's symmetries. Raises ``InputError`` where the base is no design that grows, or does not come in that size.
    """
    if base not in BASES:
        raise InputError(
            "--sizes",
            expected=f"a base that is drafted: {', '.join(sorted(BASES))}",
            got=base,
            cure="Leave --sizes out: panels of a file do not say how they grow.",
        )
    drafts = [BASES[base](measured, **settings) for measured in (body, in_size(body, size))]
    middle, other = (control_points(draft).positions for draft in drafts)
    controls = control_points(pattern)
    grown = with_controls(pattern, controls, controls.positions + other - middle)
    return sewable(grown, pattern, find_symmetries(drafts[0]))
