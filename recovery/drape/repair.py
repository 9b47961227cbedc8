"""Finds seams that a file joins crosswise, left side of one panel to right side of the other, and exchanges them."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

from recovery.pattern import geometry
from recovery.pattern.model import Pattern, Stitch

CLEARLY_NEARER = 0.5  # of the distance before: no seam that is meant crosswise comes near this
LENGTH_SLACK = 0.02  # by which the exchanged seams may fit worse


def uncrossed(pattern: Pattern) -> tuple[Pattern, tuple[str, ...]]:
    """``pattern`` with crossed pairs of stitches exchanged, and a sentence on each.

    Two stitches between the same two panels are crossed where their edges, panels as placed, come to lie twice as near
    with the partners exchanged, and the lengths still fit.
    """
    stitches, notes = list(pattern.stitches), []
    for i, j in combinations(range(len(stitches)), 2):
        before = (stitches[i], stitches[j])
        after = _exchanged(*before)
        if after is None:
            continue
        near, far = (sum(float(geometry.stitch_ends(pattern, s).sum()) for s in pair) for pair in (after, before))
        if near < CLEARLY_NEARER * far and _misfit(pattern, after) <= _misfit(pattern, before) + LENGTH_SLACK:
            stitches[i], stitches[j] = after
            notes.append(
                f"stitches {i + 1} and {j + 1} join {before[0].first} to {before[0].second} and {before[1].first} to "
                f"{before[1].second} crosswise, their ends {100 * far / 4:.0f} cm apart; exchanged, they are "
                f"{100 * near / 4:.0f} cm apart"
            )
    return replace(pattern, stitches=tuple(stitches)), tuple(notes)


def _exchanged(one: Stitch, other: Stitch) -> tuple[Stitch, Stitch] | None:
    """The stitches with their partners exchanged; None where they do not join the same two panels."""
    if one.first.panel == one.second.panel or one.right_to_wrong != other.right_to_wrong:
        return None
    if (other.first.panel, other.second.panel) == (one.second.panel, one.first.panel):
        other = replace(other, first=other.second, second=other.first)
    if (other.first.panel, other.second.panel) != (one.first.panel, one.second.panel):
        return None
    return replace(one, second=other.second), replace(other, second=one.second)


def _misfit(pattern: Pattern, pair: tuple[Stitch, Stitch]) -> float:
    """The larger share by which the two edges of a stitch differ in length."""
    return max(abs(seam.mismatch) for seam in geometry.seams(replace(pattern, stitches=pair)))
