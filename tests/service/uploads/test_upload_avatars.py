"""Whose avatar an upload is for: what is said, the table beside the files, and that of the data folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drape.errors import BodyError, NotFound
from service.uploads.avatars import upload_avatar


def test_the_rule_of_avatars_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    table = {"female": {"gender": 1.0}, "female_coat": {"gender": 0.9}, "stand": "standard", "scan": "scans/body.obj"}
    (tmp_path / "avatars.json").write_text(json.dumps(table))
    assert json.loads(upload_avatar(None, "female_tshirt", tmp_path) or "") == {"gender": 1.0}
    assert json.loads(upload_avatar(None, "female_coat_3", tmp_path) or "") == {"gender": 0.9}
    assert upload_avatar(None, "stand-in", tmp_path) == "standard"
    assert upload_avatar(None, "scan1", tmp_path) == str(tmp_path / "scans/body.obj")
    assert upload_avatar(None, "unisex", tmp_path) is None
    assert upload_avatar("female", "unisex", tmp_path) == json.dumps({"gender": 1.0})
    assert upload_avatar(' {"gender": 0}', "x", tmp_path) == '{"gender": 0}'
    with pytest.raises(NotFound, match="female_coat"):
        upload_avatar("nobody", "x", tmp_path)
    with pytest.raises(BodyError):
        upload_avatar("{" * 5000, "x", tmp_path)


def test_the_data_folder_has_a_table_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "garments").mkdir()
    (tmp_path / "garments/avatars.json").write_text('{"male": {"gender": 0.0}}')
    monkeypatch.setenv("DRAPE_DATA", str(tmp_path))
    assert upload_avatar(None, "male_jeans", tmp_path / "uploads") == '{"gender": 0.0}'
