"""Base patterns that a recovery begins with: designs without darts and bands, whose panels start flat.

Front and back are drawn as their viewer sees them: the wearer's left is on the right in front and on the left behind.
A dress is shaped at the waist: bodice and skirt, front and back of each, joined by a seam round it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from drape.errors import InputError, NotFound
from recovery.pattern.design import Assembly, Design
from recovery.pattern.drafting import before_and_behind, draft
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.skirts import SkirtCut, below_waist, panelled_skirt
from recovery.pattern.tops import Sleeve, TopCut, bodices_to, lines, name_openings, top
from recovery.pattern.trousers import LegCut
from recovery.pattern.trousers import trousers as draft_trousers

BETWEEN_M = 0.01  # panels of bodice and skirt start this far from each other
LEAST_M = 0.03  # least distance from underarm to waist, from waist to hips and from hips to hem


@dataclass(frozen=True)
class DressCut(TopCut):
    """The measures of a dress: those of a top, and lengths [m] of the skirt.

    The waist's seam lies ``waist_drop_m`` below the body's waist; there the skirt is wider by the share ``gather``.
    ``waist_ease_m`` and ``hip_ease_m`` are added to the body's girths, ``flare_m`` to each panel's half from hips to
    hem.
    """

    waist_ease_m: float = 0.06
    waist_drop_m: float = 0.0
    hip_ease_m: float = 0.08

    @property
    def ease_m(self) -> dict[str, float]:
        """Lengths [m] that are added to the body's girths: "chest", "waist", "hips", and with sleeves "arm"."""
        return super().ease_m | {"waist": self.waist_ease_m, "hips": self.hip_ease_m}


def draft_dress(body: BodyMeasurements, cut: DressCut) -> Design:
    """Returns the dress that ``cut`` describes, drafted for ``body``. Raises ``InputError`` where its lines do not
    meet, where ease at chest or hips or the gather is below 0, and for a sleeve that ``set_sleeves`` refuses."""
    _, _, underarm, (_, hem) = lines(body, cut)
    seam = body.waist_y - cut.waist_drop_m
    waist, hips = (0.25 * (body.girth_at(seam) + cut.waist_ease_m), 0.25 * (body.hip_girth + cut.hip_ease_m))
    heights = (underarm[1], seam, body.hip_y, hem)
    if min(cut.hip_ease_m, cut.gather) < 0.0 or any(above - below < LEAST_M for above, below in pairwise(heights)):
        raise InputError(
            cut.name,
            expected="ease at the hips, no gather below 0, and underarm, waist, hips, hem one below the other",
            got=f"{cut.hip_ease_m:.3f} m of ease, {cut.gather:g}; y " + ", ".join(f"{y:.3f}" for y in heights) + " m",
            cure="Add ease or length, or change waist_drop_m.",
        )
    work = Assembly()
    bodices = bodices_to(work, body, cut, (waist, seam), "waistline", "bodice_")
    if not cut.strapless:
        name_openings(work, bodices, "neck", "opening_neck", "opening_neck")
    below = seam - BETWEEN_M
    sides = below_waist(
        (waist * (1.0 + cut.gather), below),
        (hips, body.hip_y),
        hem,
        flare=cut.flare_m,
        dip=0.0,
        curved=False,
        upper="waist",
    )
    skirts = []
    for (label, face, z), above in zip(before_and_behind(body), bodices, strict=True):
        skirts.append(work.add(draft(f"skirt_{label}", sides, rotation=face, z=z)))
        work.sew("waist_seam", above, "waistline", skirts[-1], "waist")
    work.sew_sides(["side", "hip"], *skirts)
    if cut.gather:
        work.eased["waist_seam"] = cut.gather
    return work.design(cut.name, cut.fabric, cut.ease_m)


LONGEST_M = 3.0  # largest length of a setting
POSITIVE = ("length", "depth", "girth", "inseam")  # words in the names of settings that are no differences
OF_SLEEVE = "sleeve_"  # begins the names of a sleeve's settings
COUNT, MOST_PANELS = "panels", 12  # the one setting that is a number of pieces


@dataclass(frozen=True)
class Base:
    """A base: the function ``draft`` from a body and a cut to a design, the ``cut`` that it has by default, and the
    names ``settings`` of the numbers of the cut that a caller may set.

    Settings are lengths [m], but ``gather`` and ``spread`` are shares, and ``panels`` is a number of pieces.
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
    panelled_skirt,
    SkirtCut("skirt", "twill", 0.55, drop_m=0.05, waist_ease_m=0.01, flare_m=0.08),
    ("length_m", "drop_m", "waist_ease_m", "hip_ease_m", "flare_m", "spread", COUNT),
)
BASES = {base.cut.name: base for base in (tshirt, tank, dress, sleeved_dress, trousers, skirt, tube, strapless_dress)}


def whole(value: float) -> int:
    """Returns ``value`` of the setting ``panels`` as an integer. Raises ``InputError`` for a number that no skirt
    has."""
    if value not in range(2, MOST_PANELS + 1):
        raise InputError(
            COUNT, expected=f"a whole number from 2 to {MOST_PANELS}", got=f"{value:g}", cure="Count the target's."
        )
    return int(value)


def read_values(settings: Sequence[str], option: str = "--set") -> dict[str, float]:
    """Returns ``settings`` of a command line, each NAME=NUMBER, as numbers by name. Raises ``InputError``, which names
    ``option``, for other text."""
    values = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        try:
            values[key] = float(text)
        except ValueError as error:
            raise InputError(option, expected="NAME=NUMBER", got=setting, cure="Write lengths in metres.") from error
    return values


def base_pattern(name: str, body: BodyMeasurements, settings: Sequence[str] = ()) -> Pattern:
    """Returns the base called ``name`` drafted for ``body`` with ``settings`` of a command line, each NAME=NUMBER.
    Raises ``InputError`` for what cannot be worn or made."""
    return BASES[name](body, **read_values(settings))
