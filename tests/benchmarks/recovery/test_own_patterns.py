"""Recovery of own patterns: the disturbed bases, and the table of rounds."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.records import rounds_table
from benchmarks.recovery.__main__ import by_round
from benchmarks.recovery.compare import LEAST_OFF, MOST_OFF, off
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


@pytest.mark.long
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
