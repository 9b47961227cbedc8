"""The openings of a sewn garment, from its pattern alone: edges that no stitch holds form closed lines.

Places of panels say which opening is the neck, the waist, the hem or a cuff, so that no edge needs a label.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.model import EdgeRef, Pattern
from recovery.pattern.split import partners

ASIDE_M = 0.06  # of an opening's centre from the middle of the body: a limb's
Corner = tuple[str, int]  # panel, and the edge that starts there


class Opening(NamedTuple):
    """Edges round an opening of the sewn garment, in the order in which they follow each other.

    ``centre`` [m] (3,) is the mean of their middles, panels as placed.
    """

    refs: tuple[EdgeRef, ...]
    centre: np.ndarray


def openings(pattern: Pattern) -> list[Opening]:
    """The openings of the sewn ``pattern``: closed lines of edges that no stitch holds."""
    place = {}  # of a panel's corner: the same for all that are sewn together
    for panel in pattern.panels:
        place |= {(panel.name, number): (panel.name, number) for number in range(len(panel.edges))}

    def root(corner: Corner) -> Corner:
        while place[corner] != corner:
            corner = place[corner]
        return corner

    def ends(ref: EdgeRef) -> list[Corner]:
        return [(ref.panel, ref.edge), (ref.panel, (ref.edge + 1) % len(pattern.panel(ref.panel).edges))]

    for stitch in pattern.stitches:
        there = ends(stitch.second) if stitch.right_to_wrong else ends(stitch.second)[::-1]
        for one, other in zip(ends(stitch.first), there, strict=True):
            place[root(one)] = root(other)
    sewn = partners(pattern)
    left = [ref for ref in pattern.edge_refs() if ref not in sewn]
    rings = []
    while left:
        loop = [left.pop(0)]
        while (following := _from(left, root(ends(loop[-1])[1]), ends, root)) is not None:
            left.remove(following)
            loop.append(following)
        rings.append(Opening(tuple(loop), centre_of(pattern, loop)))
    return rings


def _from(
    left: Sequence[EdgeRef], corner: Corner, ends: Callable[[EdgeRef], list[Corner]], root: Callable[[Corner], Corner]
) -> EdgeRef | None:
    """The edge out of ``left`` that starts at ``corner``."""
    return next((ref for ref in left if root(ends(ref)[0]) == corner), None)


def centre_of(pattern: Pattern, refs: Sequence[EdgeRef]) -> np.ndarray:
    """The mean [m] (3,) of the middles of edges, panels as placed."""
    panels = [pattern.panel(ref.panel) for ref in refs]
    middles = [
        panel.placement.apply(geometry.edge_points(panel, ref.edge, np.array([0.5])))[0]
        for panel, ref in zip(panels, refs, strict=True)
    ]
    return np.mean(middles, axis=0)


def openings_by_name(pattern: Pattern) -> dict[str, list[Opening]]:
    """The openings of ``pattern`` as neck, waist, hem and cuff; armholes without sleeves are none of these.

    Raises ``InputError`` where they are not those of a top, trousers or a skirt.
    """
    every = openings(pattern)
    middle = sorted((one for one in every if abs(one.centre[0]) < ASIDE_M), key=lambda one: -one.centre[1])
    aside = [one for one in every if abs(one.centre[0]) >= ASIDE_M]
    if (len(middle), len(aside)) == (2, 2):
        of_neck = {ref.panel for ref in middle[0].refs}
        sleeves = [one for one in aside if not of_neck & {ref.panel for ref in one.refs}]
        return {"neck": middle[:1], "hem": middle[1:], "cuff": sleeves}
    if (len(middle), len(aside)) == (2, 0):
        return {"waist": middle[:1], "hem": middle[1:]}
    if (len(middle), len(aside)) == (1, 2):
        return {"waist": middle, "hem": aside}
    raise InputError(
        "--style",
        expected="the openings of a top, of trousers or of a skirt",
        got=f"{len(middle)} in the middle and {len(aside)} beside it",
        cure="Leave --style out, and draw the lines on paper.",
    )


def openings_called(pattern: Pattern, name: str, part: str) -> list[Opening]:
    """The openings called ``name``, at which the ``part`` is to be."""
    by_name = openings_by_name(pattern)
    if not by_name.get(name):
        raise InputError(
            f"--style {part}",
            expected=f"a garment with a {name}",
            got=f"one with {' and '.join(key for key, ones in by_name.items() if ones)}",
            cure="Leave it out.",
        )
    return by_name[name]
