"""Pieces that are drafted to the openings of a finished pattern and were neither draped nor fitted: collar and ribs.

Each is a straight strip, sewn edge by edge to an opening. It stands or hangs from there when the pattern is draped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recovery.pattern import geometry
from recovery.pattern.drafting import Side, draft
from recovery.pattern.model import EdgeRef, Pattern, Stitch
from recovery.pattern.openings import Opening, openings, openings_called
from recovery.pattern.pieces import FACED

COLLAR = "collar"
COLLAR_LEAN_M = 0.01  # by which each end of a collar's outer edge is longer: its points


def with_collar(pattern: Pattern, width_m: float) -> Pattern:
    """``pattern`` with a straight collar as long as its neckline, open in the middle of the front, sewn to it.

    Nothing turns it over when it is draped. Its ends lean outward.
    """
    (neck,) = openings_called(pattern, "neck", COLLAR)
    return _with_strip(
        pattern, neck, COLLAR, width_m, shorter=0.0, starts=lambda place: (round(place[2], 3), -place[1])
    )


def with_ribs(pattern: Pattern, name: str, width_m: float, shorter: float) -> Pattern:
    """``pattern`` whose bands ``name``, which were cut off, are straight ribs, closed to rings.

    A rib is ``shorter`` by that share than what it is sewn to, and its seam is at the back of a neck, below an arm,
    at the side of a hem.
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
        stitches=tuple(one for one in pattern.stitches if not {one.first.panel, one.second.panel} & bands),
        panel_order=None,
    )
    rings = [one for one in openings(pattern) if set(one.refs) & held]
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
    opening: Opening,
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
