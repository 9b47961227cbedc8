"""Sizes by letter: which body each is cut for, and which one a body takes.

EN 13402-3 puts two steps of 4 cm of its primary dimension under one letter: chest and bust girth grow by 8 cm from
letter to letter (men S 86 to 94, M 94 to 102, L 102 to 110, XL 110 to 118 cm), waist and hip girth with it. The
standard body is the middle of M. The primary dimension is EN 13402-2's: the chest of tops and dresses, the waist of
trousers and skirts, and beside it the hips.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drape.errors import NotFound, did_you_mean

SIZES = ("S", "M", "L", "XL")
STEPS = {size: number - SIZES.index("M") for number, size in enumerate(SIZES)}
GIRTH_STEP_M = 0.08  # growth of chest, waist and hips from letter to letter
BEYOND = {"XXS": "S", "XS": "S", "XXL": "XL", "2XL": "XL", "3XL": "XL", "XXXL": "XL"}
_WORDS = {"chest_m": "chest", "waist_m": "waist", "hip_m": "hips"}


class Advice(NamedTuple):
    """The ``size`` that a body takes, such as "M", and a sentence that says why."""

    size: str
    words: str


def check_size(size: str, garment: str) -> None:
    """Raises ``NotFound``, which names the nearest one, if ``size`` is none of ``SIZES``; ``garment`` is named in the
    message."""
    if size in STEPS:
        return
    upper = size.strip().upper()
    near = upper if upper in STEPS else BEYOND.get(upper)
    cure = f"The nearest is {near}." if near else did_you_mean(size, SIZES, "Send one of them.")
    raise NotFound("size", expected=f"one of {', '.join(SIZES)} of {garment}", got=size[:40], cure=cure)


def cut_for(size: str, standard: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Returns for each level of ``standard`` the least and the greatest girth [m] of bodies that ``size`` is cut for.
    ``standard``: the girths [m] of the standard body, the middle of M."""
    step = STEPS[size]
    return {
        name: (girth + (step - 0.5) * GIRTH_STEP_M, girth + (step + 0.5) * GIRTH_STEP_M)
        for name, girth in standard.items()
    }


def deciding(measures: Mapping[str, float]) -> tuple[str, ...]:
    """Returns the levels whose girths decide the size of a garment with ``measures``: ("chest_m",) if it goes around
    the chest, else ("waist_m", "hip_m")."""
    return ("chest_m",) if "chest_m" in measures else ("waist_m", "hip_m")


def advice(girths: Mapping[str, float], standard: Mapping[str, float], levels: tuple[str, ...]) -> Advice:
    """Returns the size for a body with ``girths`` [m] by level, and why. Of ``levels`` the one decides that asks for
    the largest size. ``standard``: the girths [m] of the standard body, the middle of M."""
    steps = {name: (girths[name] - standard[name]) / GIRTH_STEP_M for name in levels}
    name = max(levels, key=lambda level: steps[level])
    wanted = int(np.ceil(steps[name] - 0.5))
    number = min(max(wanted + SIZES.index("M"), 0), len(SIZES) - 1)
    size = SIZES[number]
    least, most = (round(100.0 * bound) for bound in cut_for(size, standard)[name])
    said = f"{_WORDS[name]} {100.0 * girths[name]:.0f} cm; {size} is cut for {least} to {most} cm"
    if wanted != STEPS[size]:
        said += ", the largest" if wanted > STEPS[size] else ", the smallest"
    return Advice(size, said)
