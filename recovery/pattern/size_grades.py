"""Sizes S to XXL: the measurements that a pattern is drafted for, from those of one body, which is M.

Girths of the trunk grow by a letter of EN 13402-3 (``drape.garment.size_chart``). The other steps are proportional to
these, as in tailors' grading tables, and lengths grow by what makers of T-shirts print.
"""

from __future__ import annotations

from dataclasses import replace

from drape.errors import NotFound
from drape.garment.size_chart import GIRTH_STEP_M, STEPS
from recovery.pattern.measurements import BodyMeasurements

# Patterns come in one more than garments that are sewn and stored.
PATTERN_STEPS = STEPS | {"XXL": 3}
# Growth [m] per size; girths whole, half widths half.
GROWTH_M = {
    "chest_girth": GIRTH_STEP_M,
    "waist_girth": GIRTH_STEP_M,
    "hip_girth": GIRTH_STEP_M,
    "thigh_girth": 0.044,
    "calf_girth": 0.024,
    "arm_girth": 0.028,
    "wrist_girth": 0.012,
    "neck_girth": 0.020,
    "neck_half_width": 0.003,
    "shoulder_x": 0.012,
    "underarm_y": -0.008,  # armholes deepen
    "longer_m": 0.02,
    "wider_m": 0.024,
}


def in_size(body: BodyMeasurements, size: str) -> BodyMeasurements:
    """The measurements that a pattern of ``size`` is drafted for, ``body`` being size M.

    Raises ``NotFound`` for a size beyond the grade.
    """
    if size not in PATTERN_STEPS:
        raise NotFound(
            "size",
            expected=f"one of {', '.join(PATTERN_STEPS)}",
            got=size,
            cure="Beyond the grade, draft for a body of that size: measure it and make its M.",
        )
    step = PATTERN_STEPS[size]
    if step == 0:
        return body
    grown = {name: getattr(body, name) + step * growth for name, growth in GROWTH_M.items()}
    return replace(body, girths=body.girths + step * GROWTH_M["waist_girth"], **grown)
