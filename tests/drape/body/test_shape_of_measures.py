"""From measures to a shape and back; the likeliest shape; what is refused and what is missed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.measures import Measures, measures
from drape.body.model import BodyModel
from drape.body.shape_of_measures import ACCURACY, LIMIT, measure_ranges, shape_of_measures
from drape.errors import BodyError

GIRTH_M = 0.002


@pytest.mark.parametrize("seed", range(4))
def test_all_measures_of_a_shape_come_back(body: BodyModel, seed: int):
    betas = np.clip(0.8 * np.random.default_rng(seed).normal(size=10), -2.0, 2.0)
    asked = measures(body, betas)
    found = shape_of_measures(body, asked._asdict())
    assert_allclose(found.reached[:-1], asked[:-1], rtol=0.0, atol=GIRTH_M)
    assert_allclose(found.reached.weight_kg, asked.weight_kg, rtol=0.0, atol=0.2)
    assert found.missed == {}
    assert found.reached == measures(body, found.betas)
    assert np.linalg.norm(found.betas) < np.linalg.norm(betas) + 0.1, "no less likely than the shape that was measured"


def test_the_mean_measures_are_those_of_the_mean_shape(body: BodyModel):
    found = shape_of_measures(body, measures(body)._asdict())
    assert_allclose(found.betas, 0.0, atol=1e-6)


def test_no_shape_nearby_is_likelier(body: BodyModel, rng):
    asked = {"height_m": 1.7, "waist_m": 0.8}
    rows = [Measures._fields.index(name) for name in asked]

    def cost(betas: np.ndarray) -> float:
        off = (np.array(measures(body, betas))[rows] - list(asked.values())) / np.array(ACCURACY)[rows]
        return float(off @ off + betas @ betas)

    found = shape_of_measures(body, asked).betas
    ways = rng.normal(size=(20, 10)) / np.sqrt(10.0)
    # Along a way that leaves the measures cost rises by its square, along any other far more.
    assert all(cost(found + 0.1 * way) > cost(found) for way in ways)


def test_what_is_left_out_stays_likely(body: BodyModel):
    found = shape_of_measures(body, {"height_m": 1.7})
    assert_allclose(found.reached.height_m, 1.7, atol=1e-3)
    assert np.linalg.norm(found.betas) < 1.0
    share = np.divide(found.reached, measures(body))[:-1]
    assert (np.abs(share - share[0]) < 0.05).all(), "about the same proportions"


def test_measures_that_exclude_each_other_are_told_as_missed(body: BodyModel):
    found = shape_of_measures(body, {"height_m": 1.9, "chest_m": 0.8, "waist_m": 0.9})
    assert np.abs(found.betas).max() <= LIMIT + 1e-9
    assert set(found.missed) == {"height_m", "chest_m", "waist_m"}
    assert found.missed["chest_m"] > 0.0 > found.missed["waist_m"]
    for name, by in found.missed.items():
        assert_allclose(by, getattr(found.reached, name) - {"height_m": 1.9, "chest_m": 0.8, "waist_m": 0.9}[name])


@pytest.mark.parametrize("name", Measures._fields)
def test_a_measure_alone_reaches_both_ends_of_its_range(body: BodyModel, name: str):
    for end in measure_ranges(body)[name]:
        found = shape_of_measures(body, {name: end})
        assert found.missed == {}
        assert np.linalg.norm(found.betas) < LIMIT + 0.05, "where the range was looked for"


@pytest.mark.parametrize("name", Measures._fields)
def test_the_ends_that_a_refusal_names_are_taken(body: BodyModel, name: str):
    with pytest.raises(BodyError) as refused:
        shape_of_measures(body, {name: 1e3})
    least, _, most, *_ = refused.value.expected.split()
    for end in (float(least), float(most)):
        assert shape_of_measures(body, {name: end}).missed == {}


def test_ranges_hold_the_mean_and_are_nearly_symmetric(body: BodyModel):
    ranges, mean = measure_ranges(body), measures(body)
    assert tuple(ranges) == Measures._fields
    for name, (low, high) in ranges.items():
        middle = getattr(mean, name)
        assert low < middle < high
        assert 0.4 < (middle - low) / (high - middle) < 1.3
    assert measure_ranges(body, 1.0)["height_m"][1] < ranges["height_m"][1]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({}, "measures: expected some of height_m, .*, got none"),
        ({"height_cm": 170.0}, "measures: expected some of height_m, .*, got height_cm"),
        ({"height_m": 170.0}, r"height_m: expected 1\.259 to 2\.408 m, which this body can have, got 170 m"),
        ({"height_m": 1.7, "chest_m": 0.2}, r"chest_m: expected 0\.\d+ to 1\.\d+ m, .*, got 0\.2 m"),
        ({"weight_kg": 400.0}, "weight_kg: expected .* kg, which this body can have, got 400 kg"),
        ({"waist_m": float("nan")}, "waist_m: expected .* got nan m"),
    ],
)
def test_what_no_body_has_is_refused(body: BodyModel, asked: dict[str, float], words: str):
    with pytest.raises(BodyError, match=words):
        shape_of_measures(body, asked)
