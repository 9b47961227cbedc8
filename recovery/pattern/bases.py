"""Base patterns that a recovery begins with: designs without darts and bands, whose panels start flat.

Front and back are drawn as their viewer sees them: the wearer's left is on the right in front and on the left behind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drape.errors import InputError, NotFound
from recovery.pattern.design import Design
from recovery.pattern.dresses import DressCut
from recovery.pattern.dresses import dress as draft_dress
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.model import Pattern
from recovery.pattern.skirts import SkirtCut, fitted
from recovery.pattern.tops import Sleeve, TopCut, top
from recovery.pattern.trousers import LegCut
from recovery.pattern.trousers import trousers as draft_trousers

LONGEST_M = 3.0  # that a setting may be
POSITIVE = ("length", "depth", "girth", "inseam")  # words in the names of settings that are no differences
OF_SLEEVE = "sleeve_"  # begins the names of a sleeve's settings
COUNT, MOST_PANELS = "panels", 12  # the one setting that is a number of pieces


@dataclass(frozen=True)
class Base:
    """A base: the design that ``draft`` makes of ``cut``; ``settings`` names what a caller may set, lengths [m].

    ``gather`` and ``spread`` are shares, ``panels`` a number.
    """

    draft: Callable[[BodyMeasurements, Any], Design]
    cut: TopCut | LegCut | SkirtCut
    settings: tuple[str, ...]

    def __call__(self, body: BodyMeasurements, **settings: float) -> Pattern:
        """The base pattern for ``body``. Raises ``InputError`` for what cannot be worn or made."""
        for name, value in settings.items():
            if name not in self.settings:
                raise NotFound("--set", expected=f"one of {', '.join(self.settings)}", got=name, cure="Check the name.")
            if name == COUNT:
                settings[name] = whole(value)
                continue
            low = 0.0 if any(part in name for part in POSITIVE) else -LONGEST_M
            if not low < value < LONGEST_M:
                range_m = f"a length in ({low:g}, {LONGEST_M:g}) m"
                raise InputError(name, expected=range_m, got=f"{value}", cure="Pass metres.")
        of_cut = {name: value for name, value in settings.items() if not name.startswith(OF_SLEEVE)}
        of_sleeve = {name.removeprefix(OF_SLEEVE): settings[name] for name in settings.keys() - of_cut}
        cut = replace(self.cut, **of_cut)
        if isinstance(cut, TopCut) and cut.sleeve is not None:
            cut = replace(cut, sleeve=replace(cut.sleeve, **of_sleeve))
        return self.draft(body, cut).pattern


OF_TOP = ("length_m", "chest_ease_m", "flare_m", "shoulder_out_m", "shoulder_drop_m", "armhole_drop_m", "neck_out_m")
OF_TOP = (*OF_TOP, "neck_depth_m", "back_neck_depth_m")
OF_SLEEVES = ("sleeve_length_m", "sleeve_arm_ease_m", "sleeve_hem_girth_m")
OF_DRESS = ("waist_ease_m", "waist_drop_m", "hip_ease_m", "gather")
SLEEVE = Sleeve(0.21, 0.07, 0.35, halves=True)
tshirt = Base(
    top,
    TopCut(
        *("tshirt", "jersey", 0.66, 0.10, SLEEVE),
        shoulder_out_m=0.015,
        shoulder_drop_m=0.03,
        armhole_drop_m=0.02,
        neck_out_m=0.015,
        back_neck_depth_m=0.02,
    ),
    (*OF_TOP, *OF_SLEEVES),
)
tank = Base(
    top,
    TopCut(
        *("tank", "rib", 0.64, 0.05),
        shoulder_out_m=-0.03,
        shoulder_drop_m=0.025,
        neck_out_m=0.02,
        neck_depth_m=0.13,
        back_neck_depth_m=0.05,
        armhole_inset=0.08,
    ),
    OF_TOP,
)
DRESS_CUT = DressCut(
    *("dress", "satin", 1.05, 0.08),
    shoulder_out_m=-0.01,
    shoulder_drop_m=0.03,
    armhole_drop_m=0.015,
    neck_out_m=0.02,
    neck_depth_m=0.11,
    flare_m=0.10,
)
dress = Base(draft_dress, DRESS_CUT, (*OF_TOP, *OF_DRESS))
sleeved_dress = Base(
    draft_dress,
    replace(DRESS_CUT, name="sleeved_dress", sleeve=SLEEVE, shoulder_out_m=0.015, armhole_drop_m=0.02),
    (*OF_TOP, *OF_SLEEVES, *OF_DRESS),
)
OF_TUBE = ("length_m", "chest_ease_m", "flare_m", "armhole_drop_m")
tube = Base(top, TopCut("tube", "rib", 0.5, 0.02, armhole_drop_m=0.0, strapless=True), OF_TUBE)
strapless_dress = Base(
    draft_dress,
    replace(DRESS_CUT, name="strapless_dress", chest_ease_m=0.02, armhole_drop_m=0.0, strapless=True),
    (*OF_TUBE, *OF_DRESS),
)
trousers = Base(
    draft_trousers,
    LegCut("trousers", "twill", 0.07, 0.44, rise_drop_m=0.09, band_m=0.0, waist_ease_m=0.01, darts=False),
    ("inseam_m", "rise_drop_m", "waist_ease_m", "hip_ease_m", "hem_girth_m", "knee_girth_m", "crotch_ease_m"),
)
skirt = Base(
    fitted,
    SkirtCut("skirt", "twill", 0.55, drop_m=0.05, waist_ease_m=0.01, flare_m=0.08),
    ("length_m", "drop_m", "waist_ease_m", "hip_ease_m", "flare_m", "spread", COUNT),
)
BASES = {base.cut.name: base for base in (tshirt, tank, dress, sleeved_dress, trousers, skirt, tube, strapless_dress)}


def whole(value: float) -> int:
    """Returns the setting ``value`` as a number of panels. Raises ``InputError`` for a number that no skirt has."""
    if value not in range(2, MOST_PANELS + 1):
        raise InputError(
            COUNT, expected=f"a whole number from 2 to {MOST_PANELS}", got=f"{value:g}", cure="Count the target's."
        )
    return int(value)


def read_values(settings: Sequence[str], option: str = "--set") -> dict[str, float]:
    """Settings as ``option`` of a command line gives them, each NAME=NUMBER, as numbers by name."""
    values = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        try:
            values[key] = float(text)
        except ValueError as error:
            raise InputError(option, expected="NAME=NUMBER", got=setting, cure="Write lengths in metres.") from error
    return values


def base_pattern(name: str, body: BodyMeasurements, settings: Sequence[str] = ()) -> Pattern:
    """The base pattern ``name`` for ``body`` with ``settings`` as a command line gives them, each NAME=NUMBER."""
    return BASES[name](body, **read_values(settings))
