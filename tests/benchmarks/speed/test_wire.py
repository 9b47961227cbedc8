"""The wire benchmark: its quick run measures what it says."""

from __future__ import annotations

import json

import pytest

from benchmarks.speed import wire as bench
from drape.wire.jets import message_bytes


@pytest.mark.slow
def test_the_quick_run_compares_both_frames(capsys):
    record = bench.main(["--quick", "--threads", "1", "--garments", "tank", "--frames", "2"])
    (row,) = record["rows"]
    assert (row["garment"], row["patches"], row["jets_bytes"]) == ("tank", 100, message_bytes(100))
    assert row["jets_bytes"] < 0.5 * row["vertices_bytes"] < row["layout_bytes"]
    assert 0.0 < row["rounding_p50_mm"] < row["rounding_p99_mm"] < 0.1
    assert row["u16_p99_mm"] < row["rounding_p99_mm"]
    assert len(record["frames"]) == 2
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["bench"] == "wire"
