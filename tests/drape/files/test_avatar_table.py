"""One rule for intake, service and clients: the longest beginning of a file's name, the nearest table first."""

from __future__ import annotations

import json

import pytest

from clients import calls
from drape.errors import BodyError
from drape.files.avatar_table import TABLE_NAME, avatar_table, entry_for
from service.uploads.avatars import upload_avatar


def test_the_longest_key_of_the_first_table_that_fits_counts(tmp_path):
    near, far = tmp_path / "near", tmp_path / "far"
    for folder, table in ((near, {"girl": {"age": 0.7}}), (far, {"girl": {"age": 0.8}, "girl_tall": {"height": 0.8}})):
        folder.mkdir()
        (folder / TABLE_NAME).write_text(json.dumps(table))
    assert entry_for("girl_tall_coat.obj", [far]) == ("girl_tall", {"height": 0.8}, far)
    assert entry_for("girl_tall_coat.obj", [near, far]) == ("girl", {"age": 0.7}, near)
    assert entry_for("boy.obj", [near, far, tmp_path]) is None


@pytest.mark.parametrize("text", ["{", "[1, 2]", '{"female": 3}', b"\xff\xfe{"])
def test_a_table_that_is_none_is_refused(tmp_path, text):
    (tmp_path / TABLE_NAME).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(BodyError, match=TABLE_NAME):
        avatar_table(tmp_path)


def test_the_client_sends_what_the_table_beside_the_file_says(tmp_path):
    (tmp_path / TABLE_NAME).write_text(json.dumps({"tall": {"height": 0.8}, "own": "standard", "scan": "scan.obj"}))
    for stem, expected in (("tall_coat", '{"height": 0.8}'), ("own_coat", "standard"), ("scan_coat", None)):
        (tmp_path / f"{stem}.obj").write_text("v 0 0 0\n")
        assert calls.upload_call(tmp_path / f"{stem}.obj", None, None).arguments()["params"].get("avatar") == expected
    told = calls.upload_call(tmp_path / "tall_coat.obj", "male", None)
    assert told.arguments()["params"]["avatar"] == "male"


def test_the_service_falls_back_on_the_shipped_table(tmp_path, monkeypatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    for name, gender in (("male_shirt.obj", 0.0), ("female_shirt.obj", 1.0)):
        assert json.loads(upload_avatar(None, name, tmp_path) or "")["gender"] == gender
    assert upload_avatar(None, "shirt.obj", tmp_path) is None
