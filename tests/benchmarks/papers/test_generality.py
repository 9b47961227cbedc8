"""The study of variety: its runs are real configurations, and one of them trains and is measured."""

from __future__ import annotations

import math

import pytest

from benchmarks.papers import generality, held_out
from training.garment_design import DESIGNS


def test_every_run_is_a_configuration_of_known_designs():
    for run in generality.RUNS:
        config = generality.training_config(run, 1.0, quick=False)
        assert set(config.data.garments) <= set(DESIGNS)
        assert config.data.partitions >= 1
    whole = generality.training_config("seven and 7 variants each", 1.0, quick=False)
    assert len(whole.data.garments) * (1 + whole.data.variants) == 56


@pytest.mark.slow
def test_a_quick_run_trains_and_measures(tmp_path, monkeypatch):
    monkeypatch.setattr(held_out, "CACHE_DIR", tmp_path)
    record = generality.main(["--quick", "--threads", "1", "--minutes", "0.03", "--steps", "40"])
    (row,) = record["rows"]
    assert row["steps"] > 0
    assert (row["garments"], row["partitions"]) == (1, 1)
    assert math.isfinite(row["gain_shorts"])
    assert row["mean_seen"] == row["gain_shorts"]
    assert len(list(tmp_path.glob("*.npz"))) == 1  # the optimum that the next run takes
