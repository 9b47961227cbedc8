"""Base patterns that a recovery begins with: designs without darts and bands, whose panels start flat.

Front and back are drawn as their viewer sees them: the wearer's left is on the right in front and on the left behind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drape.errors import InputError, NotFound
from recovery.pattern.design import Design
from recovery.pattern.legs import LegCut
from recovery.pattern.legs import trousers as draft_trousers
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.model import Pattern
from recovery.pattern.skirts import SkirtCut, fitted
from recovery.pattern.tops import Sleeve, TopCut, top

LONGEST_M = 3.0  # that a setting may be
POSITIVE = ("length", "depth", "girth", "inseam")  # words in the names of settings that are no differences
OF_SLEEVE = "sleeve_"  # begins the names of a sleeve's settings


@dataclass(frozen=True)
class Base:
    """A base: the design that ``draft`` makes of ``cut``; ``settings`` names the lengths [m] that a caller may set."""

    draft: Callable[[BodyMeasurements, Any], Design]
    cut: TopCut | LegCut | SkirtCut
    settings: tuple[str, ...]

    def __call__(self, body: BodyMeasurements, **settings: float) -> Pattern:
        """The base pattern for ``body``. Raises ``InputError`` for what cannot be worn or made."""
        for name, value in settings.items():
            if name not in self.settings:
                raise NotFound("--set", expected=f"one of {', '.join(self.settings)}", got=name, cure="Check the name.")
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


tshirt = Base(
    top,
    TopCut(
        *("tshirt", "jersey", 0.66, 0.10, Sleeve(0.21, 0.07, 0.35, halves=True)),
        shoulder_out_m=0.015,
        shoulder_drop_m=0.03,
        armhole_drop_m=0.02,
        neck_out_m=0.015,
        back_neck_depth_m=0.02,
    ),
    (
        *("length_m", "chest_ease_m", "flare_m", "shoulder_out_m", "shoulder_drop_m", "armhole_drop_m"),
        *("neck_out_m", "neck_depth_m", "back_neck_depth_m"),
        *("sleeve_length_m", "sleeve_arm_ease_m", "sleeve_hem_girth_m"),
    ),
)
trousers = Base(
    draft_trousers,
    LegCut("trousers", "twill", 0.07, 0.44, rise_drop_m=0.09, band_m=0.0, waist_ease_m=0.01, darts=False),
    ("inseam_m", "rise_drop_m", "waist_ease_m", "hip_ease_m", "hem_girth_m", "crotch_ease_m"),
)
skirt = Base(
    fitted,
    SkirtCut("skirt", "twill", 0.55, drop_m=0.05, waist_ease_m=0.01, flare_m=0.08),
    ("length_m", "drop_m", "waist_ease_m", "hip_ease_m", "flare_m"),
)
BASES = {base.cut.name: base for base in (tshirt, trousers, skirt)}


def base_pattern(name: str, body: BodyMeasurements, settings: Sequence[str] = ()) -> Pattern:
    """The base pattern ``name`` for ``body`` with ``settings`` as a command line gives them, each NAME=NUMBER."""
    values = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        try:
            values[key] = float(text)
        except ValueError as error:
            raise InputError("--set", expected="NAME=NUMBER", got=setting, cure="Write lengths in metres.") from error
    return BASES[name](body, **values)
