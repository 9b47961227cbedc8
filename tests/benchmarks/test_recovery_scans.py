"""The benchmark of scans: what is left out without the data folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import recovery_scans
from benchmarks.harness import Run
from drape.errors import Unavailable
from recovery.pattern.bases import BASES


def test_without_data_a_strangers_garment_is_left_out_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    options = recovery_scans.main.parse(["--targets", "female_jeans"])
    run = Run("recovery_scans", recovery_scans.COLUMNS, options)
    assert recovery_scans.row_of("female_jeans", tmp_path, run) is None
    assert "female_jeans" in run.notes[0] and "DRAPE_DATA" in run.notes[0]
    with pytest.raises(Unavailable, match="DRAPE_DATA"):
        recovery_scans.main(["--targets", "female_jeans"])


def test_raw_scans_need_no_data_and_every_base_is_one_of_ours(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    monkeypatch.setattr(recovery_scans, "raw_scan", lambda name: Path(name))
    for name in recovery_scans.SUBJECTS:
        target, source, base = recovery_scans.written(name)
        assert (target, source) == (Path(name), "raw scan") and base in BASES
    assert {base for _, base in recovery_scans.STRANGERS.values()} <= {*BASES, recovery_scans.REFUSED}
    assert len(set(recovery_scans.NAMES)) == 12
