"""Bands: straight strips sewn to an opening, at neck, waist, wrist and hem; closed by one seam."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from recovery.pattern import geometry
from recovery.pattern.design import Assembly
from recovery.pattern.drafting import Drafted, Side, Tube, Vector, draft_round
from recovery.pattern.measurements import BodyMeasurements

WAISTBAND_SHORTER = 0.02  # the waist is eased into it
UP: Vector = (0.0, 1.0, 0.0)
FORWARD: Vector = (0.0, 0.0, 1.0)

Edge = tuple[Drafted, str]


class BandShape(NamedTuple):
    """The measures of a band: a strip called ``name``, ``width_m`` [m] wide, and shorter by the share ``shorter`` than
    the edges that it is sewn to.

    It stands ``above`` these edges, as a waistband does, or hangs below them, as a cuff. ``free`` begins the name of
    its free edge, and ``seam`` is that of its seam, by default the band's own.
    """

    name: str
    width_m: float
    shorter: float
    above: bool
    free: str = "opening"
    seam: str | None = None


def sew_band(assembly: Assembly, band: BandShape, to: Sequence[Edge], tube: Tube) -> Drafted:
    """Adds ``band`` to ``assembly``, sewn to the edges ``to``, which follow each other along the tube's u, and closed
    to a ring by a seam of its own. Returns its panel.

    An edge is a drafted panel and the name of its side. The band starts bent round ``tube``.
    """
    name, width_m, shorter, above, free, seam = band
    lengths = [(1.0 - shorter) * geometry.edge_length(drafted.panel, drafted.numbers[side]) for drafted, side in to]
    total = sum(lengths)
    places = [-0.5 * total]
    for length in lengths:
        places.append(places[-1] + length)
    sewn_v, free_v = (0.0, width_m) if above else (width_m, 0.0)
    wide = 0.5 * total
    if above:
        sides = [Side(f"{name}_{i}", (places[i], sewn_v)) for i in range(len(lengths))]
        sides += [
            Side("end", (places[-1], sewn_v)),
            Side(f"{free}_{name}", (wide, free_v)),
            Side("start", (-wide, free_v)),
        ]
    else:
        sides = [Side(f"{free}_{name}", (-wide, free_v)), Side("end", (wide, free_v))]
        sides += [Side(f"{name}_{i}", (places[i + 1], sewn_v)) for i in reversed(range(len(lengths)))]
        sides += [Side("start", (places[0], sewn_v))]
    seam = seam or f"{name}_seam"
    if shorter:
        assembly.eased[seam] = 1.0 / (1.0 - shorter) - 1.0
    strip = assembly.add(*draft_round(name, sides, tube))
    for number, (drafted, side) in enumerate(to):
        assembly.sew(seam, strip, f"{name}_{number}", drafted, side)
    assembly.sew(f"{name}_closing", strip, "start", strip, "end")
    return strip


def sew_waistband(assembly: Assembly, body: BodyMeasurements, top: float, to: Sequence[Edge], width_m: float) -> None:
    """Adds a band of ``width_m`` [m] to ``assembly``, sewn above the edges ``to``, the waist of a garment at the height
    ``top`` [m]."""
    middle = (0.0, top + 0.01, 0.5 * (body.front_z + body.back_z))
    tube = Tube(middle, UP, FORWARD, body.girth_at(top) / 5.0)
    sew_band(assembly, BandShape("waistband", width_m, WAISTBAND_SHORTER, above=True), to, tube)
