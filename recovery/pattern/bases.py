"""Base patterns drafted from a body's measurements: T-shirt (longer: a dress), trousers, skirt.

Plain blocks without darts, front and back symmetric, panels before and behind the body in the T-pose. Front and
back are drawn as their viewer sees them, so the wearer's left is on the right in front and on the left behind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from scipy.optimize import brentq

from drape.errors import InputError, NotFound
from recovery.pattern import geometry
from recovery.pattern.drafting import BACK, FRONT, Drafted, Point, Side, draft, sew
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.model import Pattern, Stitch

STAND_OFF_M = 0.06  # panels hang this far before and behind the body


def _lengths(**lengths: float) -> None:
    for name, value in lengths.items():
        if not 0.0 < value < 3.0:
            raise InputError(name, expected="a length in (0, 3) m", got=f"{value}", cure="Pass metres.")


def _fits(name: str, cloth_m: float, body_m: float, cure: str) -> None:
    if cloth_m < body_m:
        raise InputError(
            name, expected=f"at least the body's {body_m:.3f} m", got=f"{cloth_m:.3f} m of cloth", cure=cure
        )


# --- T-shirt and dress -----------------------------------------------------------------------------------------------


def tshirt(
    body: BodyMeasurements,
    *,
    length_m: float = 0.66,
    ease_m: float = 0.10,
    sleeve_length_m: float = 0.21,
    sleeve_taper_m: float = 0.02,
    cap_height_m: float = 0.06,
    cap_ease: float = 0.01,
    shoulder_drop_m: float = 0.03,
    armhole_drop_m: float = 0.02,
    neck_ease_m: float = 0.015,
    neck_depth_m: float = 0.09,
    back_neck_depth_m: float = 0.02,
    flare_m: float = 0.0,
    name: str = "tshirt",
) -> Pattern:
    """A T-shirt of six panels: front, back, and sleeves in two halves joined over and under the arm.

    ``length_m`` runs from the side of the neck to the hem: 0.66 a T-shirt, 1.0 a dress, with ``flare_m`` more half
    width at the hem. ``ease_m`` is added to the chest; ``cap_ease`` is the share by which a sleeve's cap is longer than
    its armhole (0.01: eased in, without gathers). ``armhole_drop_m`` lies below the armpit.
    """
    _lengths(
        length_m=length_m,
        sleeve_length_m=sleeve_length_m,
        cap_height_m=cap_height_m,
        neck_depth_m=neck_depth_m,
        back_neck_depth_m=back_neck_depth_m,
    )
    half = 0.25 * (body.chest_girth + ease_m)
    neck = (body.neck_half_width + neck_ease_m, body.neck_y)
    tip = (body.shoulder_x + 0.015, body.neck_y - shoulder_drop_m)
    underarm = (half, body.underarm_y - armhole_drop_m)
    hem = (half + flare_m, body.neck_y - length_m)
    _fits("ease_m", 4.0 * half, body.chest_girth, "Add ease.")
    if not (neck[0] < tip[0] < half and hem[1] < underarm[1] - 0.05 and tip[1] > underarm[1] + 0.05):
        raise InputError(
            "tshirt",
            expected="neck, shoulder and side one outside the other, shoulder, armpit and hem one below the other",
            got=f"x {neck[0]:.3f}, {tip[0]:.3f}, {half:.3f} m; y {tip[1]:.3f}, {underarm[1]:.3f}, {hem[1]:.3f} m",
            cure="Lengthen the garment, add ease, or lessen neck_ease_m, shoulder_drop_m and armhole_drop_m.",
        )
    z = {FRONT: body.front_z + STAND_OFF_M, BACK: body.back_z - STAND_OFF_M}
    front = draft("front", _bodice(neck, tip, underarm, hem, neck_depth_m, 0.75), rotation=FRONT, z=z[FRONT])
    back = draft("back", _bodice(neck, tip, underarm, hem, back_neck_depth_m, 0.6), rotation=BACK, z=z[BACK])
    stitches = []
    for side, other in (("left", "right"), ("right", "left")):
        # The wearer's left is on the viewer's right in front and on the viewer's left behind.
        stitches.append(sew(front, f"side_{other}", back, f"side_{side}"))
        stitches.append(sew(front, f"shoulder_{other}", back, f"shoulder_{side}"))
    halves: dict[tuple[str, str], Drafted] = {}
    widths = []
    for face, bodice in ((FRONT, front), (BACK, back)):
        length = geometry.edge_length(bodice.panel, bodice.numbers["armhole_right"]) * (1.0 + cap_ease)
        width = _cap_width(length, cap_height_m)
        widths.append(width)
        sides = _sleeve(tip, width, cap_height_m, sleeve_length_m, sleeve_taper_m)
        depth = body.arm_girth / 6.0 + STAND_OFF_M
        for side in ("left", "right"):
            label = "front" if face == FRONT else "back"
            flip = (side == "left") != (face == FRONT)
            half_sleeve = draft(
                f"sleeve_{side}_{label}",
                sides,
                rotation=face,
                z=body.arm_z + (depth if face == FRONT else -depth),
                flip=flip,
            )
            halves[side, label] = half_sleeve
            stitches.append(sew(half_sleeve, "cap", bodice, "armhole_left" if flip else "armhole_right"))
    _fits("cap_height_m", sum(widths), 1.02 * body.arm_girth, "Lower the cap or the armhole: the sleeve is too narrow.")
    for side in ("left", "right"):
        for seam in ("over", "under"):
            stitches.append(sew(halves[side, "front"], seam, halves[side, "back"], seam))
    panels = [front, back, *halves.values()]
    return Pattern(name, tuple(drafted.panel for drafted in panels), tuple(stitches), material="jersey")


def _bodice(neck: Point, tip: Point, underarm: Point, hem: Point, neck_depth: float, hollow: float) -> list[Side]:
    """Front or back: ``hollow`` is how far towards the shoulder the armhole runs level."""
    middle = (0.0, neck[1] - neck_depth)
    level = (underarm[0] + hollow * (tip[0] - underarm[0]), underarm[1])
    upright = (tip[0] - 0.15 * (underarm[0] - tip[0]), tip[1] + 0.55 * (underarm[1] - tip[1]))
    right = [
        Side("side_right", hem),
        Side("armhole_right", underarm, (level, upright)),
        Side("shoulder_right", tip),
        Side("neck_right", neck, ((neck[0], neck[1] - 0.6 * neck_depth), (0.55 * neck[0], middle[1]))),
    ]
    left = [
        Side("neck_left", middle, ((-0.55 * neck[0], middle[1]), (-neck[0], neck[1] - 0.6 * neck_depth))),
        Side("shoulder_left", (-neck[0], neck[1])),
        Side("armhole_left", (-tip[0], tip[1]), ((-upright[0], upright[1]), (-level[0], level[1]))),
        Side("side_left", (-underarm[0], underarm[1])),
        Side("hem", (-hem[0], hem[1])),
    ]
    return right + left


def _cap(width: float, height: float) -> Side:
    """The cap of half a sleeve, from the shoulder down to the armpit; level with the cuff at both ends."""
    return Side("cap", (0.0, 0.0), ((0.0, -0.42 * width), (height, -0.55 * width)))


def _cap_width(length: float, height: float) -> float:
    """Half width [m] of the sleeve whose cap has ``length``."""

    def excess(width: float) -> float:
        probe = draft("cap", [_cap(width, height), Side("back", (height, -width))], rotation=FRONT, z=0.0)
        return geometry.edge_length(probe.panel, 0) - length

    if excess(0.02) > 0.0:
        raise InputError(
            "cap_height_m", expected="a cap flatter than its armhole", got=f"{height} m", cure="Lower the cap."
        )
    return _root(excess, 0.02, 2.0 * length)


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-12))  # pyright: ignore[reportArgumentType]


def _sleeve(tip: Point, width: float, cap_height: float, length: float, taper: float) -> list[Side]:
    """Half a sleeve along the arm, the overarm seam level with the shoulder's tip."""
    if not (cap_height < length and taper < 0.8 * width):
        raise InputError(
            "sleeve_length_m",
            expected=f"more than the cap's {cap_height} m, and a taper below {0.8 * width:.3f} m",
            got=f"{length} m and {taper} m",
            cure="Lengthen the sleeve, lower its cap or taper it less.",
        )
    x, y = tip
    cap = _cap(width, cap_height)
    return [
        Side("cap", (x, y), tuple((x + a, y + b) for a, b in cap.handles)),
        Side("under", (x + cap_height, y - width)),
        Side("cuff", (x + length, y - width + taper)),
        Side("over", (x + length, y)),
    ]


# --- trousers --------------------------------------------------------------------------------------------------------


def trousers(
    body: BodyMeasurements,
    *,
    length_m: float | None = None,
    rise_drop_m: float = 0.09,
    waist_ease_m: float = 0.01,
    ease_m: float = 0.07,
    hem_girth_m: float = 0.44,
    crotch_ease_m: float = 0.015,
    name: str = "trousers",
) -> Pattern:
    """Trousers of four panels, without darts, held at ``rise_drop_m`` below the waist.

    ``length_m`` is the inseam's height (to the ankles by default; shorter gives shorts), ``ease_m`` is added to the
    hips.
    """
    top = body.waist_y - rise_drop_m
    crotch = body.crotch_y - crotch_ease_m
    hem = body.ankle_y + 0.02 if length_m is None else crotch - length_m
    _lengths(hem_girth_m=hem_girth_m, inseam_m=crotch - hem, rise_m=top - body.hip_y)
    quarter = 0.25 * (body.hip_girth + ease_m)
    shift = 0.01  # the back is wider by twice this, and so the side seam lies in the middle of the side
    outer = {FRONT: quarter - shift, BACK: quarter + shift}
    inset = {FRONT: 0.008, BACK: 0.028}  # of the middle seam at the top
    top_half = 0.5 * (body.girth_at(top) + waist_ease_m)
    side_inset = 0.5 * (outer[FRONT] + outer[BACK] - inset[FRONT] - inset[BACK] - top_half)
    extension = {FRONT: 0.05 * body.hip_girth, BACK: 0.105 * body.hip_girth}
    hem_width = {FRONT: 0.5 * hem_girth_m - shift, BACK: 0.5 * hem_girth_m + shift}
    # The leg's middle lies under the middle of the front at the crotch; both side seams are alike.
    hem_inset = outer[FRONT] - 0.5 * (outer[FRONT] - extension[FRONT]) - 0.5 * hem_width[FRONT]
    thigh = sum(outer.values()) + sum(extension.values())
    _fits("ease_m", thigh, body.thigh_girth, "Add ease.")
    _fits("hem_girth_m", hem_girth_m, body.calf_girth if hem < body.knee_y else 0.0, "Widen the hem.")
    inner_hem = {face: outer[face] - hem_inset - hem_width[face] for face in (FRONT, BACK)}
    inseam_across = {face: inner_hem[face] + extension[face] for face in (FRONT, BACK)}
    front_height = crotch - hem
    # The back's crotch point is lowered until both inseams are as long.
    squared = front_height**2 + inseam_across[FRONT] ** 2 - inseam_across[BACK] ** 2
    if squared <= 0.0:
        raise InputError(
            "length_m",
            expected="legs long enough for equal inseams",
            got=f"{front_height:.3f} m",
            cure="Lengthen the legs or narrow the hem.",
        )
    point = {FRONT: crotch, BACK: hem + squared**0.5}
    panels: dict[tuple[str, str], Drafted] = {}
    for face, label, z in (
        (FRONT, "front", body.front_z + STAND_OFF_M),
        (BACK, "back", body.back_z - STAND_OFF_M),
    ):
        width, start, low = outer[face], -extension[face], point[face]
        raised = top + (0.015 if face == BACK else 0.0)
        hip = (width, body.hip_y)
        sides = [
            Side("inseam", (start, low)),
            Side("hem", (inner_hem[face], hem)),
            Side("outseam", (width - hem_inset, hem)),
            Side(
                "hip",
                hip,
                ((width, hip[1] + 0.45 * (top - hip[1])), (width - 0.6 * side_inset, top - 0.3 * (top - hip[1]))),
            ),
            Side("waist", (width - side_inset, top)),
            Side(
                "crotch",
                (inset[face], raised),
                ((0.0, low + 0.5 * (raised - low)), (0.05 * start, low)),
            ),
        ]
        for side in ("left", "right"):
            panels[side, label] = draft(
                f"{label}_{side}",
                sides,
                rotation=face,
                z=z,
                flip=(side == "left") != (face == FRONT),
                apart_m=extension[face] + 0.01,  # the crotch points of both legs do not overlap
            )
    stitches: list[Stitch] = []
    for side in ("left", "right"):
        for seam in ("inseam", "outseam", "hip"):
            stitches.append(sew(panels[side, "front"], seam, panels[side, "back"], seam))
    for label in ("front", "back"):
        stitches.append(sew(panels["left", label], "crotch", panels["right", label], "crotch"))
    return Pattern(name, tuple(drafted.panel for drafted in panels.values()), tuple(stitches), material="twill")


# --- skirt -----------------------------------------------------------------------------------------------------------


def skirt(
    body: BodyMeasurements,
    *,
    length_m: float = 0.55,
    waist_drop_m: float = 0.05,
    waist_ease_m: float = 0.01,
    ease_m: float = 0.06,
    flare_m: float = 0.08,
    name: str = "skirt",
) -> Pattern:
    """An A-line skirt of two panels without darts, held ``waist_drop_m`` below the waist.

    ``flare_m`` is added to the half width of each panel from hip to hem, ``ease_m`` to the hips.
    """
    top = body.waist_y - waist_drop_m
    hem_y = top - length_m
    _lengths(length_m=length_m, below_hip_m=body.hip_y - hem_y, above_hip_m=top - body.hip_y)
    top_half = 0.25 * (body.girth_at(top) + waist_ease_m)
    hip_half = 0.25 * (body.hip_girth + ease_m)
    _fits("ease_m", 4.0 * hip_half, body.hip_girth, "Add ease.")
    rise = top - body.hip_y
    # The skirt's side swings up so that the hem stays square to it.
    lift = flare_m * flare_m / (2.0 * (body.hip_y - hem_y)) + 0.05 * flare_m
    panels = []
    for face, label, dip, z in (
        (FRONT, "front", 0.012, body.front_z + STAND_OFF_M),
        (BACK, "back", 0.018, body.back_z - STAND_OFF_M),
    ):
        corner = (hip_half + flare_m, hem_y + lift)
        bend = ((hip_half, body.hip_y + 0.45 * rise), (top_half + 0.4 * (hip_half - top_half), top - 0.3 * rise))
        sides = [
            Side("hem", (-corner[0], corner[1]), ((0.0, hem_y - lift),)),
            Side("side_right", corner),
            Side("hip_right", (hip_half, body.hip_y), bend),
            Side("waist", (top_half, top), ((0.0, top - 2.0 * dip),)),
            Side("hip_left", (-top_half, top), tuple((-x, y) for x, y in reversed(bend))),
            Side("side_left", (-hip_half, body.hip_y)),
        ]
        panels.append(draft(label, sides, rotation=face, z=z))
    front, back = panels
    stitches = [
        sew(front, f"{part}_{side}", back, f"{part}_{other}")
        for side, other in (("left", "right"), ("right", "left"))
        for part in ("side", "hip")
    ]
    return Pattern(name, (front.panel, back.panel), tuple(stitches), material="twill")


BASES: dict[str, Callable[..., Pattern]] = {"tshirt": tshirt, "trousers": trousers, "skirt": skirt}


def base_pattern(name: str, body: BodyMeasurements, settings: Sequence[str] = ()) -> Pattern:
    """The base pattern ``name`` for ``body`` with parameters from ``settings``, each NAME=NUMBER."""
    known = [key for key in (BASES[name].__kwdefaults__ or {}) if key != "name"]
    values = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        if key not in known:
            raise NotFound("--set", expected=f"one of {', '.join(known)}", got=key, cure="Check the name.")
        try:
            values[key] = float(text)
        except ValueError as error:
            raise InputError("--set", expected="NAME=NUMBER", got=setting, cure="Write lengths in metres.") from error
    return BASES[name](body, **values)
