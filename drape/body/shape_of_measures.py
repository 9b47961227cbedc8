"""The likeliest shape of a body that has given measures: ``shape_of_measures``.

Shape coefficients b are standard deviations of the population that a body was made of, b ~ N(0, 1). Given measures y of
the accuracy s that a tape has, the likeliest shape minimises

    |(m(b) - y) / s|^2 + |b|^2,   |b_i| <= limit

Measures are nearly linear in b, so a few steps of Gauss and Newton find it. Each is a linear problem with bounds, so
that coefficients stay within theirs and the others make up for those that cannot go on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from drape.body.measure_slopes import measure_slopes
from drape.body.measures import Measures, measures
from drape.body.model import BodyModel
from drape.errors import BodyError

LIMIT = 3.0  # In standard deviations: one body in 370 is further out in a given direction.
ACCURACY = Measures(*(1e-3,) * 7, weight_kg=0.1)
MISSED = Measures(*(5e-3,) * 7, weight_kg=0.5)  # A measure that is off by more counts as missed.
STEPS, DONE = 12, 1e-4  # At most so many steps are taken, until coefficients change by less.


class FoundShape(NamedTuple):
    """A shape ``betas`` (S,) and the measures that it ``reached``. ``missed`` has, by name, how far [m, kg] a measure
    lies above (positive) or below what was asked, where that is more than ``MISSED``."""

    betas: np.ndarray
    reached: Measures
    missed: dict[str, float]


def shape_of_measures(body: BodyModel, asked: Mapping[str, float]) -> FoundShape:
    """Returns the likeliest shape of ``body`` that has the measures ``asked`` [m, kg], by their names in ``Measures``.

    A measure that is left out gets its likeliest value beside those that are given. Raises ``BodyError`` for no measure
    at all, an unknown name, and a measure that no shape within ``LIMIT`` standard deviations has. Measures that exclude
    each other are no error: the result says what is ``missed``.
    """
    from scipy.optimize import lsq_linear  # The import takes a tenth of a second, which a start need not wait for.

    names = _checked(body, asked)
    rows = [Measures._fields.index(name) for name in names]
    target, scale = np.array([asked[name] for name in names]), np.array(ACCURACY)[rows]
    betas = np.zeros(body.shape_count)
    for _ in range(STEPS):
        slope = measure_slopes(body, betas)[rows] / scale[:, None]
        left = (target - np.array(measures(body, betas))[rows]) / scale
        matrix = np.concatenate([slope, np.eye(len(betas))])
        wanted = np.concatenate([left + slope @ betas, np.zeros(len(betas))])
        before, betas = betas, lsq_linear(matrix, wanted, (-LIMIT, LIMIT), method="bvls").x
        if np.abs(betas - before).max() < DONE:
            break
    reached = measures(body, betas)
    off = {name: getattr(reached, name) - asked[name] for name in names}
    return FoundShape(betas, reached, {name: by for name, by in off.items() if abs(by) > getattr(MISSED, name)})


@lru_cache(maxsize=8)
def measure_ranges(body: BodyModel, limit: float = LIMIT) -> dict[str, tuple[float, float]]:
    """Returns the least and the largest value [m, kg] of each measure, by its name, of shapes of ``body`` within
    ``limit`` standard deviations.

    These are its values at the two shapes ``limit`` away from the mean shape along the measure's slope there, since
    measures are nearly linear.
    """
    ranges = {}
    slopes = measure_slopes(body, np.zeros(body.shape_count))
    for row, (name, slope) in enumerate(zip(Measures._fields, slopes, strict=True)):
        furthest = limit * slope / max(float(np.linalg.norm(slope)), 1e-12)
        ranges[name] = measures(body, -furthest)[row], measures(body, furthest)[row]
    return ranges


def _checked(body: BodyModel, asked: Mapping[str, float]) -> list[str]:
    """The names of what is ``asked``, in the order of ``Measures``."""
    for name in asked:
        if name not in Measures._fields:
            expected = f"some of {', '.join(Measures._fields)}"
            raise BodyError("measures", expected=expected, got=str(name)[:60], cure="Use these names.")
    names = [name for name in Measures._fields if name in asked]
    if not names:
        cure = 'For example {"height_m": 1.7}.'
        raise BodyError("measures", expected=f"some of {', '.join(Measures._fields)}", got="none", cure=cure)
    ranges = measure_ranges(body)
    for name in names:
        low, high = ranges[name]
        if not low <= asked[name] <= high:  # The negation also catches NaN.
            unit = name.rpartition("_")[2]
            least, most = math.ceil(1e3 * low) / 1e3, math.floor(1e3 * high) / 1e3  # What is named is taken.
            expected, cure = f"{least:g} to {most:g} {unit}, which this body can have", "Lengths are in metres."
            raise BodyError(name, expected=expected, got=f"{asked[name]:g} {unit}", cure=cure)
    return names
