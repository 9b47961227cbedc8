"""The benchmark of distilled joints on a character that is ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.joints import COLUMNS, main
from drape.body.model import BodyModel
from tests.fixtures.characters import character


@pytest.mark.long
def test_tracks_are_nearer_than_springs(body: BodyModel, tmp_path: Path):
    file = tmp_path / "ours.glb"
    file.write_bytes(character(body))
    record = main(["--quick", "--avatars", str(file), "--garments", "tank", "--joints", "8", "--threads", "1"])
    (row,) = record["rows"]
    assert set(COLUMNS) <= set(row)
    assert row["tracks_unseen_mm"] < row["springs_unseen_mm"] and row["kb"] < 1500.0
