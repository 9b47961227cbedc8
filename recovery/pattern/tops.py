"""Tops that hang from the shoulders: T-shirt, long sleeve, tank, sweat, dress. Front, back, one-piece sleeves, bands.

Sleeves are drawn with the grain along the arm and one seam under it; their caps are as high as the given width at the
upper arm makes them. Drawn for a body in the T-pose, as it stands in the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.bands import FORWARD, UP, BandShape, Edge, sew_band
from recovery.pattern.design import Assembly, Design
from recovery.pattern.drafting import (
    FRONT,
    STAND_OFF_M,
    Drafted,
    Point,
    Side,
    Tube,
    before_and_behind,
    draft,
    draft_round,
    root,
)
from recovery.pattern.measurements import BodyMeasurements

NECK_SLOPE = 0.6
CAP_EASE = 0.015  # a cap is longer than its armhole by this share
NARROWEST_HEM = 0.2  # least hem of a sleeve, as a share of its girth at the upper arm
HOLLOWS = (0.75, 0.6)  # how far towards the shoulder the armhole runs level, in front and behind


@dataclass(frozen=True)
class Sleeve:
    """The measures of a sleeve, lengths [m].

    ``length_m`` runs from the shoulder's tip to the end, band included. ``arm_ease_m`` is what the sleeve is wider than
    the upper arm, ``hem_girth_m`` its girth at the end. ``cuff_m`` is the width of a band that is shorter than the end
    by the share ``cuff_shorter``; 0 for none. With ``halves`` the sleeve is cut in two along the top of the arm,
    without cuffs: its panels start flat.
    """

    length_m: float
    arm_ease_m: float
    hem_girth_m: float
    cuff_m: float = 0.0
    cuff_shorter: float = 0.0
    halves: bool = False


@dataclass(frozen=True)
class TopCut:
    """The measures in which tops differ, lengths [m].

    ``length_m`` runs from the side of the neck to the hem, bands included. The shoulder's tip lies ``shoulder_out_m``
    beyond the joint and ``shoulder_drop_m`` below the neck. The armhole ends ``armhole_drop_m`` below the armpit and
    hollows in by ``armhole_inset``, a share of the width from shoulder to side. The neck's half width is the body's
    plus ``neck_out_m``. Bands of a width of 0 are left out. ``flare_m`` widens each panel's half at the hem. A
    ``skirt_m`` > 0 cuts the garment that far below the armpit and gathers the rest by the share ``gather``. What is
    ``strapless`` ends where armholes would, in an edge that is tight round the chest.
    """

    name: str
    fabric: str
    length_m: float
    chest_ease_m: float
    sleeve: Sleeve | None = None
    shoulder_out_m: float = 0.012
    shoulder_drop_m: float = 0.035
    armhole_drop_m: float = 0.025
    armhole_inset: float = 0.15
    neck_out_m: float = 0.012
    neck_depth_m: float = 0.09
    back_neck_depth_m: float = 0.022
    neck_band_m: float = 0.0
    neck_shorter: float = 0.12
    hem_band_m: float = 0.0
    hem_shorter: float = 0.0
    flare_m: float = 0.0
    skirt_m: float = 0.0
    gather: float = 0.0
    strapless: bool = False

    @property
    def ease_m(self) -> dict[str, float]:
        """Lengths [m] that are added to the body's girths: "chest", and with sleeves "arm"."""
        return {"chest": self.chest_ease_m} | ({"arm": self.sleeve.arm_ease_m} if self.sleeve else {})


def lines(body: BodyMeasurements, cut: TopCut) -> tuple[Point, Point, Point, Point]:
    """Returns the points neck, shoulder tip, armpit and hem [m] of a panel of ``cut`` for ``body``, on the wearer's
    left. Raises ``InputError`` for lines that do not meet."""
    half = 0.25 * (body.chest_girth + cut.chest_ease_m)
    # Beside the neck the body falls away by about NECK_SLOPE.
    neck = (body.neck_half_width + cut.neck_out_m, body.neck_y - NECK_SLOPE * cut.neck_out_m)
    tip = (body.shoulder_x + cut.shoulder_out_m, body.neck_y - cut.shoulder_drop_m)
    underarm = (half, body.underarm_y - cut.armhole_drop_m)
    hem = (half + cut.flare_m, body.neck_y - cut.length_m - body.longer_m + cut.hem_band_m)
    if cut.chest_ease_m < 0.0 or not (neck[0] < tip[0] < half and hem[1] < underarm[1] - 0.05 < tip[1] - 0.1):
        raise InputError(
            cut.name,
            expected="ease, and neck, shoulder, side one outside the other, shoulder, armpit, hem one below the other",
            got=f"x {neck[0]:.3f}, {tip[0]:.3f}, {half:.3f} m; y {tip[1]:.3f}, {underarm[1]:.3f}, {hem[1]:.3f} m",
            cure="Add ease or length, or lessen neck_out_m, shoulder_out_m and armhole_drop_m.",
        )
    return neck, tip, underarm, hem


def top(body: BodyMeasurements, cut: TopCut) -> Design:
    """Returns the top that ``cut`` describes, drafted for ``body``. Raises ``InputError`` where its lines do not
    meet."""
    _, _, underarm, hem = lines(body, cut)
    work = Assembly()
    waist = (underarm[0], underarm[1] - cut.skirt_m)
    lower = "waistline" if cut.skirt_m else ("hemline" if cut.hem_band_m else "hem")
    front, back = bodices = bodices_to(work, body, cut, waist if cut.skirt_m else hem, lower)
    if cut.neck_band_m:
        edges = [(back, "neck_right"), (front, "neck_left"), (front, "neck_right"), (back, "neck_left")]
        tube = Tube((0.0, body.neck_y - 0.02, 0.3 * (body.front_z + body.back_z)), UP, FORWARD, 0.11)
        sew_band(work, BandShape("neckband", cut.neck_band_m, cut.neck_shorter, above=True), edges, tube)
    elif not cut.strapless:
        name_openings(work, bodices, "neck", "opening_neck", "opening_neck")
    if cut.skirt_m:
        _gathered_skirt(work, body, cut, waist, hem[1], bodices)
    if cut.hem_band_m:
        tube = Tube((0.0, hem[1] - cut.hem_band_m, 0.0), UP, (1.0, 0.0, 0.0), 0.26)
        # The strip starts at one side seam.
        edges = [(front, "hemline"), (back, "hemline")]
        sew_band(work, BandShape("hemband", cut.hem_band_m, cut.hem_shorter, above=False, free="hem"), edges, tube)
    return work.design(cut.name, cut.fabric, cut.ease_m)


def bodices_to(
    work: Assembly, body: BodyMeasurements, cut: TopCut, bottom: Point, lower: str, prefix: str = ""
) -> tuple[Drafted, Drafted]:
    """Adds front and back to ``work``, drafted down to ``bottom`` [m] on the wearer's left and sewn, with sleeves if
    ``cut`` has them. Returns both.

    ``lower`` names their lower edges, ``prefix`` begins the names of the panels.
    """
    neck, tip, underarm, _ = lines(body, cut)
    bodices = []
    for (label, face, z), depth, hollow in zip(
        before_and_behind(body), (cut.neck_depth_m, cut.back_neck_depth_m), HOLLOWS, strict=True
    ):
        sides = bodice((neck, tip, underarm, bottom), depth=depth, hollow=hollow, inset=cut.armhole_inset, lower=lower)
        if cut.strapless:
            sides = [sides[0], Side("top_right", underarm), Side("top_left", (0.0, underarm[1])), *sides[-2:]]
        bodices.append(work.add(draft(f"{prefix}{label}", sides, rotation=face, z=z)))
    front, back = bodices
    work.sew_sides(["side"] if cut.strapless else ["side", "shoulder"], front, back)
    if cut.strapless:
        name_openings(work, bodices, "top", "opening_top", "opening_top")
    elif cut.sleeve is not None:
        armholes = {
            side: ((front, f"armhole_{other}"), (back, f"armhole_{side}"))
            for side, other in (("left", "right"), ("right", "left"))
        }
        set_sleeves(work, body, cut.sleeve, tip, armholes)
    else:
        name_openings(work, bodices, "armhole", "opening_armhole_left", "opening_armhole_right")
    return front, back


def bodice(
    corners: tuple[Point, Point, Point, Point], *, depth: float, hollow: float, inset: float, lower: str
) -> list[Side]:
    """Returns the sides of a front or back panel, whose ``corners`` [m] on one side are neck, shoulder tip, underarm
    and hem.

    The neckline is ``depth`` [m] deep. The armhole runs level for the share ``hollow`` of the way to the shoulder, and
    hollows in by ``inset``, a share of the width from shoulder to side; ``lower`` names the hem.
    """
    neck, tip, underarm, hem = corners
    middle = (0.0, neck[1] - depth)
    level = (underarm[0] + hollow * (tip[0] - underarm[0]), underarm[1])
    upright = (tip[0] - inset * (underarm[0] - tip[0]), tip[1] + 0.55 * (underarm[1] - tip[1]))
    right = [
        Side("side_right", hem),
        Side("armhole_right", underarm, (level, upright)),
        Side("shoulder_right", tip),
        Side("neck_right", neck, ((neck[0], neck[1] - 0.6 * depth), (0.55 * neck[0], middle[1]))),
    ]
    left = [
        Side("neck_left", middle, ((-0.55 * neck[0], middle[1]), (-neck[0], neck[1] - 0.6 * depth))),
        Side("shoulder_left", (-neck[0], neck[1])),
        Side("armhole_left", (-tip[0], tip[1]), ((-upright[0], upright[1]), (-level[0], level[1]))),
        Side("side_left", (-underarm[0], underarm[1])),
    ]
    # A flared hem sags in the middle, so that it meets the side seams squarely.
    sag = 0.5 * (hem[0] - underarm[0]) * hem[0] / max(underarm[1] - hem[1], 0.1)
    bend = ((0.0, hem[1] - sag),) if sag > 1e-3 else ()
    return [*right, *left, Side(lower, (-hem[0], hem[1]), bend)]


def name_openings(work: Assembly, bodices: Sequence[Drafted], part: str, left: str, right: str) -> None:
    """Renames the edge ``part`` of each of ``bodices`` to ``left`` on the viewer's left and to ``right`` on the
    right."""
    for panel in bodices:
        work.edge_names[panel.edge(f"{part}_left")] = left
        work.edge_names[panel.edge(f"{part}_right")] = right


# --- sleeves ---------------------------------------------------------------------------------------------------------


def set_sleeves(
    work: Assembly, body: BodyMeasurements, sleeve: Sleeve, tip: Point, armholes: Mapping[str, tuple[Edge, Edge]]
) -> None:
    """Adds two sleeves, and their cuffs, to ``work``, sewn into ``armholes``: by "left" and "right" of the wearer the
    edge in front and the edge behind, each as its panel and the name of its side.

    ``tip`` [m] is the shoulder's tip on the wearer's left. Raises ``InputError`` for a sleeve shorter than its cap or
    narrower than the arm.
    """
    sleeve = replace(sleeve, length_m=sleeve.length_m + body.limbs_longer_m)
    girth = body.arm_girth + sleeve.arm_ease_m
    lengths = [geometry.edge_length(p.panel, p.numbers[side]) for p, side in armholes["left"]]
    height, widths = cap([(1.0 + CAP_EASE) * length for length in lengths], girth)
    long = sleeve.length_m - sleeve.cuff_m
    least = NARROWEST_HEM * girth
    if height > long - 0.02 or girth < 1.02 * body.arm_girth or sleeve.hem_girth_m < least:
        raise InputError(
            "sleeve",
            expected=f"longer than its cap of {height:.3f} m, wider than the arm's {body.arm_girth:.3f} m, a hem of "
            f"{least:.3f} m",
            got=f"{long:.3f} m, {girth:.3f} m, {sleeve.hem_girth_m:.3f} m",
            cure="Lengthen the sleeve or add ease to the arm: a wider sleeve has a lower cap.",
        )
    work.eased["armhole"] = -CAP_EASE / (1.0 + CAP_EASE)
    if sleeve.halves:
        _set_halves(work, body, sleeve, tip, armholes, height, widths)
        return
    hem = 0.5 * sleeve.hem_girth_m
    fore, hind = widths
    sides = [
        Side("cuffline" if sleeve.cuff_m else "hem", (-hem, -long)),
        Side("under_back", (hem, -long)),
        _half_cap("cap_back", hind, height, 1.0),
        _half_cap("cap_front", fore, height, -1.0),
        Side("under_front", (-fore, -height)),
    ]
    for name, sign in (("left", 1.0), ("right", -1.0)):
        axis = (-sign, 0.0, 0.0)
        tube = Tube((sign * tip[0], body.arm_y, body.arm_z), axis, UP, max(girth / 5.9, 0.068))
        piece = work.add(*draft_round(f"sleeve_{name}", sides, tube, flip=sign < 0.0))
        work.sew("armhole", piece, "cap_front", *armholes[name][0])
        work.sew("armhole", piece, "cap_back", *armholes[name][1])
        work.sew(f"underarm_{name}", piece, "under_front", piece, "under_back")
        if sleeve.cuff_m:
            end = Tube((sign * (tip[0] + sleeve.length_m), body.arm_y, body.arm_z), axis, UP, 0.06)
            cuff = BandShape(
                f"cuff_{name}", sleeve.cuff_m, sleeve.cuff_shorter, above=False, free="hem", seam="cuff_seam"
            )
            sew_band(work, cuff, [(piece, "cuffline")], end)


def _set_halves(
    work: Assembly,
    body: BodyMeasurements,
    sleeve: Sleeve,
    tip: Point,
    armholes: Mapping[str, tuple[Edge, Edge]],
    height: float,
    widths: tuple[float, float],
) -> None:
    """The same sleeves cut along the top of the arm: flat halves before and behind it, the weft along the arm."""
    x, y = tip
    depth = body.arm_girth / 6.0 + STAND_OFF_M
    taper = 0.5 * (sum(widths) - sleeve.hem_girth_m)  # the same on both halves, so that their seams are as long
    halves = []
    for (label, face, _), z, width in zip(
        before_and_behind(body), (body.arm_z + depth, body.arm_z - depth), widths, strict=True
    ):
        curve = _half_cap("cap", width, height, -1.0)
        sides = [
            Side("cap", (x, y), tuple((x - down, y + across) for across, down in curve.handles)),
            Side("under", (x + height, y - width)),
            Side("hem", (x + sleeve.length_m, y - width + taper)),
            Side("over", (x + sleeve.length_m, y)),
        ]
        for side in ("left", "right"):
            flip = (side == "left") != (face == FRONT)
            halves.append(work.add(draft(f"sleeve_{side}_{label}", sides, rotation=face, z=z, flip=flip)))
            work.sew("armhole", halves[-1], "cap", *armholes[side][int(label == "back")])
    for front, back in (halves[::2], halves[1::2]):
        for seam in ("over", "under"):
            work.sew(f"{seam}_{front.panel.name}", front, seam, back, seam)


def _half_cap(name: str, width: float, height: float, sign: float) -> Side:
    """Half a cap, down from the top (0, 0) for the front and up to it for the back."""
    low, high = (sign * 0.55 * width, -height), (sign * 0.48 * width, 0.0)
    if sign > 0.0:
        return Side(name, (width, -height), (low, high))
    return Side(name, (0.0, 0.0), (high, low))


def cap(armholes: list[float], girth: float) -> tuple[float, tuple[float, float]]:
    """Returns the height [m] of a sleeve's cap and the widths [m] of its front and back half, with which these are as
    long as ``armholes`` [m] and together as wide as the ``girth`` [m].

    Raises ``InputError`` where the sleeve is wider than the armhole is long.
    """

    def length(width: float, height: float) -> float:
        sides = [_half_cap("cap", width, height, 1.0), Side("back", (0.0, 0.0)), Side("low", (0.0, -height))]
        probe = draft("cap", sides, rotation=FRONT, z=0.0)
        return geometry.edge_length(probe.panel, 0)

    def width(target: float, height: float) -> float:
        return root(lambda value: length(value, height) - target, 1e-3, 2.0 * target)

    def excess(height: float) -> float:
        return sum(width(target, height) for target in armholes) - girth

    low, high = 0.01, 0.9 * min(armholes)
    if excess(low) < 0.0 or excess(high) > 0.0:
        raise InputError(
            "sleeve",
            expected=f"an upper arm of {excess(high) + girth:.3f} to "
            f"{excess(low) + girth:.3f} m for armholes of {sum(armholes):.3f} m",
            got=f"{girth:.3f} m",
            cure="Lower the armhole for a wider sleeve, or take ease from the arm.",
        )
    height = root(excess, low, high)
    fore, hind = (width(target, height) for target in armholes)
    return height, (fore, hind)


# --- gathered skirt --------------------------------------------------------------------------------------------------


def _gathered_skirt(
    work: Assembly, body: BodyMeasurements, cut: TopCut, waist: Point, hem_y: float, bodices: Sequence[Drafted]
) -> None:
    """Front and back of a skirt that hangs from the ``bodices`` at the ``waist``, wider than they are."""
    wide = waist[0] * (1.0 + cut.gather)
    sides = [
        Side("hem", (-wide - cut.flare_m, hem_y)),
        Side("skirt_side_right", (wide + cut.flare_m, hem_y)),
        Side("waist", (wide, waist[1] - 0.01)),
        Side("skirt_side_left", (-wide, waist[1] - 0.01)),
    ]
    pieces = []
    for (label, face, z), above in zip(before_and_behind(body), bodices, strict=True):
        pieces.append(work.add(draft(f"skirt_{label}", sides, rotation=face, z=z)))
        work.sew("waist_seam", above, "waistline", pieces[-1], "waist")
    work.sew_sides(["skirt_side"], *pieces)
    work.eased["waist_seam"] = cut.gather
