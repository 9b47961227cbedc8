"""Recovery of own patterns: the disturbed bases, what the ablation leaves out, and its spread."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.records import rounds_table
from benchmarks.recovery.__main__ import VARIANTS, by_round, lengths, spread
from benchmarks.recovery.disturbed import LEAST_OFF, MOST_OFF, off
from drape.body.assets import load_body
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.fit.optimise import FitOptions
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


@pytest.mark.slow
def test_errors_and_times_of_every_round_make_a_table():
    body, truth = load_body(), skirt(default_measurements())
    drape = DrapeOptions(edge_length_m=0.1, grid_m=0.02)
    target = drape_pattern(truth, body, drape)
    fit = FitOptions(iterations=0, closing=1)
    found = recover_pattern(
        target.nodes, target.mesh.faces, off(truth, 0), body, drape=drape, fit=fit, meshes_m=(0.1, 0.08)
    )
    first, second = by_round(found, truth)
    assert second["nodes"] > first["nodes"] and first["minutes"] > 0.0 and first["processor_minutes"] > 0.0
    assert first["steps"] == second["steps"] == 1 and min(first["drapes"], second["drapes"]) >= 2
    assert first["surface_mm"] < 3.0 and first["mean_mm"] < first["max_mm"] < 10.0
    lines = [{"garment": "skirt", "seed": 0, **line} for line in (first, second)]
    row = {"garment": "skirt", "seed": 0, "graded_mm": 1.5, "minutes": 0.25, "processor_minutes": 0.125}
    text = rounds_table({"rows": [row], "by_round": lines, "machine": "M", "commit": "c", "command": "python"})
    assert "| skirt, 0: graded twice | - | 1.50 |" in text and "| 0.25 | 0.12 |" in text
    assert f"| skirt, 0: round 2 | {second['nodes']} |" in text
