"""The comparison of push-outs: the means, and one small run."""

from __future__ import annotations

import pytest

from benchmarks import push_out
from benchmarks.push_out import METHODS, summary


def test_the_summary_is_the_mean_of_each_set():
    rows = [
        {"garment": name, "set": kind, "method": method, "edge_pct": value}
        for name, kind, value in (("a", "trained", 1.0), ("b", "trained", 3.0), ("c", "unseen", 7.0))
        for method in METHODS
    ]
    found = {(row["set"], row["method"]): row for row in summary(rows)}
    assert found["trained", "nearest_vertex"]["edge_pct"] == 2.0
    assert found["unseen", "none"]["garment"] == "mean of 1"


@pytest.mark.slow
def test_a_small_run_has_every_method_and_ours_collides_least(capsys):
    record = push_out.main(["--quick", "--threads", "1", "--garments", "shorts", "--motions", "squat"])
    rows = {row["method"]: row for row in record["rows"]}
    assert set(rows) == set(METHODS)
    assert "processor_ms" not in rows["none"]
    assert all(rows[method]["p50_ms"] > 0.0 for method in METHODS if method != "none")
    assert rows["own_and_other"]["colliding_triangle_pct"] <= rows["none"]["colliding_triangle_pct"]
    assert rows["none"]["edge_added_pp"] == 0.0
    assert "own_and_other" in capsys.readouterr().out
