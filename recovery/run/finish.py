"""Forms of a recovered pattern: with the style lines that were asked for, and in other sizes.

A collar is added where the target has one. From size to size corners move as those of the base do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from drape.errors import InputError
from recovery.fit.seams import sewable
from recovery.pattern.bases import BASES
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.measurements import BodyMeasurements, in_size
from recovery.pattern.openings import COLLAR
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.style import NO_STYLE, RIB_SHORTER, RIBS, Style, add_style_lines, cap_corners_deg, finish_pattern
from recovery.pattern.symmetry import find_symmetries
from recovery.run.cut import Cut

FAIR_DEG = 5.0  # by which a cap may turn at a corner before it is worth a sentence


def style_pattern(asked: Style, cut: Cut, pattern: Pattern, warnings: list[str]) -> tuple[Style, Pattern, Pattern]:
    """Returns the style of a recovered ``pattern``, the pattern with its lines, and the same with all that is joined
    and drafted besides.

    ``asked`` is the style that the user asked for; the target's own collar (``cut``) is added unless it has one. If the
    panels have no room for the lines, all of them are left out. ``warnings`` get a sentence on that, on a collar, and
    on caps that are not smooth.
    """
    style = asked
    if cut.collar_m and COLLAR not in asked.widths_m:
        style = replace(asked, widths_m={**asked.widths_m, COLLAR: cut.collar_m})
    try:
        with_lines = add_style_lines(pattern, style)
        cut_pattern = finish_pattern(with_lines, style)
    except InputError as error:
        warnings.append(f"The style lines ({style.words()}) were left out: {error}")
        return NO_STYLE, pattern, pattern
    if COLLAR in style.widths_m:
        warnings.append(
            f"The collar is drafted: straight, as long as the neckline, {100 * style.widths_m[COLLAR]:.1f} cm wide. "
            "It was neither draped nor fitted."
        )
    if ribs := [name for name in RIBS if name in style.widths_m]:
        shorter = ", ".join(f"{name.replace('_', ' ')} by {RIB_SHORTER[RIBS[name]]:.0%}" for name in ribs)
        warnings.append(
            f"Ribs are drafted: straight, in place of what was cut off, shorter than what holds them ({shorter}). "
            "They were neither draped nor fitted."
        )
    if turned := {name: turn for name, turn in cap_corners_deg(cut_pattern).items() if turn > FAIR_DEG}:
        words = " and ".join(f"that of {name} by {turn:.0f}" for name, turn in turned.items())
        warnings.append(f"Where halves of sleeves met, their caps turn at a corner, {words} degrees: draw them fair.")
    return style, with_lines, cut_pattern


def in_other_size(
    pattern: Pattern, base: str, body: BodyMeasurements, settings: Mapping[str, float], size: str
) -> Pattern:
    """Returns ``pattern``, which fits ``body`` as its M, in ``size``; its ``base`` was drafted for ``body`` with
    ``settings``.

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
