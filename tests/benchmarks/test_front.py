"""The picture of the trade: its points are means of the record, and its garments are those of the record."""

from __future__ import annotations

import json

import pytest

from benchmarks.front import COLOURS, TRAINED, points
from benchmarks.harness import RESULTS_DIR
from drape.stages.tiers import NAMES


def test_points_are_means_over_the_garments_asked_for():
    rows = [
        {"knobs": knobs, "garment": garment, "tier": tier, "time_ratio": time, "curvature": value}
        for knobs, garment, tier, time, value in (
            ("a", "tshirt", "", 0.2, 0.9), ("a", "dress", "", 0.4, 0.8), ("a", "other", "", 0.7, 0.5),
            ("b", "tshirt", "fast", 0.5, 0.95), ("", "tshirt", "", 1.0, 0.0), ("b", "other", "fast", 0.6, 0.9),
        )
    ]  # fmt: skip
    first, second = points(rows, "curvature", TRAINED.__contains__)
    assert first == (pytest.approx(0.3), pytest.approx(0.85), "")
    assert second == (pytest.approx(0.5), pytest.approx(0.95), "fast")
    assert points(rows, "curvature", lambda name: name == "other") == [(0.7, 0.5, ""), (0.6, 0.9, "fast")]


def test_the_record_has_the_garments_and_tiers_of_the_picture():
    record = json.loads((RESULTS_DIR / "tradeoff.json").read_text(encoding="utf-8"))
    assert set(TRAINED) < {row["garment"] for row in record["rows"]}
    assert set(COLOURS) == set(NAMES)
