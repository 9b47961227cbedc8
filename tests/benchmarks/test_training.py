"""The throughput benchmark: real steps, stages that add up, one record."""

from __future__ import annotations

import pytest

from benchmarks import training


@pytest.mark.slow
def test_a_row_has_a_rate_and_its_stages_add_up_to_a_step():
    record = training.main(["--quick", "--threads", "1", "--garment", "shorts", "--batch", "2", "--steps", "5"])
    assert (record["bench"], record["garment"], record["rows"][0]["batch"]) == ("training", "shorts", 2)
    (row,) = record["rows"]
    stages = {key: value for key, value in row.items() if key.endswith("_ms")}
    assert set(stages) == {f"{name}_ms" for name in (*training.STAGES, "other")}
    assert row["frames_per_s"] > 0.0
    assert min(stages.values()) >= 0.0
    # Of one step the profiled pass is slower than the timed one, never many times.
    assert 0.3 < sum(stages.values()) * row["frames_per_s"] / 1e3 < 5.0
    for name in ("pose", "network", "energy", "contact", "backward", "optimiser"):
        assert stages[f"{name}_ms"] > 0.0
