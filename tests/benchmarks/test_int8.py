"""The packed graph in int8 beside float32: the record has a row of each, and says how far they are apart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.int8 import main
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR


@pytest.mark.slow
@pytest.mark.skipif(not (MODELS_DIR / DEFAULT_MODEL).is_dir(), reason="no model is shipped: export one")
def test_both_forms_are_measured_and_drape_alike(tmp_path: Path):
    record = main(["--quick", "--garments", "tank", "--threads", "1", "--out", str(tmp_path / "r.json")])
    assert json.loads((tmp_path / "r.json").read_text()) == record
    exact, rounded = record["rows"]
    assert (exact["form"], rounded["form"]) == ("float32", "int8")
    assert exact["apart_mm"] == 0.0 < rounded["apart_mm"] < 5.0
    assert rounded["edge_pct"] == pytest.approx(exact["edge_pct"], abs=0.3)
    assert all(row["jitter"] > 0.0 and row["min_ms"] <= row["p50_ms"] for row in record["rows"])
