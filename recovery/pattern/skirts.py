"""Skirts with a waistband: an A-line of two panels, and a full circle of two halves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drape.errors import InputError
from recovery.pattern.bands import BAND_SHORTER, sew_band
from recovery.pattern.darts import Dart, sew_darts, waist_pieces, waist_with_darts
from recovery.pattern.design import Assembly, Design
from recovery.pattern.drafting import BACK, FRONT, Drafted, Side, draft
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.tops import FORWARD, STAND_OFF_M, UP
from recovery.pattern.wrapping import Flutes, Tube, draft_round

KAPPA = 4.0 / 3.0 * (np.sqrt(2.0) - 1.0)  # handle of a Bezier quarter circle, 0.03 % off
SMALLEST_DART_M = 0.004


@dataclass(frozen=True)
class SkirtCut:
    """Lengths [m]: ``length_m`` from waistband to hem, ``drop_m`` of the band's upper edge below the waist.

    ``flare_m`` is added to the half width of each panel from hip to hem; a circle starts in ``flutes``.
    """

    name: str
    fabric: str
    length_m: float
    drop_m: float = 0.02
    waist_ease_m: float = 0.0
    hip_ease_m: float = 0.06
    flare_m: float = 0.10
    band_m: float = 0.035
    flutes: int = 9


def a_line(body: BodyMeasurements, cut: SkirtCut) -> Design:
    """An A-line skirt, its sides curved over the hips."""
    top = body.waist_y - cut.drop_m - cut.band_m
    hem_y = top - cut.length_m
    if cut.hip_ease_m < 0.0 or hem_y > body.hip_y - 0.1:
        raise InputError(
            cut.name,
            expected="ease at the hips, and a hem 10 cm below them",
            got=f"{cut.hip_ease_m:.3f} m of ease, a hem {body.hip_y - hem_y:.3f} m below",
            cure="Add ease or length.",
        )
    hip_half = 0.25 * (body.hip_girth + cut.hip_ease_m)
    # What hips have more than the waist, on one side of the body: side seams and two darts behind share it.
    excess = 2.0 * hip_half - 0.5 * (body.girth_at(top) + cut.waist_ease_m)
    wedge = max(excess, 0.0) / 4.0
    rise = top - body.hip_y
    # The side swings up so that the hem stays square to it.
    lift = cut.flare_m**2 / (2.0 * (body.hip_y - hem_y)) + 0.05 * cut.flare_m
    corner = (hip_half + cut.flare_m, hem_y + lift)
    waist = hip_half - wedge
    bend = ((hip_half - 0.02 * wedge, body.hip_y + 0.35 * rise), (waist + 0.35 * wedge, top - 0.3 * rise))
    fall = body.hip_y - corner[1]
    swing = (
        (hip_half + 0.62 * cut.flare_m, corner[1] + fall / 3.0),
        (hip_half + 0.22 * cut.flare_m, body.hip_y - fall / 3.0),
    )
    work = Assembly()
    panels = []
    for label, face, dip, shares, depth, z in (
        ("front", FRONT, 0.008, (), 0.0, body.front_z + STAND_OFF_M),
        ("back", BACK, 0.014, (0.36, 0.68), 0.12, body.back_z - STAND_OFF_M),
    ):
        darts = [Dart(share, wedge, depth) for share in shares] if wedge > SMALLEST_DART_M else []
        right = waist_with_darts("waist_right", (waist, top), (0.0, top - dip), darts)
        left = waist_with_darts(
            "waist_left", (0.0, top - dip), (-waist, top), [replace(d, share=1.0 - d.share) for d in reversed(darts)]
        )
        sides = [
            Side("hem", (-corner[0], corner[1]), ((0.0, hem_y - lift),)),
            Side("side_right", corner, swing),
            Side("hip_right", (hip_half, body.hip_y), bend),
            *right,
            *left,
            Side("hip_left", (-waist, top), tuple((-x, y) for x, y in reversed(bend))),
            Side("side_left", (-hip_half, body.hip_y), tuple((-x, y) for x, y in reversed(swing))),
        ]
        panels.append(work.add(draft(label, sides, rotation=face, z=z)))
        sew_darts(work, panels[-1])
    front, back = panels
    for side, other in (("right", "left"), ("left", "right")):
        for part in ("side", "hip"):
            work.sew(f"{part}_{other}", front, f"{part}_{side}", back, f"{part}_{other}")
    return _banded(work, body, cut, top, front, back, {"hips": cut.hip_ease_m, "waist": cut.waist_ease_m})


def circle(body: BodyMeasurements, cut: SkirtCut) -> Design:
    """A full circle: two half rings whose inner circle is the waist, hung in flutes."""
    top = body.waist_y - cut.drop_m - cut.band_m
    inner = (body.girth_at(top) + cut.waist_ease_m) / (2.0 * np.pi)
    outer = inner + cut.length_m
    if not 0.2 <= cut.length_m <= 0.9:
        raise InputError(
            f"{cut.name}: length_m",
            expected="0.2 to 0.9 m, so that half a circle can be cut from one width of cloth",
            got=f"{cut.length_m:.3f} m",
            cure="Take another length, or an A-line.",
        )
    work = Assembly()
    panels = []
    axis = (0.0, top, 0.5 * (body.front_z + body.back_z))
    for label, turn in (("front", 0.0), ("back", np.pi)):
        sides = [
            Side("hem_left", (-outer, 0.0), ((-outer, -KAPPA * outer), (-KAPPA * outer, -outer))),
            Side("hem_right", (0.0, -outer), ((KAPPA * outer, -outer), (outer, -KAPPA * outer))),
            Side("side_right", (outer, 0.0)),
            Side("waist_right_0", (inner, 0.0), ((inner, -KAPPA * inner), (KAPPA * inner, -inner))),
            Side("waist_left_0", (0.0, -inner), ((-KAPPA * inner, -inner), (-inner, -KAPPA * inner))),
            Side("side_left", (-inner, 0.0)),
        ]
        panels.append(work.add(*draft_round(label, sides, Flutes(axis, inner, outer, cut.flutes, turn))))
    front, back = panels
    for side, other in (("right", "left"), ("left", "right")):
        work.sew(f"side_{other}", front, f"side_{side}", back, f"side_{other}")
    return _banded(work, body, cut, top, front, back, {"waist": cut.waist_ease_m})


def _banded(
    work: Assembly,
    body: BodyMeasurements,
    cut: SkirtCut,
    top: float,
    front: Drafted,
    back: Drafted,
    ease: dict[str, float],
) -> Design:
    order = [(back, "waist_right"), (front, "waist_left"), (front, "waist_right"), (back, "waist_left")]
    edges = [piece for drafted, side in order for piece in waist_pieces(drafted, side)]
    tube = Tube((0.0, top + 0.01, 0.5 * (body.front_z + body.back_z)), UP, FORWARD, body.girth_at(top) / 5.0)
    sew_band(work, "waistband", edges, tube, width_m=cut.band_m, shorter=BAND_SHORTER, above=True)
    return Design(
        work.pattern(cut.name, cut.fabric),
        cut.fabric,
        work.edge_names,
        tuple(work.seam_names),
        wraps=work.wraps,
        eased={"waistband_seam": 1.0 / (1.0 - BAND_SHORTER) - 1.0},
        ease_m=ease,
    )
