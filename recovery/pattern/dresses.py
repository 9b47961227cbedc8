"""Dresses shaped at the waist: bodice and skirt, front and back of each, joined by a seam round the waist."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from drape.errors import InputError
from recovery.pattern.design import Assembly, Design
from recovery.pattern.drafting import before_and_behind, draft
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.skirts import below_waist
from recovery.pattern.tops import TopCut, bodices_to, lines, name_openings

BETWEEN_M = 0.01  # panels of bodice and skirt start this far from each other
LEAST_M = 0.03  # from underarm to waist, from waist to hips and from hips to hem


@dataclass(frozen=True)
class DressCut(TopCut):
    """A top's measures, and lengths [m] of the skirt.

    The waist's seam lies ``waist_drop_m`` below the body's waist; there the skirt is wider by the share ``gather``.
    ``flare_m`` is added to each panel's half from hips to hem.
    """

    waist_ease_m: float = 0.06
    waist_drop_m: float = 0.0
    hip_ease_m: float = 0.08

    @property
    def ease_m(self) -> dict[str, float]:
        """Lengths [m] that are added to the body's girths."""
        return super().ease_m | {"waist": self.waist_ease_m, "hips": self.hip_ease_m}


def dress(body: BodyMeasurements, cut: DressCut) -> Design:
    """The dress that ``cut`` describes, for ``body``. Raises ``InputError`` where its lines do not meet."""
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
