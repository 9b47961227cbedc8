"""Recovery of own patterns: the disturbed bases, what the ablation leaves out, and its spread."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.recovery import LEAST_OFF, MOST_OFF, VARIANTS, lengths, off, spread
from recovery.fit.pipeline import recover_pattern
from recovery.pattern.bases import skirt
from tests.recovery.pattern_setup import default_measurements


def test_a_base_is_off_by_five_to_ten_percent_in_width_and_in_height():
    truth = skirt(default_measurements())
    for seed in range(3):
        for own, true in zip(off(truth, seed).panels, truth.panels, strict=True):
            factor = np.ptp(own.vertices, axis=0) / np.ptp(true.vertices, axis=0)
            assert (np.abs(factor - 1.0) > 0.99 * LEAST_OFF).all() and (np.abs(factor - 1.0) < 1.01 * MOST_OFF).all()
    assert (lengths(off(truth, 0)) != lengths(truth)).all()


def test_every_variant_is_an_option_of_the_recovery():
    known = set(inspect.signature(recover_pattern).parameters) | {"rounds"}
    assert all(set(options) <= known for options in VARIANTS.values())
    assert VARIANTS["all"] == {} and len({str(options) for options in VARIANTS.values()}) == len(VARIANTS)


def test_spread_is_mean_and_deviation_over_the_seeds():
    rows = [
        {"garment": "skirt", "variant": variant, "mean_mm": value, "area_err": 2.0 * value, "surface_mm": 1.0}
        for variant, value in (("all", 1.0), ("all", 3.0), ("no seams", 5.0))
    ]
    first, second = spread(rows)
    assert (first["variant"], first["seeds"], second["seeds"]) == ("all", 2, 1)
    assert_allclose([first["mean_mm"], first["mean_mm_sd"], first["area_err"]], [2.0, np.sqrt(2.0), 4.0])
    assert first["surface_mm_sd"] == pytest.approx(0.0) and np.isnan(second["mean_mm_sd"])
