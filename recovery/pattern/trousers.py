"""Trousers and shorts: four panels, a dart in each, and a waistband that the hips carry.

The leg's middle lies under the middle of the front at the crotch; side seams of front and back are alike, and the
back's crotch point is lowered until both inseams are as long.
"""

from __future__ import annotations

from dataclasses import dataclass

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.bands import sew_waistband
from recovery.pattern.design import Assembly, Dart, Design, sew_darts, waist_pieces, waist_with_darts
from recovery.pattern.drafting import FRONT, Drafted, Point, Side, before_and_behind, draft, root
from recovery.pattern.measurements import BodyMeasurements

SHIFT_M = 0.01  # the back is wider by twice this, and so the side seam lies in the middle of the side
EXTENSION = {"front": 0.05, "back": 0.105}  # how far the crotch reaches beyond the middle, as shares of the hips
INSET_M = {"front": 0.008, "back": 0.028}  # how far the top of the middle seam lies inward
BACK_RISE_M = 0.015  # the back's middle stands higher
DART_SHARE = {"front": 0.15, "back": 0.35}
DART_DEPTH_M = {"front": 0.08, "back": 0.11}
SMALLEST_DART_M = 0.004
ABOVE_ANKLE_M = 0.02


@dataclass(frozen=True)
class LegCut:
    """The measures of trousers and shorts, lengths [m].

    ``rise_drop_m`` is how far the waistband's upper edge lies below the waist. With an ``inseam_m`` of None legs end at
    the ankles. ``knee_girth_m`` and ``hem_girth_m`` are girths of the cloth; shorts have None at the knee.
    ``waist_ease_m`` is negative where the band is to sit tight; a ``band_m`` of 0 leaves the band out. Without
    ``darts`` the side seams take in the whole difference of hips and waist.
    """

    name: str
    fabric: str
    hip_ease_m: float
    hem_girth_m: float
    knee_girth_m: float | None = None
    inseam_m: float | None = None
    rise_drop_m: float = 0.05
    crotch_ease_m: float = 0.015
    band_m: float = 0.04
    waist_ease_m: float = 0.0
    darts: bool = True


def trousers(body: BodyMeasurements, cut: LegCut) -> Design:
    """Returns the trousers or shorts that ``cut`` describes, drafted for ``body``. Raises ``InputError`` where a leg is
    narrower than the body's."""
    lines = _LegLines(body, cut)
    low = {"front": lines.crotch, "back": _equal_inseam(lines)}
    work = Assembly()
    panels: dict[tuple[str, str], Drafted] = {}
    for label, face, z in before_and_behind(body):
        outline = lines.sides(label, low[label])
        for side in ("left", "right"):
            panels[side, label] = work.add(
                draft(
                    f"{label}_{side}",
                    outline,
                    rotation=face,
                    z=z,
                    flip=(side == "left") != (face == FRONT),
                    apart_m=0.01 - min(point.start[0] for point in outline),  # the legs do not overlap
                )
            )
    below = (
        ["inseam", "outseam"] if cut.knee_girth_m is None else ["inseam", "inseam_lower", "outseam", "outseam_lower"]
    )
    for side in ("left", "right"):
        for seam in (*below, "hip"):
            work.sew(f"{seam}_{side}", panels[side, "front"], seam, panels[side, "back"], seam)
    for panel in panels.values():
        sew_darts(work, panel)
    for label in ("front", "back"):
        work.sew(f"crotch_{label}", panels["left", label], "crotch", panels["right", label], "crotch")
    if cut.band_m:
        order = [("right", "back"), ("right", "front"), ("left", "front"), ("left", "back")]
        pieces = [piece for key in order for piece in waist_pieces(panels[key], "waist")]
        sew_waistband(work, body, lines.top, pieces, cut.band_m)
    return work.design(cut.name, cut.fabric, {"hips": cut.hip_ease_m, "waist": cut.waist_ease_m})


def thigh_girth(body: BodyMeasurements, hip_ease_m: float) -> float:
    """Returns the girth [m] of the cloth of a leg at the crotch, in trousers with ``hip_ease_m`` [m] at the hips."""
    return 0.5 * (body.hip_girth + hip_ease_m) + sum(EXTENSION.values()) * body.hip_girth


class _LegLines:
    """The lines of a leg of ``cut`` for ``body``, drawn with the body's middle at x = 0 and its side to the right [m].

    ``outer`` is the width to the side and ``reach`` the way of the crotch's point beyond the middle, in front and
    behind; ``middle`` is that of the leg in front.
    """

    def __init__(self, body: BodyMeasurements, cut: LegCut) -> None:
        self.body, self.cut = body, cut
        self.top = body.waist_y - cut.rise_drop_m - cut.band_m
        self.crotch = body.crotch_y - cut.crotch_ease_m
        hem = body.ankle_y + ABOVE_ANKLE_M if cut.inseam_m is None else self.crotch - cut.inseam_m
        self.hem = hem - body.limbs_longer_m
        _check(body, cut, self.top, self.hem)
        quarter = 0.25 * (body.hip_girth + cut.hip_ease_m)
        self.outer = {"front": quarter - SHIFT_M, "back": quarter + SHIFT_M}
        self.reach = {label: share * body.hip_girth for label, share in EXTENSION.items()}
        top_half = 0.5 * (body.girth_at(self.top) + cut.waist_ease_m)
        # The excess of the hips over the waist, on one side of the body, is shared by the side seam and two darts.
        excess = sum(self.outer.values()) - sum(INSET_M.values()) - top_half
        self.darts = {label: max(0.0, share * excess) if cut.darts else 0.0 for label, share in DART_SHARE.items()}
        self.side_inset = 0.5 * (excess - sum(self.darts.values()))
        self.middle = 0.5 * (self.outer["front"] - self.reach["front"])

    def sides(self, label: str, low: float) -> list[Side]:
        """The outline of a front or back whose crotch's point lies at the height ``low``."""
        width, hip_y = self.outer[label], self.body.hip_y
        rise = self.top - hip_y
        raised = self.top + (BACK_RISE_M if label == "back" else 0.0)
        bend = ((width, hip_y + 0.35 * rise), (width - 0.65 * self.side_inset, self.top - 0.3 * rise))
        dart = self.darts[label]
        darts = [Dart(0.5, dart, DART_DEPTH_M[label])] if dart > SMALLEST_DART_M else []
        seat = ((0.0, low + 0.5 * (raised - low)), (-0.05 * self.reach[label], low))
        return [
            *self._lower(label, low),
            Side("hip", (width, hip_y), bend),
            *waist_with_darts("waist", (width - self.side_inset, self.top), (INSET_M[label], raised), darts),
            Side("crotch", (INSET_M[label], raised), seat),
        ]

    def inseam(self, label: str, low: float) -> float:
        """Length [m] of the inseam of a front or back."""
        panel = draft(label, self.sides(label, low), rotation=FRONT, z=0.0)
        return geometry.edge_length(panel.panel, panel.numbers["inseam"])

    def _lower(self, label: str, low: float) -> list[Side]:
        """The sides below the crotch and the hips."""
        start = -self.reach[label]
        inner, outside = self._level(label, self.cut.hem_girth_m, self.hem)
        if self.cut.knee_girth_m is None:
            return [Side("inseam", (start, low)), Side("hem", inner), Side("outseam", outside)]
        knee_y = self.body.knee_y
        knees = self._level(label, self.cut.knee_girth_m, knee_y)
        third = (low - knee_y) / 3.0
        slope = [(k[0] - h[0]) / (knee_y - self.hem) for k, h in zip(knees, (inner, outside), strict=True)]
        above = [(k[0] + s * third, knee_y + third) for k, s in zip(knees, slope, strict=True)]
        return [
            Side("inseam", (start, low), ((start + 0.62 * (knees[0][0] - start), low - third), above[0])),
            Side("inseam_lower", knees[0]),
            Side("hem", inner),
            Side("outseam_lower", outside),
            Side("outseam", knees[1], (above[1], (self.outer[label], self.body.hip_y - third))),
        ]

    def _level(self, label: str, girth: float, y: float) -> tuple[Point, Point]:
        """Inner and outer point of a leg of ``girth`` at height ``y``."""
        half = 0.25 * girth
        out = self.middle + half - 0.5 * SHIFT_M + (self.outer[label] - self.outer["front"])
        width = 0.5 * girth + (SHIFT_M if label == "back" else -SHIFT_M)
        return (out - width, y), (out, y)


def _equal_inseam(lines: _LegLines) -> float:
    """The height [m] of the back's crotch point at which its inseam is as long as the front's."""
    wanted = lines.inseam("front", lines.crotch)
    lowest, highest = lines.crotch - 0.08, lines.crotch + 0.03
    shortest, longest = lines.inseam("back", lowest), lines.inseam("back", highest)
    if not shortest < wanted < longest:
        raise InputError(
            lines.cut.name,
            expected="legs long enough for equal inseams",
            got=f"{wanted:.3f} m in front, {shortest:.3f} to {longest:.3f} m behind",
            cure="Lengthen the legs or narrow the hem.",
        )
    return root(lambda y: lines.inseam("back", y) - wanted, lowest, highest)


def _check(body: BodyMeasurements, cut: LegCut, top: float, hem: float) -> None:
    if top < body.hip_y:
        raise InputError(
            f"{cut.name}: rise_drop_m",
            expected=f"a waist above the hips, which are {body.waist_y - body.hip_y:.3f} m below the body's waist",
            got=f"{body.waist_y - top:.3f} m below it",
            cure="Lessen the drop.",
        )
    least = {
        "hip_ease_m": (thigh_girth(body, cut.hip_ease_m), body.thigh_girth),
        "hem_girth_m": (cut.hem_girth_m, 1.8 * body.wrist_girth),  # a foot passes
    }
    if hem < body.knee_y and cut.knee_girth_m is not None:
        least["knee_girth_m"] = (cut.knee_girth_m, body.calf_girth)
    for name, (cloth, needed) in least.items():
        if cloth < needed:
            raise InputError(
                f"{cut.name}: {name}",
                expected=f"at least the body's {needed:.3f} m",
                got=f"{cloth:.3f} m of cloth",
                cure="Add ease, or draft a larger size.",
            )
