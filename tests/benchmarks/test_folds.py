"""The benchmark of folds in its quick form, and its table."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import folds
from benchmarks.judge import ipc_optimum, physics
from benchmarks.measure import judged
from benchmarks.records import folds_table


@pytest.fixture(scope="module")
def record():
    with pytest.MonkeyPatch.context() as patch:  # a step or two of one frame, kept nowhere
        patch.setattr(folds, "OPTIMA", 1)
        patch.setattr(judged, "FEW", 1)
        patch.setattr(folds, "CACHE_DIR", None)
        patch.setattr(ipc_optimum, "STEPS", 2)
        patch.setattr(physics, "STEPS", 5)
        ways = ["--threads", "1", "--apart", "--physics", "--cloth-contact"]
        return folds.main(["--quick", "--garments", "tank", "--frames", "6", "--sweeps", "0", "1", "8", *ways])


@pytest.mark.long
def test_rows_are_of_every_start_and_folds_lower_the_energy(record):
    rows = {(row["method"], row["sweeps"]): row for row in record["rows"] if not row.get("cloth_contact")}
    least = rows.pop(("physics", 0))
    assert {method for method, _ in rows} == {"skinning", "network_0", "network_all"}
    assert least["gain"] == least["detail_share"] == 1.0 and least["ms"] > 10.0
    for method, sweeps in rows:
        row = rows[method, sweeps]
        assert least["energy_j"] < row["energy_j"] <= rows[method, 0]["energy_j"]
        assert row["gain"] <= 1.0 and row["edge_pct"] <= rows[method, 0]["edge_pct"]
        assert np.isfinite(
            [row[key] for key in ("ms", "detail_mm", "jitter_ratio", "colliding_pct", "skin_pixels_pct")]
        ).all()
        assert (row["ms"] > 0.0) == bool(sweeps) and row["resets"] == 0
    assert rows["network_0", 0]["jitter_ratio"] == 1.0
    assert rows["network_0", 1]["detail_mm"] > rows["network_0", 0]["detail_mm"]


@pytest.mark.long
def test_gains_are_also_beside_cloth_that_keeps_apart(record):
    own = [row for row in record["rows"] if row.get("cloth_contact") is False]
    gains = {(row["method"], row["sweeps"]): row["gain_apart"] for row in own}
    assert gains["skinning", 0] == 0.0 < gains["network_0", 0] < gains["network_0", 8]


@pytest.mark.long
def test_cloth_that_feels_itself_crosses_less_often(record):
    crossed = {
        apart: sum(row["self_intersections"] for row in record["rows"] if row.get("cloth_contact") is apart)
        for apart in (False, True)
    }
    assert {row["sweeps"] for row in record["rows"] if row.get("cloth_contact")} == {1, 8}
    assert crossed[True] < crossed[False]


@pytest.mark.long
def test_the_table_has_a_line_for_each_start(record):
    rows = [row | {"sweeps": {1: 2}.get(row["sweeps"], row["sweeps"])} for row in record["rows"]]
    lines = folds_table(record | {"rows": rows}).splitlines()
    assert sum(line.startswith("| tank") for line in lines) == 7 and "network 0" in lines[4]
    assert "skinning, cloth feels cloth" in lines[3] and "physics" in lines[8]


def test_jitter_is_a_ratio_of_third_differences_and_none_where_the_start_is_still():
    start = np.random.default_rng(0).normal(size=(6, 5, 3))
    assert judged.jitter_ratio(3.0 * start, start) == pytest.approx(3.0)
    assert np.isnan(judged.jitter_ratio(start, np.ones((6, 5, 3))))
