"""The openings of a sewn garment, from its pattern alone, and the pieces that are drafted to them: collar and ribs.

Edges that no stitch holds form closed lines. Places of panels say which line is the neck, the waist, the hem or a
cuff, so that no edge needs a label. A collar or rib is a straight strip, sewn edge by edge to an opening. It was
neither draped nor fitted; it stands or hangs from there when the pattern is draped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.drafting import Side, draft
from recovery.pattern.pieces import FACED
from recovery.pattern.sewing_pattern import EdgeRef, Pattern, Stitch
from recovery.pattern.split import partners

COLLAR = "collar"
COLLAR_LEAN_M = 0.01  # each end of a collar's outer edge is longer by this: its points


def with_collar(pattern: Pattern, width_m: float) -> Pattern:
    """Returns ``pattern`` with a straight collar ``width_m`` [m] wide and as long as its neckline sewn to it, open in
    the middle of the front.

    Nothing turns it over when it is draped. Its ends lean outward. Raises ``InputError`` for a pattern without a neck.
    """
    (neck,) = openings_called(pattern, "neck", COLLAR)
    return _with_strip(
        pattern, neck, COLLAR, width_m, shorter=0.0, starts=lambda place: (round(place[2], 3), -place[1])
    )


def with_ribs(pattern: Pattern, name: str, width_m: float, shorter: float) -> Pattern:
    """Returns ``pattern`` with straight ribs ``width_m`` [m] wide, closed to rings, in place of the bands that were cut
    off for them. ``name`` is "rib_neck", "rib_cuffs" or "rib_hem".

    ``shorter`` is the share by which a rib is shorter than what it is sewn to. The seam that closes it is at the back
    of a neck, below an arm, or at the side of a hem.
    """
    word = name.removesuffix("s")
    bands = {panel.name for panel in pattern.panels if panel.name.endswith(f"_{word}")}
    held = set()
    for stitch in pattern.stitches:
        for band, other in ((stitch.first, stitch.second), (stitch.second, stitch.first)):
            if band.panel in bands and other.panel not in bands:
                held.add(other)
    pattern = replace(
        pattern,
        panels=tuple(panel for panel in pattern.panels if panel.name not in bands),
        stitches=tuple(s for s in pattern.stitches if not {s.first.panel, s.second.panel} & bands),
        panel_order=None,
    )
    rings = [opening for opening in openings(pattern) if set(opening.refs) & held]
    first: dict[str, Callable[[np.ndarray], tuple[float, ...]]] = {
        "rib_neck": lambda place: (-place[2],),
        "rib_cuffs": lambda place: (-place[1],),
        "rib_hem": lambda place: (abs(place[0]),),
    }
    for ring in rings:
        side = "" if len(rings) == 1 else "_left" if ring.centre[0] > 0.0 else "_right"
        called = word + side
        pattern = _with_strip(pattern, ring, called, width_m, shorter=shorter, starts=first[name])
        strip = pattern.panels[-1]
        end, start = (EdgeRef(strip.name, len(ring.refs) + n) for n in (0, 2))
        pattern = replace(pattern, stitches=(*pattern.stitches, Stitch(end, start)))
    return pattern


def _with_strip(
    pattern: Pattern,
    opening: PatternOpening,
    name: str,
    width_m: float,
    *,
    shorter: float,
    starts: Callable[[np.ndarray], tuple[float, ...]],
) -> Pattern:
    """``pattern`` with a strip round ``opening``, divided as it is, from the corner [m] (3,) of the most ``starts``."""
    places = [_start(pattern, ref) for ref in opening.refs]
    # Edges run about the opening as outlines do, so the strip's, which start at their ends, run the other way.
    first = max(range(len(places)), key=lambda n: starts(places[n]))
    order = [opening.refs[(first - 1 - n) % len(opening.refs)] for n in range(len(opening.refs))]
    lengths = [(1.0 - shorter) * geometry.edge_length(pattern.panel(ref.panel), ref.edge) for ref in order]
    along = [0.0, *np.cumsum(lengths).tolist()]
    lean = 0.0 if shorter else COLLAR_LEAN_M
    sides = [Side(f"sewn_{n}", (x, 0.0)) for n, x in enumerate(along[:-1])]
    sides += [
        Side("end", (along[-1], 0.0)),
        Side("outer", (along[-1] + lean, width_m)),
        Side("start", (-lean, width_m)),
    ]
    behind = min((pattern.panel(ref.panel) for ref in order), key=lambda panel: panel.placement.translation_m[2])
    drafted = draft(name, sides, rotation=behind.placement.rotation_deg, z=0.0).panel
    x, y = float(opening.centre[0]), float(max(place[1] for place in places)) + 0.5 * width_m
    placed = replace(behind.placement, translation_m=(x, y, behind.placement.translation_m[2]))
    edges = list(drafted.edges)
    outer = len(order) + 1
    for number in (outer,) if shorter else range(len(order), len(edges)):
        edges[number] = replace(edges[number], label=f"{name} {FACED}")
    panel = replace(drafted, edges=tuple(edges), placement=placed)
    return replace(
        pattern,
        panels=(*pattern.panels, panel),
        stitches=(*pattern.stitches, *(Stitch(EdgeRef(name, n), ref) for n, ref in enumerate(order))),
        panel_order=None if pattern.panel_order is None else (*pattern.panel_order, name),
        template={},
    )


def _start(pattern: Pattern, ref: EdgeRef) -> np.ndarray:
    """Where an edge starts [m] (3,), its panel as placed."""
    panel = pattern.panel(ref.panel)
    return panel.placement.apply(panel.vertices[[panel.edges[ref.edge].start]])[0]


ASIDE_M = 0.06  # an opening whose centre is farther from the middle of the body is a limb's
Corner = tuple[str, int]  # panel, and the edge that starts there


class PatternOpening(NamedTuple):
    """An opening of the sewn garment: the edges ``refs`` round it, in the order in which they follow each other, and
    its ``centre`` [m] (3,) in the world, the mean of their middles, panels as placed."""

    refs: tuple[EdgeRef, ...]
    centre: np.ndarray


def openings(pattern: Pattern) -> list[PatternOpening]:
    """Returns the openings of the sewn ``pattern``: closed lines of edges that no stitch holds."""
    place = {}  # from a corner towards the one that stands for all corners sewn together
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
        for corner, other in zip(ends(stitch.first), there, strict=True):
            place[root(corner)] = root(other)
    sewn = partners(pattern)
    left = [ref for ref in pattern.edge_refs() if ref not in sewn]
    rings = []
    while left:
        loop = [left.pop(0)]
        while (following := _from(left, root(ends(loop[-1])[1]), ends, root)) is not None:
            left.remove(following)
            loop.append(following)
        rings.append(PatternOpening(tuple(loop), centre_of(pattern, loop)))
    return rings


def _from(
    left: Sequence[EdgeRef], corner: Corner, ends: Callable[[EdgeRef], list[Corner]], root: Callable[[Corner], Corner]
) -> EdgeRef | None:
    """The edge out of ``left`` that starts at ``corner``."""
    return next((ref for ref in left if root(ends(ref)[0]) == corner), None)


def centre_of(pattern: Pattern, refs: Sequence[EdgeRef]) -> np.ndarray:
    """Returns the mean [m] (3,) of the middles of the edges ``refs`` in the world, panels as placed."""
    panels = [pattern.panel(ref.panel) for ref in refs]
    middles = [
        panel.placement.apply(geometry.edge_points(panel, ref.edge, np.array([0.5])))[0]
        for panel, ref in zip(panels, refs, strict=True)
    ]
    return np.mean(middles, axis=0)


def openings_by_name(pattern: Pattern) -> dict[str, list[PatternOpening]]:
    """Returns the openings of ``pattern`` by the names neck, waist, hem and cuff; armholes without sleeves have none.

    Raises ``InputError`` where they are not those of a top, trousers or a skirt.
    """
    every = openings(pattern)
    middle = [opening for opening in every if abs(opening.centre[0]) < ASIDE_M]
    middle.sort(key=lambda opening: -opening.centre[1])
    aside = [opening for opening in every if abs(opening.centre[0]) >= ASIDE_M]
    if (len(middle), len(aside)) == (2, 2):
        of_neck = {ref.panel for ref in middle[0].refs}
        sleeves = [opening for opening in aside if not of_neck & {ref.panel for ref in opening.refs}]
        return {"neck": middle[:1], "hem": middle[1:], "cuff": sleeves}
    if (len(middle), len(aside)) == (2, 0):
        return {"waist": middle[:1], "hem": middle[1:]}
    low = min(_heights(pattern, middle[-1])) if middle else 0.0
    if (len(middle), len(aside)) == (1, 2) and all(max(_heights(pattern, leg)) < low for leg in aside):
        return {"waist": middle, "hem": aside}
    raise InputError(
        "--style",
        expected="the openings of a top, of a skirt, or of trousers, whose waist is above both hems",
        got=f"{len(middle)} in the middle and {len(aside)} beside it",
        cure="Leave --style out, and draw the lines on paper.",
    )


def _heights(pattern: Pattern, opening: PatternOpening) -> list[float]:
    """The heights [m] at which the edges of ``opening`` start, panels as placed."""
    return [float(_start(pattern, ref)[1]) for ref in opening.refs]


def openings_called(pattern: Pattern, name: str, part: str) -> list[PatternOpening]:
    """Returns the openings of ``pattern`` called ``name``, such as "neck". Raises ``InputError`` where it has none, for
    the part ``part`` of a style, which needs one."""
    by_name = openings_by_name(pattern)
    if not by_name.get(name):
        raise InputError(
            f"--style {part}",
            expected=f"a garment with a {name}",
            got=f"one with {' and '.join(key for key, ones in by_name.items() if ones)}",
            cure="Leave it out.",
        )
    return by_name[name]
