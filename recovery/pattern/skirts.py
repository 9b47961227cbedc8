"""Skirts: an A-line of two panels and a full circle, both with a waistband; a fitted one of any number, without."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery.pattern.bands import sew_waistband
from recovery.pattern.design import Assembly, Design, waist_pieces
from recovery.pattern.drafting import (
    STAND_OFF_M,
    Drafted,
    Flutes,
    Point,
    Side,
    before_and_behind,
    draft,
    draft_round,
    on_ring,
    ring_handles,
)
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.sewing_pattern import PanelPlacement

QUARTER = 0.5 * np.pi
WAIST_DIPS_M = (0.012, 0.018)  # how far the waist of a fitted skirt sinks in the middle, in front and behind
WIDEST_TURN = 0.6  # [rad] of a spread panel's side, beyond which parabolas are no arcs
GORES_DIFFER_M = 0.005  # half of the front's gore is wider than the mean by this, and half of the back's narrower


@dataclass(frozen=True)
class SkirtCut:
    """The measures of a skirt, lengths [m]: ``length_m`` from waistband to hem, ``drop_m`` of the skirt's upper edge
    below the waist, ease that is added to the body's girths, and the width ``band_m`` of the waistband.

    ``flare_m`` is added to the half width of each panel from waist to hem at least; a circle skirt starts as so many
    waves as ``flutes`` says. A fitted skirt has no band and no flutes, and is cut in any number of ``panels``, other
    skirts in two. ``spread`` is the share of the hem's extra width over the waist that slashes in the panels give. The
    side seams give the rest. With 1 the panels are sectors of a ring.
    """

    name: str
    fabric: str
    length_m: float
    drop_m: float = 0.02
    waist_ease_m: float = 0.0
    hip_ease_m: float = 0.06
    flare_m: float = 0.15
    band_m: float = 0.035
    flutes: int = 9
    panels: int = 2
    spread: float = 0.0


def a_line(body: BodyMeasurements, cut: SkirtCut) -> Design:
    """Returns an A-line skirt of two ring sectors: flare is spread over the whole width, and gives the hips their room.
    Raises ``InputError`` without ease at the hips or a hem below them."""
    top = body.waist_y - cut.drop_m - cut.band_m
    waist = 0.25 * (body.girth_at(top) + cut.waist_ease_m)
    hips = 0.25 * (body.hip_girth + cut.hip_ease_m)
    drop = top - body.hip_y
    length = cut.length_m + body.longer_m
    if cut.hip_ease_m < 0.0 or length < drop + 0.1:
        raise InputError(
            cut.name,
            expected="ease at the hips, and a hem 10 cm below them",
            got=f"{cut.hip_ease_m:.3f} m of ease, a hem {length - drop:.3f} m below",
            cure="Add ease or length.",
        )
    half = max((hips - waist) / drop, cut.flare_m / cut.length_m)  # of the sector's angle [rad]
    inner = waist / half
    centre, outer = top + inner, inner + length
    work = Assembly()
    panels = []
    for label, face, z in before_and_behind(body):
        sides = [
            Side("hem", on_ring(centre, outer, -half), ring_handles(centre, outer, -half, half)),
            Side("side_right", on_ring(centre, outer, half)),
            Side("waist_right_0", on_ring(centre, inner, half), ring_handles(centre, inner, half, 0.0)),
            Side("waist_left_0", on_ring(centre, inner, 0.0), ring_handles(centre, inner, 0.0, -half)),
            Side("side_left", on_ring(centre, inner, -half)),
        ]
        panels.append(work.add(draft(label, sides, rotation=face, z=z)))
    front, back = panels
    work.sew_sides(["side"], front, back)
    return _banded(work, body, cut, top, front, back, {"hips": cut.hip_ease_m, "waist": cut.waist_ease_m})


def circle(body: BodyMeasurements, cut: SkirtCut) -> Design:
    """Returns a full circle skirt: two half rings whose inner circle is the waist, hung in flutes.

    It is as long in every size: half a large circle must be cut from one width of cloth. Raises ``InputError`` for
    lengths that cannot be.
    """
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
            Side("hem_left", on_ring(0.0, outer, -QUARTER), ring_handles(0.0, outer, -QUARTER, 0.0)),
            Side("hem_right", on_ring(0.0, outer, 0.0), ring_handles(0.0, outer, 0.0, QUARTER)),
            Side("side_right", on_ring(0.0, outer, QUARTER)),
            Side("waist_right_0", on_ring(0.0, inner, QUARTER), ring_handles(0.0, inner, QUARTER, 0.0)),
            Side("waist_left_0", on_ring(0.0, inner, 0.0), ring_handles(0.0, inner, 0.0, -QUARTER)),
            Side("side_left", on_ring(0.0, inner, -QUARTER)),
        ]
        panels.append(work.add(*draft_round(label, sides, Flutes(axis, inner, outer, cut.flutes, turn))))
    front, back = panels
    work.sew_sides(["side"], front, back)
    return _banded(work, body, cut, top, front, back, {"waist": cut.waist_ease_m})


def panelled_skirt(body: BodyMeasurements, cut: SkirtCut) -> Design:
    """Returns a skirt of ``cut.panels`` panels without band: curved from waist to hips, straight to the hem, wider
    there.

    Two are front and back. More are gores, the first in the middle of the front and the next to the wearer's left. The
    farther behind, the narrower they are, by one width from waist to hem, so that only mirrored gores are alike. Raises
    ``InputError`` without ease at the hips or a hem below them.
    """
    top = body.waist_y - cut.drop_m
    rise, hem = top - body.hip_y, top - cut.length_m - body.longer_m
    if cut.hip_ease_m < 0.0 or rise < 0.0 or hem > body.hip_y - 0.01 or cut.panels < 2:
        raise InputError(
            cut.name,
            expected="ease at the hips, a waist above and a hem below them, two panels or more",
            got=f"{cut.hip_ease_m:.3f} m of ease, {rise:.3f} m above and {body.hip_y - hem:.3f} m below, {cut.panels}",
            cure="Add ease or length, or lessen drop_m.",
        )
    half = 0.5 / cut.panels
    waist, hips = half * (body.girth_at(top) + cut.waist_ease_m), half * (body.hip_girth + cut.hip_ease_m)
    work, panels = Assembly(), []
    for number in range(cut.panels):
        stand, dip = _stand(body, number, cut.panels)
        wider = _wider(number, cut.panels)
        widths = (waist, hips, hips + 4.0 * half * cut.flare_m)
        sides = _spread_panel(widths, (top, body.hip_y, hem), cut.spread, dip=dip, wider=wider)
        drafted = draft(stand.name, sides, rotation=stand.rotation_deg, z=0.0)
        place = PanelPlacement(stand.rotation_deg, (stand.x, drafted.panel.placement.translation_m[1], stand.z))
        panels.append(work.add(replace(drafted, panel=replace(drafted.panel, placement=place))))
    for number, panel in enumerate(panels[1:]):
        for part in ("side", "hip"):
            work.sew(f"{part}_{number}", panels[number], f"{part}_right", panel, f"{part}_left")
    for part in ("side", "hip"):
        work.sew(f"{part}_last", panels[0], f"{part}_left", panels[-1], f"{part}_right")
    return work.design(cut.name, cut.fabric, {"hips": cut.hip_ease_m, "waist": cut.waist_ease_m})


def _spread_panel(
    widths: tuple[float, float, float], heights: tuple[float, float, float], share: float, *, dip: float, wider: float
) -> list[Side]:
    """The sides of a panel whose half ``widths`` at waist, hips and hem, at three ``heights`` [m], are ``wider``.

    Spreading by ``share`` turns what stood upright about one centre above the waist, so that widths grow evenly with
    the depth. The panel is drawn as much narrower before.
    """
    (waist, hips, low), (top, hip_y, hem) = widths, heights
    spread = min(share * max(0.0, low / waist - 1.0) / (top - hem), WIDEST_TURN / waist)  # of the width by depth [1/m]
    hips, low = hips / (1.0 + spread * (top - hip_y)), low / (1.0 + spread * (top - hem))
    at, flare = ((waist + wider, top), (hips + wider, hip_y)), max(0.0, low - hips)
    if spread == 0.0:
        return below_waist(*at, hem, flare=flare, dip=dip, curved=True)
    # A ring has its own dip, and a straight edge would not turn into it.
    sides = below_waist(*at, hem, flare=flare, dip=max(dip * (1.0 - share), 1e-9), curved=True)

    def turned(point: Point) -> Point:
        angle, radius = point[0] * spread, 1.0 / spread + top - point[1]
        return radius * float(np.sin(angle)), top + 1.0 / spread - radius * float(np.cos(angle))

    turned_sides = []
    for side, following in zip(sides, (*sides[1:], sides[0]), strict=True):
        ends = np.array([turned(side.start), turned(following.start)])
        handles = tuple(turned(handle) for handle in side.handles)
        if len(handles) == 1:  # of a parabola, whose middle is kept
            middle = 0.5 * np.array(side.handles[0]) + 0.25 * (np.array(side.start) + np.array(following.start))
            x, y = 2.0 * np.array(turned((float(middle[0]), float(middle[1])))) - 0.5 * ends.sum(axis=0)
            handles = ((float(x), float(y)),)
        turned_sides.append(replace(side, start=turned(side.start), handles=handles))
    return turned_sides


def below_waist(
    waist: Point, hips: Point, hem: float, *, flare: float, dip: float, curved: bool, upper: str = "opening_waist"
) -> list[Side]:
    """Returns the sides of a skirt's panel below the ``waist``, down to the height ``hem`` [m].

    ``waist`` and ``hips`` are points [m] on the viewer's right. The hem is ``flare`` [m] wider on either side, and its
    ends swing up so that it stays square to the sides. The edge called ``upper`` sinks by ``dip`` [m] in the middle;
    from there to the hips the side is ``curved`` or straight.
    """
    (x, top), (wide, hip_y) = waist, hips
    lift = flare * flare / (2.0 * (hip_y - hem)) + 0.05 * flare
    low = (wide + flare, hem + lift)
    rise = top - hip_y
    bend = ((wide, hip_y + 0.45 * rise), (x + 0.4 * (wide - x), top - 0.3 * rise)) if curved else ()
    return [
        Side("hem", (-low[0], low[1]), ((0.0, hem - lift),)),
        Side("side_right", low),
        Side("hip_right", hips, bend),
        Side(upper, waist, ((0.0, top - 2.0 * dip),) if dip else ()),
        Side("hip_left", (-x, top), tuple((-a, b) for a, b in reversed(bend))),
        Side("side_left", (-wide, hip_y)),
    ]


class _Stand(NamedTuple):
    name: str
    rotation_deg: tuple[float, float, float]
    x: float
    z: float


def _stand(body: BodyMeasurements, number: int, count: int) -> tuple[_Stand, float]:
    """Name and place of a skirt's panel round the body, and the dip of its waist [m]."""
    if count == 2:
        label, face, z = before_and_behind(body)[number]
        return _Stand(label, face, 0.0, z), WAIST_DIPS_M[number]
    angle = 2.0 * np.pi * number / count
    radius = body.hip_girth / (2.0 * np.pi) + STAND_OFF_M
    x, z = radius * float(np.sin(angle)), 0.5 * (body.front_z + body.back_z) + radius * float(np.cos(angle))
    dip = float(np.mean(WAIST_DIPS_M)) * (2.0 / count) ** 2  # of an arc that is as much shorter
    return _Stand(f"gore_{number + 1}", (0.0, float(np.degrees(angle)), 0.0), x, z), dip


def _wider(number: int, count: int) -> float:
    """By how much each half of a gore is wider [m] than their mean; the sum over all is zero."""
    return 0.0 if count == 2 else GORES_DIFFER_M * float(np.cos(2.0 * np.pi * number / count))


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
    sew_waistband(work, body, top, edges, cut.band_m)
    return work.design(cut.name, cut.fabric, ease)
