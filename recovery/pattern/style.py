"""Style lines of a finished pattern, as its maker draws them: bands and yokes cut off, sleeves joined, a collar added.

The openings of the sewn garment tell where. Cut and joined panels are the same cloth; a collar and ribs are new.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drape.errors import InputError, NotFound
from recovery.pattern import geometry
from recovery.pattern.openings import COLLAR, PatternOpening, centre_of, openings_called, with_collar, with_ribs
from recovery.pattern.pieces import FACED, side_of
from recovery.pattern.sewing_pattern import EdgeKind, EdgeRef, Pattern
from recovery.pattern.split import (
    JOIN_M,
    Chain,
    curves,
    cut_level,
    edges_beside,
    join_panels,
    lay_edge_on,
    partners,
    strips,
)

WIDEST_M = 0.5  # largest width of a part
BANDS = {"waistband": "waist", "neckband": "neck", "cuffs": "cuff", "hemband": "hem"}  # and the openings they are at
YOKES = ("yoke", "front_yoke")
RIBS = {"rib_neck": "neck", "rib_cuffs": "cuff", "rib_hem": "hem"}
RIB_SHORTER = {"neck": 0.12, "cuff": 0.15, "hem": 0.15}  # share by which a rib is shorter than what it holds
PARTS = (*BANDS, *RIBS, *YOKES, COLLAR)


@dataclass(frozen=True)
class Style:
    """The changes that a style makes to a pattern: parts that are cut off or added, by the names of ``PARTS`` with
    their ``widths_m`` [m].

    With ``whole_sleeves`` the halves of a sleeve are joined, and with ``whole_bands`` the pieces of a band, as far as
    their ends lie on each other. A style that changes nothing is false as a bool.
    """

    widths_m: Mapping[str, float]
    whole_sleeves: bool = False
    whole_bands: bool = False

    def __post_init__(self) -> None:
        for name, width in self.widths_m.items():
            if name not in PARTS:
                raise NotFound("--style", expected=f"one of {', '.join(PARTS)}", got=name, cure="Check the name.")
            if not 0.0 < width < WIDEST_M:
                range_m = f"a width in (0, {WIDEST_M:g}) m"
                raise InputError(f"--style {name}", expected=range_m, got=f"{width:g}", cure="Pass metres.")

    def __bool__(self) -> bool:
        return bool(self.widths_m) or self.whole_sleeves  # without widths there are no bands

    def words(self) -> str:
        """Returns the style as a phrase, such as "waistband 4 cm, one-piece sleeves"; empty for none."""
        parts = [f"{name.replace('_', ' ')} {100 * width:.3g} cm" for name, width in self.widths_m.items()]
        parts += ["bands in one piece"] if self.whole_bands else []
        return ", ".join([*parts, *(["one-piece sleeves"] if self.whole_sleeves else [])])


NO_STYLE = Style({})


def add_style_lines(pattern: Pattern, style: Style) -> Pattern:
    """Returns ``pattern`` with the bands and yokes of ``style`` cut off and sewn on again: it drapes as before.

    Yokes come first, so that a neckband is cut off them too. Raises ``InputError`` where the pattern lacks the opening
    of a band, or has no room for a line.
    """
    if (depth := style.widths_m.get("yoke")) is not None:
        pattern = _back_yoke(pattern, depth)
    if (width := style.widths_m.get("front_yoke")) is not None:
        pattern = _front_yoke(pattern, width)
    for name, opening in (BANDS | RIBS).items():
        if (width := style.widths_m.get(name)) is not None:
            pattern = _band(pattern, name, opening, width)
    return pattern


def finish_pattern(pattern: Pattern, style: Style) -> Pattern:
    """Returns ``pattern``, which has its style lines, with sleeves, yokes and bands joined as ``style`` says, and ribs
    and a collar drafted. Raises ``InputError`` for halves of sleeves that it does not have."""
    if style.whole_sleeves:
        pattern = _whole_sleeves(pattern)
    if all(name in style.widths_m for name in YOKES):
        pattern = _whole_yoke(pattern)
    for name in BANDS if style.whole_bands else ():
        pattern = _whole_band(pattern, f"_{name.removesuffix('s')}")
    for name, opening in RIBS.items():
        if (width := style.widths_m.get(name)) is not None:
            pattern = with_ribs(pattern, name, width, RIB_SHORTER[opening])
    if (width := style.widths_m.get(COLLAR)) is not None:
        pattern = with_collar(pattern, width)
    return pattern


# --- bands and yokes -------------------------------------------------------------------------------------------------


def _chains(pattern: Pattern, opening: PatternOpening, word: str) -> list[Chain]:
    """The edges of ``opening``, those of a panel that follow each other together, with names that end in ``word``."""
    runs: list[list[EdgeRef]] = []
    for ref in opening.refs:
        if runs and _follows(pattern, runs[-1][-1], ref):
            runs[-1].append(ref)
        else:
            runs.append([ref])
    if len(runs) > 1 and _follows(pattern, runs[-1][-1], runs[0][0]):
        runs[0] = [*runs.pop(), *runs[0]]
    chains, count = [], {}
    for run in runs:
        panel = run[0].panel
        count[panel] = count.get(panel, 0) + 1
        chains.append(Chain(tuple(run), f"{panel}_{word}" + (f"_{count[panel]}" if count[panel] > 1 else "")))
    return chains


def _follows(pattern: Pattern, ref: EdgeRef, other: EdgeRef) -> bool:
    return ref.panel == other.panel and other.edge == (ref.edge + 1) % len(pattern.panel(ref.panel).edges)


def _band(pattern: Pattern, name: str, opening: str, width_m: float) -> Pattern:
    """``pattern`` with bands at the openings called ``opening``; through darts they are one piece, the darts closed."""
    for place in openings_called(pattern, opening, name):
        chains = _chains(pattern, place, name.removesuffix("s"))
        pattern = strips(_labelled(pattern, place.refs, f"{opening} {FACED}"), chains, width_m)
        for panel in dict.fromkeys(chain.refs[0].panel for chain in chains):
            parts = [chain.called for chain in chains if chain.refs[0].panel == panel]
            while (number := _between(pattern, parts)) is not None:
                ends = pattern.stitches[number].first.panel, pattern.stitches[number].second.panel
                pattern = join_panels(pattern, number, min(ends))
                parts.remove(max(ends))
    return pattern


def _between(pattern: Pattern, parts: Sequence[str]) -> int | None:
    """The number of a straight seam of two of the panels ``parts``."""
    for number, stitch in enumerate(pattern.stitches):
        refs = (stitch.first, stitch.second)
        straight = all(pattern.panel(ref.panel).edges[ref.edge].kind is EdgeKind.LINE for ref in refs)
        if straight and len({ref.panel for ref in refs} & set(parts)) == 2:
            return number
    return None


def _labelled(pattern: Pattern, refs: Sequence[EdgeRef], label: str) -> Pattern:
    """``pattern`` with edges labelled: a band is cut twice, its facing is sewn to it there."""
    panels = []
    for panel in pattern.panels:
        mine = {ref.edge for ref in refs if ref.panel == panel.name}
        edges = tuple(replace(edge, label=label) if n in mine else edge for n, edge in enumerate(panel.edges))
        panels.append(replace(panel, edges=edges))
    return replace(pattern, panels=tuple(panels))


def _back_yoke(pattern: Pattern, depth_m: float) -> Pattern:
    """The back cut level, ``depth_m`` below the lowest point of its neckline."""
    (neck,) = openings_called(pattern, "neck", "yoke")
    backs = {ref.panel for ref in neck.refs if side_of(pattern.panel(ref.panel)) == "back"}
    if len(backs) != 1:
        raise InputError("--style yoke", expected="a back in one piece", got=f"{len(backs)}", cure="Leave it out.")
    name = backs.pop()
    panel = pattern.panel(name)
    edges = [ref.edge for ref in neck.refs if ref.panel == name]
    low = min(geometry.flatten(panel, edge, 1e-4)[:, 1].min() for edge in edges)
    return cut_level(pattern, name, float(low) - depth_m, f"{name}_yoke")


def _front_yoke(pattern: Pattern, width_m: float) -> Pattern:
    """Strips along the shoulders of the fronts."""
    (neck,) = openings_called(pattern, "neck", "front_yoke")
    sewn, chains = partners(pattern), []
    for chain in _chains(pattern, neck, "yoke"):
        if side_of(pattern.panel(chain.refs[0].panel)) == "front":
            chains += [
                Chain((ref,), f"{chain.called}_{n}") for n, ref in enumerate(edges_beside(pattern, chain), start=1)
            ]
    return strips(pattern, [chain for chain in chains if chain.refs[0] in sewn], width_m)


# --- one-piece sleeves and yokes --------------------------------------------------------------------------------------


def _whole_sleeves(pattern: Pattern) -> Pattern:
    """Halves of sleeves, and of their cuffs, as one piece each, joined along the top of the arm."""
    count = 0
    for name in [panel.name for panel in pattern.panels]:
        if not name.startswith("sleeve_") or "_front" not in name:
            continue
        other, called = name.replace("_front", "_back"), name.replace("_front", "")
        seams = [n for n, s in enumerate(pattern.stitches) if {s.first.panel, s.second.panel} == {name, other}]
        if seams:
            pattern = join_panels(pattern, max(seams, key=lambda n: _height(pattern, n)), called)
            count += 1
    if not count:
        raise InputError(
            "--whole-sleeves",
            expected="sleeves in two halves, as in the bases tshirt and sleeved_dress",
            got="none",
            cure="Leave it out.",
        )
    return pattern


def cap_corners_deg(pattern: Pattern) -> dict[str, float]:
    """Returns by the names of one-piece sleeves the largest angle [deg] by which their cap turns at a corner, where
    halves met."""
    sewn, corners = partners(pattern), {}
    for panel in pattern.panels:
        there = [sewn.get(EdgeRef(panel.name, number)) for number in range(len(panel.edges))]
        on_body = [seam is not None and not seam.second.panel.startswith(panel.name) for seam in there]
        if not panel.name.startswith("sleeve_") or sum(on_body) < 2 or "_front" in panel.name or "_back" in panel.name:
            continue
        turns = [0.0]
        for number in np.flatnonzero(on_body & np.roll(on_body, -1)).tolist():
            following = (number + 1) % len(panel.edges)
            a = geometry.edge_tangents(panel, number, np.array([1.0]))[0]
            b = geometry.edge_tangents(panel, following, np.array([0.0]))[0]
            turns.append(float(np.degrees(np.abs(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))))
        corners[panel.name] = max(turns)
    return corners


def _height(pattern: Pattern, number: int) -> float:
    """The height [m] of a seam, panels as placed."""
    stitch = pattern.stitches[number]
    return float(centre_of(pattern, [stitch.first, stitch.second])[1])


def _whole_band(pattern: Pattern, word: str) -> Pattern:
    """The panels whose names end in ``word`` joined where their ends lie on each other, from the front on.

    The seam farthest behind stays, and so does one whose join would lay the piece on itself. What is one piece round
    the whole garment is named after no panel.
    """
    while True:
        seams = []
        for number, stitch in enumerate(pattern.stitches):
            sides = (stitch.first, stitch.second)
            panels = [pattern.panel(ref.panel) for ref in sides]
            if not all(panel.name.endswith(word) for panel in panels) or panels[0] is panels[1]:
                continue
            a, b = (curves(panel)[ref.edge] for panel, ref in zip(panels, sides, strict=True))
            if lay_edge_on(a, b.reversed())[1] <= JOIN_M:
                seams.append((float(centre_of(pattern, sides)[2]), number))
        for _, number in sorted(seams, reverse=True):
            called = pattern.stitches[number].first.panel
            joined = join_panels(pattern, number, called)
            if geometry.first_crossing(geometry.outline(joined.panel(called))) is None:
                pattern = joined
                break
        else:
            left = [panel.name for panel in pattern.panels if panel.name.endswith(word)]
            return _renamed(pattern, left[0], word.removeprefix("_")) if len(left) == 1 else pattern


def _renamed(pattern: Pattern, name: str, called: str) -> Pattern:
    """``pattern`` with the panel ``name`` called ``called``."""

    def now(ref: EdgeRef) -> EdgeRef:
        return replace(ref, panel=called) if ref.panel == name else ref

    panels = tuple(replace(panel, name=called) if panel.name == name else panel for panel in pattern.panels)
    stitches = tuple(replace(s, first=now(s.first), second=now(s.second)) for s in pattern.stitches)
    return replace(pattern, panels=panels, stitches=stitches, panel_order=None)


def _whole_yoke(pattern: Pattern) -> Pattern:
    """The yoke of the back and those of the fronts as one piece, joined at the shoulders.

    Its neckband, if it has one, stays in parts.
    """
    yokes = {panel.name for panel in pattern.panels if "yoke" in panel.name and not panel.name.endswith("band")}
    whole = next(panel.name for panel in pattern.panels if panel.name in yokes and side_of(panel) == "back")
    while True:
        ends = [(stitch.first.panel, stitch.second.panel) for stitch in pattern.stitches]
        number = next((n for n, two in enumerate(ends) if whole in two and set(two) <= {whole, *yokes}), None)
        if number is None:
            return pattern
        if ends[number][0] != whole:
            pattern = _turned(pattern, number)
        pattern, whole = join_panels(pattern, number, "yoke"), "yoke"


def _turned(pattern: Pattern, number: int) -> Pattern:
    """``pattern`` with the edges of one stitch exchanged."""
    stitches = list(pattern.stitches)
    stitches[number] = replace(stitches[number], first=stitches[number].second, second=stitches[number].first)
    return replace(pattern, stitches=tuple(stitches))
