"""What grows is told, with its error; what a service should not answer is a fault."""

from __future__ import annotations

import os

import httpx
import numpy as np
import pytest

from benchmarks.speed import churn
from benchmarks.speed.churn import Looked, Tally, row_of, slope_of


def test_a_slope_and_its_error_are_those_of_the_blocks():
    times_s = np.arange(0.0, 3600.0, 5.0)
    slope, error = slope_of(times_s, 500.0 + 12.0 * times_s / 3600.0)
    assert (slope, error) == (pytest.approx(12.0), pytest.approx(0.0, abs=1e-9))
    noise = np.random.default_rng(0).normal(0.0, 3.0, (400, len(times_s)))
    found = np.array([slope_of(times_s, 500.0 + one) for one in noise])
    assert abs(found[:, 0].mean()) < 0.1
    assert found[:, 1].mean() == pytest.approx(found[:, 0].std(), rel=0.15), "the error is what slopes differ by"
    assert np.isnan(slope_of(times_s[:2], times_s[:2])).all()


def test_a_process_is_looked_at_and_the_first_third_left_out():
    looked = Looked.of(os.getpid())
    assert looked.memory_mb > 10.0 and looked.threads >= 1 and looked.descriptors >= 3
    flat = [Looked(60.0 * k, 900.0 if k < 20 else 950.0, 30, 9) for k in range(60)]
    row = row_of(Tally(), [*flat, Looked(3600.0, 951.0, 31, 9)], 60.0, 50)
    assert (row["memory_mb"], row["last_mb"], row["last_descriptors"], row["failed"]) == (950.0, 951.0, 31, 0)
    assert row["slope_mb_h"] == pytest.approx(0.0, abs=1e-9)


def test_answers_that_say_there_is_no_room_are_no_faults():
    tally, request = Tally(), httpx.Request("GET", "http://here/garments")
    for status in (200, 404, 429, 503, 507, 500, 502):
        tally.answered(httpx.Response(status, request=request))
    assert tally.counts == {"requests": 7, "refused": 6}
    assert tally.faults == ["GET /garments: 500", "GET /garments: 502"]


@pytest.mark.long
def test_clients_come_and_go(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, few_garments: tuple[str, ...]
):
    monkeypatch.setattr(churn, "GARMENTS", few_garments)
    monkeypatch.setattr(churn, "OUTFITS", (few_garments,))
    record = churn.main(["--minutes", "0.1", "--clients", "4"])
    (row,) = record["rows"]
    assert row["streams"] > 0 and row["requests"] > 0 and row["failed"] == 0 and record["faults"] == []
    assert len(record["memory_mb"]) >= 9 and '"bench": "churn"' in capsys.readouterr().out
