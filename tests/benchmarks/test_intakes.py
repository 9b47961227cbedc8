"""Rows of files: what an intake tells of its stages, and frames by turns with the dress."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import intakes
from drape.body.model import BodyModel
from drape.catalog import find_garments
from drape.garment.intake import STAGES
from service.compute.drape_runtime import DrapeRuntime
from tests.drape.garment.garment_files import obj_text, shirt
from tests.fixtures.garments import shipped
from tests.fixtures.serving import bare_settings


def test_a_file_has_seconds_of_every_stage_and_a_cached_garment_none(body: BodyModel, tmp_path: Path):
    vertices, faces = shirt(body, body.v_template)
    path = tmp_path / "shirt.obj"
    path.write_bytes(obj_text(vertices, faces))
    row, (garment,) = intakes.take_in(path)
    assert row["faces"] == len(faces) and garment.name == "shirt"
    assert row["all_s"] == pytest.approx(sum(row[f"{stage}_s"] for stage in STAGES)) and row["all_s"] > 0.0
    row, (garment,) = intakes.take_in(find_garments(["tank"])[0])
    assert row == {"garment": "tank", "faces": len(garment.faces)}


def test_a_garment_against_itself_takes_as_much_and_hangs_nothing(tmp_path: Path):
    garment = shipped("tank")
    row = intakes.frame_times(DrapeRuntime(bare_settings(tmp_path)), [garment], [garment], 1)
    assert row["drawn"] == row["cloth"] == garment.vertex_count
    assert row["hang_ms"] is None and row["frame_ms"] > 0.0 and row["over_dress"] > 0.0
