"""The benchmark of cuts: what it writes as targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import recovery_cuts
from drape.garment.files.mesh import read_mesh


def test_a_garment_of_the_catalogue_is_a_plain_surface(tmp_path: Path):
    path, source = recovery_cuts.written("tank", tmp_path)
    mesh = read_mesh(path)
    assert source == "catalogue" and len(mesh.uv) == 0 and len(mesh.vertices) > 4000
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(0.586, abs=0.01)


def test_without_data_the_run_ends_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    with pytest.raises(SystemExit, match="DRAPE_DATA"):
        recovery_cuts.written("tee", tmp_path)
