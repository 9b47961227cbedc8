"""The study of fine-tuning: what its runs start from, and one garment through the whole of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.papers import finetuning, held_out
from drape.garment.cache import GARMENTS_DIR

TANK = str(next(GARMENTS_DIR.glob("tank-*.npz")))


def test_runs_differ_in_what_they_start_from_and_not_in_the_garment():
    found = finetuning.configurations(Path("onefit"), TANK)
    assert {config.data.garments for config, _ in found.values()} == {(TANK,)}
    assert found["from scratch"][1] is None
    tuned, weights = found["fine-tuned"]
    assert weights is not None and tuned.model == found["from scratch"][0].model
    assert tuned.learning_rate < found["from scratch"][0].learning_rate


@pytest.mark.slow
def test_a_garment_is_trained_on_and_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(held_out, "CACHE_DIR", tmp_path)
    real = finetuning.configurations

    def with_one_partition(*asked):
        return {name: (replace(c, data=replace(c.data, partitions=1)), w) for name, (c, w) in real(*asked).items()}

    monkeypatch.setattr(finetuning, "configurations", with_one_partition)
    record = finetuning.main(["--garments", TANK, "--quick", "--threads", "1", "--train-steps", "2"])
    rows = record["rows"]
    assert [(row["network"], row["steps"]) for row in rows] == [
        ("as shipped", 0), ("fine-tuned", 2), ("from scratch", 2), ("from scratch", 6),
    ]  # fmt: skip
    assert all(math.isfinite(row["gain"]) and row["edge_pct"] > 0.0 for row in rows)
    shipped, tuned, scratch, _ = rows
    assert shipped["gain"] > 0.5, "the shipped model was trained on it"
    assert abs(tuned["gain"] - shipped["gain"]) < 0.1 < shipped["gain"] - scratch["gain"]
    assert record["mean_gain"]["as shipped, 0 steps"] == pytest.approx(shipped["gain"], rel=1e-5)
