"""Sizes S, M, L and XL: the measurements that a pattern is drafted for, from those of one body, which is M.

Girths grow by 4 cm from size to size, as in EN 13402-3 (bust, chest, waist and hip girth in steps of 4 cm up to the
middle of its range); the other steps are the proportional ones of tailors' grading tables, rounded to a millimetre.
"""

from __future__ import annotations

from dataclasses import replace

from drape.errors import NotFound
from recovery.pattern.measurements import BodyMeasurements

STEPS = {"S": -1, "M": 0, "L": 1, "XL": 2}
# Growth [m] per size; girths whole, half widths half.
GROWTH_M = {
    "chest_girth": 0.040,
    "waist_girth": 0.040,
    "hip_girth": 0.040,
    "thigh_girth": 0.022,
    "calf_girth": 0.012,
    "arm_girth": 0.014,
    "wrist_girth": 0.006,
    "neck_girth": 0.010,
    "neck_half_width": 0.0015,
    "shoulder_x": 0.006,
    "underarm_y": -0.004,  # armholes deepen
}


def in_size(body: BodyMeasurements, size: str) -> BodyMeasurements:
    """The measurements that a pattern of ``size`` is drafted for, ``body`` being size M.

    Raises ``NotFound`` for a size beyond the grade.
    """
    if size not in STEPS:
        raise NotFound(
            "size",
            expected=f"one of {', '.join(STEPS)}",
            got=size,
            cure="Beyond the grade, draft for a body of that size: measure it and make its M.",
        )
    step = STEPS[size]
    if step == 0:
        return body
    grown = {name: getattr(body, name) + step * growth for name, growth in GROWTH_M.items()}
    return replace(body, girths=body.girths + step * GROWTH_M["waist_girth"], **grown)
