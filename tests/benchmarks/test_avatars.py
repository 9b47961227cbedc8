"""Characters in the benchmark of avatars: one that is ours, and the refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.avatars import COLUMNS, characters, main, retarget_deg
from drape.avatar.wearer import read_wearer
from drape.body.model import BodyModel
from drape.errors import Unavailable
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.poses import random_motion


@pytest.mark.long
def test_our_own_body_is_dressed_without_skin_that_shows(body: BodyModel, tmp_path: Path):
    file = tmp_path / "ours.glb"
    file.write_bytes(character(body, arms_rad=ARMS_DOWN_RAD))
    record = main(["--quick", "--avatars", str(file), "--garments", "tank", "--frames", "3", "--threads", "1"])
    (row,) = record["rows"]
    assert set(row) == set(COLUMNS)
    assert row["joints"] == 22 and row["fit_median_mm"] < 2.5 and row["resets"] == 0
    assert row["skin_pixels_pct"] <= row["as_it_is_pct"] < 0.2 and row["retarget_deg"] < 1.0


def test_a_rig_without_hands_of_its_own_gives_poses_back(body: BodyModel):
    wearer = read_wearer(character(body), name="ours", body=body)
    poses, _ = random_motion(3, spread_rad=0.1)
    poses[:, [22, 23]] = 0.0
    assert retarget_deg(wearer, poses) < 0.1
    assert retarget_deg(wearer, np.zeros((1, 24, 3))) < 1e-3


def test_no_characters_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    with pytest.raises(Unavailable, match="GLB or VRM"):
        characters(())
    (tmp_path / "avatars").mkdir()
    (tmp_path / "avatars" / "me.vrm").touch()
    monkeypatch.setenv("DRAPE_DATA", str(tmp_path))
    assert [path.name for path in characters(())] == ["me.vrm"]
