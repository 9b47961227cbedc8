"""The garments of the catalogue, by name: the cut and the fabric of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypedDict

from recovery.pattern.design import Design
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.shirts import shirt
from recovery.pattern.skirts import SkirtCut, a_line, circle
from recovery.pattern.tops import Sleeve, TopCut, top
from recovery.pattern.trousers import LegCut, trousers


class _Neck(TypedDict):
    neck_band_m: float
    neck_out_m: float
    neck_depth_m: float
    neck_shorter: float


NECK: _Neck = {"neck_band_m": 0.022, "neck_out_m": 0.03, "neck_depth_m": 0.10, "neck_shorter": 0.08}


def _to_wrist(body: BodyMeasurements, shoulder_out_m: float) -> float:
    """Length [m] of a sleeve that ends before the hand."""
    return body.wrist_x - 0.012 - body.shoulder_x - shoulder_out_m


CATALOGUE: dict[str, Callable[[BodyMeasurements], Design]] = {
    "tshirt": lambda body: top(
        body, TopCut("tshirt", "jersey", 0.65, 0.10, Sleeve(0.225, 0.085, 0.36 + body.wider_m), **NECK)
    ),
    "longsleeve": lambda body: top(
        body,
        TopCut(
            "longsleeve", "jersey", 0.65, 0.08, Sleeve(_to_wrist(body, 0.012), 0.065, body.wrist_girth + 0.06), **NECK
        ),
    ),
    "tank": lambda body: top(
        body,
        TopCut(
            *("tank", "rib", 0.64, 0.05),
            shoulder_out_m=-0.052,
            shoulder_drop_m=0.025,
            neck_out_m=0.02,
            neck_depth_m=0.15,
            back_neck_depth_m=0.08,
            armhole_inset=0.04,
        ),
    ),
    "skirt": lambda body: a_line(body, SkirtCut("skirt", "stretch_denim", 0.55)),
    "circle_skirt": lambda body: circle(body, SkirtCut("circle_skirt", "satin", 0.58)),
    "dress": lambda body: top(
        body,
        TopCut(
            *("dress", "satin", 1.02, 0.14, Sleeve(0.20, 0.10, 0.40 + body.wider_m)),
            neck_out_m=0.03,
            neck_depth_m=0.10,
            back_neck_depth_m=0.03,
            flare_m=0.10,
            skirt_m=0.12,
            gather=0.25,
            armhole_drop_m=0.04,
        ),
    ),
    "sweat": lambda body: top(
        body,
        TopCut(
            *("sweat", "sweat", 0.66, 0.26, Sleeve(_to_wrist(body, 0.065), 0.14, 0.30 + body.wider_m, 0.06, 0.33)),
            shoulder_out_m=0.065,
            shoulder_drop_m=0.05,
            armhole_drop_m=0.075,
            neck_out_m=0.03,
            neck_band_m=0.03,
            neck_shorter=0.08,
            hem_band_m=0.06,
            hem_shorter=0.22,
        ),
    ),
    "shirt": lambda body: shirt(
        body,
        TopCut(
            *("shirt", "satin", 0.70, 0.14, Sleeve(_to_wrist(body, 0.012), 0.10, 0.27 + body.wider_m, 0.055, 0.15)),
            neck_out_m=0.008,
            neck_depth_m=0.075,
            back_neck_depth_m=0.015,
        ),
    ),
    "trousers": lambda body: trousers(
        body, LegCut("trousers", "ponte", 0.13, 0.72 + body.wider_m, 0.66 + body.wider_m)
    ),
    "slim_trousers": lambda body: trousers(
        body, LegCut("slim_trousers", "stretch_denim", 0.04, 0.36 + body.wider_m, 0.43 + body.wider_m)
    ),
    "shorts": lambda body: trousers(body, LegCut("shorts", "twill", 0.10, 0.64 + body.wider_m, inseam_m=0.20)),
}
