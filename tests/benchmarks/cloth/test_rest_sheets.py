"""Sheets of rest states: what the table says, what the colours show, and that a quick run ends with its record."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.cloth import rest_sheets
from drape.body.assets import load_body
from drape.cloth import rest_state
from drape.geometry import meshes
from drape.motion.samples import squat
from tests.drape.cloth.cloth_shapes import tube
from tests.fixtures.garments import shipped


def test_colours_are_pale_where_cloth_is_flat_and_red_where_it_is_bent():
    _, faces = tube(12, 5)
    state = rest_state.flat(*tube(12, 5))
    assert_array_equal(rest_sheets.angle_colours(state, faces), np.broadcast_to(rest_sheets.PALE, (len(faces), 3)))
    angle, stiffening = np.zeros_like(state.hinge_angle), np.ones_like(state.stiffening)
    angle[7], stiffening[20] = -1.0, 2.0
    found = rest_sheets.angle_colours(replace(state, hinge_angle=angle, stiffening=stiffening), faces)
    sides = meshes.hinge_faces(faces)
    assert_allclose(found[sides[7]], np.broadcast_to(rest_sheets.BENT, (2, 3)))
    assert_allclose(found[sides[20]], np.broadcast_to(rest_sheets.DOUBLE, (2, 3)))
    others = np.setdiff1d(np.arange(len(faces)), sides[[7, 20]])
    assert_array_equal(found[others], np.broadcast_to(rest_sheets.PALE, (len(others), 3)))


def test_a_pair_is_two_drapes_of_one_pose(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rest_sheets.physics, "LEFT_LIMIT_J_M2", np.inf)  # forty steps reach no rest
    body, garment = load_body(), shipped("shorts")
    pair = rest_sheets.drape_pair(garment, body, squat().poses[150].astype(np.float64), "jersey", 40)
    assert pair.vertices.shape == (2, len(garment.vertices), 3)
    assert 0.0 < pair.figures["apart_mm"] < 20.0
    row = rest_sheets.drape_row(pair, body)
    assert [picture.shape for picture in row] == [(*rest_sheets.DRAPE_SIZE, 3)] * 4


def test_a_quick_run_prints_its_table_and_its_record(tmp_path, capsys: pytest.CaptureFixture[str]):
    record = rest_sheets.main(["--quick", "--garments", "shorts", "--sheets", str(tmp_path)])
    (row,) = record["rows"]
    assert (row["garment"], row["kept_pct"], row["grain"], row["lengths"]) == ("shorts", 0.0, "uv", "panels")
    assert (tmp_path / "angles_0.png").is_file()
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["bench"] == "rest_sheets"
