"""The benchmark of cuts: what it writes as targets, and how it judges the cut that was told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import recovery_cuts
from drape.garment.files.mesh import read_mesh
from recovery.run.cut import Cut


def test_a_garment_of_the_catalogue_is_a_plain_surface(tmp_path: Path):
    path, source = recovery_cuts.written("tank", tmp_path)
    mesh = read_mesh(path)
    assert source == "catalogue" and len(mesh.uv) == 0 and len(mesh.vertices) > 4000
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(0.586, abs=0.01)


def test_without_data_the_run_ends_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    with pytest.raises(SystemExit, match="DRAPE_DATA"):
        recovery_cuts.written("tee", tmp_path)


def test_a_cut_is_right_where_base_and_panels_are_or_a_sentence_says_what_is_not_seen():
    unseen = ("The target does not show its seams: panels and seams are the base's",)
    assert recovery_cuts.told_words("tee", Cut("tshirt", True, {}, ()), 6) == "yes"
    assert recovery_cuts.told_words("tee", Cut("tank", True, {}, ()), 2) == "no, tshirt"
    assert recovery_cuts.told_words("tank", Cut("tank", True, {}, unseen), 2) == "base; seams unseen"
    assert recovery_cuts.told_words("skirt_4_panels", Cut("skirt", True, {}, ()), 2) == "base"


def test_a_target_that_is_refused_has_its_reason_in_the_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def open_nowhere(name, folder):
        folder.mkdir(exist_ok=True)
        (folder / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        return folder / "t.obj", "drape"

    monkeypatch.setattr(recovery_cuts, "written", open_nowhere)
    row = recovery_cuts.recovered("tank", tmp_path, None)
    assert row["base"] == "refused" and row["told"] == "no" and row["why"]


def test_a_run_of_some_targets_keeps_the_rows_of_others_with_their_commit(tmp_path: Path):
    record = tmp_path / "record.json"
    rows = [{"target": name, "mean_mm": 1.0} for name in ("skirt", "tee", "tank")]
    rows[1]["commit"] = "older"
    record.write_text(json.dumps({"rows": rows, "commit": "old"}))
    found = recovery_cuts.with_others([{"target": "tank", "mean_mm": 2.0}], record)
    assert found == [rows[1], {"target": "tank", "mean_mm": 2.0}, {"commit": "old", **rows[0]}]


def test_a_sheet_shows_the_pictures_that_are_there_in_the_order_of_the_targets(tmp_path: Path):
    for number, name in enumerate(recovery_cuts.NAMES[:6]):
        Image.new("RGB", (22, 38), (40 * number, 0, 0)).save(tmp_path / f"{name}.png")
    (tmp_path / recovery_cuts.SHEET).write_bytes(recovery_cuts.sheet_of(tmp_path))
    with Image.open(tmp_path / recovery_cuts.SHEET) as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    assert pixels.shape == (96, 160, 3)
    assert np.allclose(pixels[20, 10::32, 0], 40 * np.arange(5), atol=12) and abs(pixels[68, 10, 0] - 200) <= 12
    assert pixels[68, 58].min() > 240
