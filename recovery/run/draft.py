"""A base drafted near its target: its settings read off where openings lie, how long they are, and off girths between.

Cloth hangs off the skin and dips over shoulders, so these are centimetres off. Grading and search begin there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drape.errors import InputError
from drape.garment.contours import TRUNK
from recovery.pattern.bases import BASES, COUNT, OF_SLEEVE
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.tops import NECK_SLOPE
from recovery.pattern.trousers import thigh_girth
from recovery.run.cut import BodyOpening, SeenGarment

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)  # ways from a base's own settings to those read off the target
BELOW_UNDERARM_M = 0.05  # where the chest's girth is taken, clear of armholes
SIDES = 0.95  # a neckline beyond this share of its half width lies beside the neck
OVER_CHEST_M, OVER_BACK_M = 0.05, 0.03  # cloth is longer than it is high by this, over shoulder and chest or back
PULLED_M = 0.02  # towards the neck, of a sleeve that hangs from the shoulder
UNDER_ARM_M = 0.03  # the arm lifts the end of an armhole above its cut by this
ARMS = (0.25, 0.5, 0.75)  # where along the upper arm a sleeve's girth is taken: the first place clear of the trunk
MOST_SLEEVE = 1.8  # a girth of more than this times the arm's is that of sleeve and trunk
WAISTS_M = 0.01  # between heights at which a waist is looked for
GATHERS_M = 0.02  # half the height in which a gathered seam widens the cloth
LEAST_GATHER = 0.12  # share by which it does so at least
CLEAR_M = 0.08  # least distance of a waist from underarm and hips, and of a hem from the knee
SHAPED = 0.04  # share by which a girth between openings is off the straight line, so that the cut has a bend there
Range = tuple[float, float]
RANGES: dict[str, Range] = {  # that a reading may lie in; beyond it something else was read
    "length_m": (0.3, 1.6),
    "chest_ease_m": (0.01, 0.5),
    "flare_m": (0.0, 0.6),
    "shoulder_out_m": (-0.09, 0.05),
    "armhole_drop_m": (-0.02, 0.12),
    "neck_out_m": (0.0, 0.07),
    "neck_depth_m": (0.04, 0.25),
    "back_neck_depth_m": (0.01, 0.2),
    "sleeve_length_m": (0.09, 0.7),
    "sleeve_arm_ease_m": (0.015, 0.3),
    "sleeve_hem_girth_m": (0.12, 0.8),
    "waist_ease_m": (-0.1, 0.5),
    "waist_drop_m": (-0.15, 0.1),
    "gather": (0.0, 0.8),
    "hip_ease_m": (0.0, 0.8),
    "inseam_m": (0.03, 0.9),
    "rise_drop_m": (-0.02, 0.2),
    "hem_girth_m": (0.2, 1.5),
    "knee_girth_m": (0.25, 1.2),
    "drop_m": (-0.05, 0.2),
    "spread": (0.0, 1.0),
}


def draft_near(
    name: str, body: BodyMeasurements, seen: SeenGarment, given: dict[str, float]
) -> tuple[Pattern, dict[str, float]]:
    """Returns the base ``name`` for ``body``, drafted near the target ``seen``, and the settings by name that it was
    drafted with. Those in ``given`` stay as they are.

    If the settings that are read off the target make no garment, they go a share of the way from the base's own ones.
    Raises ``InputError`` if the base's own ones make none with ``given`` either.
    """
    base = BASES[name]
    readings = {key: value for key, value in read_settings(name, body, seen).items() if key not in given}
    refused: list[InputError] = []
    for share in SHARES:
        settings = {key: own + share * (readings[key] - own) for key, own in own_settings(name, body, readings).items()}
        try:
            return base(body, **settings, **given), settings | given
        except InputError as error:
            refused.append(error)
    raise refused[-1]


def own_settings(name: str, body: BodyMeasurements, readings: dict[str, float]) -> dict[str, float]:
    """Returns by name the base's own values of the settings that ``readings`` has, for the base called ``name``.

    Where the base has None, "knee_girth_m" is that of ``readings``, and "inseam_m" reaches to the ankles of ``body``.
    """
    cut = BASES[name].cut
    ankles = body.crotch_y - body.ankle_y  # an inseam of None
    settings = {}
    for key in readings:
        part = getattr(cut, "sleeve", None) if key.startswith(OF_SLEEVE) else cut
        value = getattr(part, key.removeprefix(OF_SLEEVE))
        unset = readings[key] if key == "knee_girth_m" else ankles
        settings[key] = unset if value is None else float(value)
    return settings


def read_settings(name: str, body: BodyMeasurements, seen: SeenGarment) -> dict[str, float]:
    """Returns by name the settings of the base ``name`` that can be read off the target ``seen`` on ``body``, each held
    within ``RANGES``."""
    reader = {"trousers": _of_trousers, "skirt": _of_skirt}.get(name, _of_top)
    readings = reader(body, seen, BASES[name].settings)
    return {
        key: float(np.clip(value, *RANGES[key]))
        for key, value in readings.items()
        if key in BASES[name].settings and value is not None and key != COUNT
    }


Readings = dict[str, float | None]  # settings by name, None where the target does not show one


def _of_top(body: BodyMeasurements, seen: SeenGarment, settings: tuple[str, ...]) -> Readings:
    neck, hem = seen.openings[TRUNK][0], seen.openings[TRUNK][-1]
    wide = float(np.abs(neck.points[:, 0] - neck.centre[0]).max())
    out = wide - body.neck_half_width
    beside = body.neck_y - NECK_SLOPE * out
    front = neck.points[neck.points[:, 2].argmax()]
    shoulder = neck.points[np.abs(neck.points[:, 0] - neck.centre[0]) > SIDES * wide].mean(axis=0)
    back = neck.points[neck.points[:, 2].argmin()]
    strapless = "neck_depth_m" not in settings
    measures: Readings = {
        "length_m": body.neck_y - float(hem.centre[1]) + (0.0 if strapless else OVER_CHEST_M),
        "neck_out_m": out,
        "neck_depth_m": float(np.hypot(*(front - shoulder)[1:])),
        "back_neck_depth_m": beside - float(back[1]) + OVER_BACK_M,
    }
    arms = [opening for part in ("left_arm", "right_arm") for opening in seen.openings.get(part, ())]
    if "sleeve_length_m" in settings:
        measures |= _of_sleeves(body, seen, arms)
        low = body.underarm_y
    elif strapless:
        low = float(neck.points[:, 1].min()) - BELOW_UNDERARM_M  # planes across tilted bones are clear of the edge
        measures["armhole_drop_m"] = body.underarm_y - float(neck.centre[1])
    else:
        tops = [arm.points[arm.points[:, 1].argmax()] for arm in arms]
        measures["shoulder_out_m"] = float(np.mean([abs(point[0]) for point in tops])) - body.shoulder_x
        low = float(np.mean([arm.points[:, 1].min() for arm in arms]))
        measures["armhole_drop_m"] = body.underarm_y - low + UNDER_ARM_M
    chest = _ease(seen, low - BELOW_UNDERARM_M, lambda y: body.chest_girth)
    measures["chest_ease_m"] = chest
    upper = 0.25 * (body.chest_girth + (chest or 0.0))
    if "waist_drop_m" in settings:
        waist, measures["gather"] = waist_gather(body, seen, low)
        drawn = waist - (OVER_CHEST_M if measures["gather"] else 0.0)
        measures["waist_drop_m"] = body.waist_y - drawn
        measures["waist_ease_m"] = _ease(
            seen, waist + (GATHERS_M if measures["gather"] else 0.0), lambda y: body.girth_at(drawn)
        )
        measures["hip_ease_m"] = hips = _ease(seen, body.hip_y, lambda y: body.hip_girth)
        upper = 0.25 * (body.hip_girth + max(0.0, hips or 0.0))
    measures["flare_m"] = 0.25 * hem.contour.length_m - upper
    return measures


def _of_sleeves(body: BodyMeasurements, seen: SeenGarment, arms: list[BodyOpening]) -> Readings:
    reach = float(np.mean([arm.along_m for arm in arms]))  # beyond the joint, where the shoulder's tip lies about
    hem = float(np.mean([arm.contour.length_m for arm in arms]))
    there = [
        seen.girth(part, 0, sign * (body.shoulder_x + share * (body.elbow_x - body.shoulder_x)))
        for share in ARMS
        for part, sign in (("left_arm", 1.0), ("right_arm", -1.0))
    ]
    girth = next((girth for girth in there if girth is not None and girth < MOST_SLEEVE * body.arm_girth), None)
    return {
        "sleeve_length_m": reach + PULLED_M,
        "sleeve_hem_girth_m": hem,
        "sleeve_arm_ease_m": None if girth is None else girth - body.arm_girth,
    }


def _of_trousers(body: BodyMeasurements, seen: SeenGarment, settings: tuple[str, ...]) -> Readings:
    waist = seen.openings[TRUNK][0]
    legs = [opening for part in ("left_leg", "right_leg") for opening in seen.openings.get(part, ())]
    top, low = float(waist.centre[1]), float(np.mean([leg.centre[1] for leg in legs]))
    hips = _ease(seen, body.hip_y, lambda y: body.hip_girth)
    hem = float(np.mean([leg.contour.length_m for leg in legs]))
    return {
        "rise_drop_m": body.waist_y - top,
        "waist_ease_m": waist.contour.length_m - body.girth_at(top),
        "hip_ease_m": hips,
        "inseam_m": body.crotch_y - low,
        "hem_girth_m": hem,
        "knee_girth_m": _knee(body, seen, thigh_girth(body, hips or 0.0), hem, low),
    }


def _knee(body: BodyMeasurements, seen: SeenGarment, thigh: float, hem: float, low: float) -> float | None:
    """The girth [m] of legs at the knee; None where they end above it or go straight from ``thigh`` to ``hem``.

    Their hem lies at the height ``low``.
    """
    there = [girth for part in ("left_leg", "right_leg") if (girth := seen.girth(part, 1, body.knee_y)) is not None]
    if low > body.knee_y - CLEAR_M or not there:
        return None
    straight = float(np.interp(body.knee_y, (low, body.crotch_y), (hem, thigh)))
    knee = float(np.mean(there))
    return knee if abs(knee / straight - 1.0) > SHAPED else None


def _of_skirt(body: BodyMeasurements, seen: SeenGarment, settings: tuple[str, ...]) -> Readings:
    waist, hem = seen.openings[TRUNK][0], seen.openings[TRUNK][-1]
    top = float(waist.centre[1])
    hips, low = _ease(seen, body.hip_y, lambda y: body.hip_girth), float(hem.centre[1])
    even = float(np.interp(body.hip_y, (low, top), (hem.contour.length_m, waist.contour.length_m)))
    return {
        "drop_m": body.waist_y - top,
        "length_m": top - low,
        "waist_ease_m": waist.contour.length_m - body.girth_at(top),
        "hip_ease_m": hips,
        "flare_m": 0.25 * (hem.contour.length_m - body.hip_girth - max(0.0, hips or 0.0)),
        # A skirt that widens evenly was spread over its width; one that is wider at the hips was cut to them.
        "spread": None if hips is None or hips + body.hip_girth > (1.0 + SHAPED) * even else 1.0,
    }


def _ease(seen: SeenGarment, y: float, girth: Callable[[float], float]) -> float | None:
    """The cloth's girth [m] less the body's at the height ``y`` [m]; None where no cloth goes round."""
    around = seen.girth(TRUNK, 1, y)
    return None if around is None else around - girth(y)


def waist_gather(body: BodyMeasurements, seen: SeenGarment, low: float) -> tuple[float, float]:
    """Returns the height [m] of the waist's seam, below armholes that end at the height ``low`` [m], and the share of
    cloth gathered there, 0 for none.

    A gathered seam is where the girth grows at once; without one the waist is where the cloth is narrowest.
    """
    heights = np.arange(body.hip_y + CLEAR_M, low - GATHERS_M, WAISTS_M)
    girths = {y: girth for y in heights.tolist() if (girth := seen.girth(TRUNK, 1, y)) is not None}
    jumps = {}
    for y in girths:
        above, below = (seen.girth(TRUNK, 1, y + way) for way in (GATHERS_M, -GATHERS_M))
        if above is not None and below is not None:
            jumps[y] = below / above - 1.0
    seam = max(jumps, key=lambda y: jumps[y], default=body.waist_y)
    if jumps.get(seam, 0.0) >= LEAST_GATHER:
        return seam, jumps[seam]
    narrow = {y: girth for y, girth in girths.items() if y < low - CLEAR_M}
    return min(narrow, key=lambda y: narrow[y], default=body.waist_y), 0.0
