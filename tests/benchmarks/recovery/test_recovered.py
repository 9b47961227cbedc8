"""Rows of recoveries: how the cut that was told is judged, refusals, silence, and the sheet of pictures."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from benchmarks.recovery import recovered as rows
from recovery.run.cut import Cut

UNSEEN = ("The target does not show its seams: panels and seams are the base's",)


def test_a_cut_is_right_where_base_and_panels_are_or_a_sentence_says_what_is_not_seen():
    assert rows.told_words("tshirt", Cut("tshirt", True, {}, ()), panels=True) == "yes"
    assert rows.told_words("tshirt", Cut("tank", True, {}, ()), panels=True) == "no, tshirt"
    assert rows.told_words("tank", Cut("tank", True, {}, UNSEEN)) == "base; seams unseen"
    assert rows.told_words("skirt", Cut("skirt", True, {}, ())) == "base"


def test_a_refusal_is_right_where_it_is_asked_for():
    assert rows.told_words("tshirt", None) == "no, tshirt"
    assert rows.told_words(rows.REFUSED, None) == "yes"
    assert rows.told_words(rows.REFUSED, Cut("tshirt", True, {}, ())) == "no, refused"


def test_a_target_that_is_refused_has_the_sentence_in_its_row(tmp_path: Path):
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    job = rows.as_user(tmp_path / "t.obj", tmp_path / "out", "--body", "fit", "--minutes", "6")
    assert (job.body, job.base, job.minutes, job.retarget) == ("fit", None, 6.0, False)
    row = rows.recovered(job, lambda cut, panels: rows.told_words("tshirt", cut), tmp_path / "pictures")
    assert row["base"] == "refused" and row["told"] == "no, tshirt" and "mean_mm" not in row
    assert row["refused"] and row["longest_silence_s"] >= 0.0 and not (tmp_path / "pictures").exists()


def test_silence_is_the_longest_time_between_two_lines(monkeypatch: pytest.MonkeyPatch):
    clock = iter([0.0, 2.0, 9.0, 10.0])
    monkeypatch.setattr(rows, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    silence, lines = rows.Silence(), []
    line = silence.through(lines.append)
    line("a")
    line("b")
    silence.ended()
    assert silence.longest_s == 7.0 and lines == ["a", "b"]


def test_a_sheet_shows_the_pictures_that_are_there_in_the_order_of_the_targets(tmp_path: Path):
    names = [f"t{number}" for number in range(7)]
    assert rows.sheet_of(tmp_path, names) == b""
    for number, name in enumerate(names[:6]):
        Image.new("RGB", (22, 38), (40 * number, 0, 0)).save(tmp_path / f"{name}.png")
    (tmp_path / "sheet.webp").write_bytes(rows.sheet_of(tmp_path, names))
    with Image.open(tmp_path / "sheet.webp") as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    assert pixels.shape == (96, 160, 3)
    assert np.allclose(pixels[20, 10::32, 0], 40 * np.arange(5), atol=12) and abs(pixels[68, 10, 0] - 200) <= 12
    assert pixels[68, 58].min() > 240
