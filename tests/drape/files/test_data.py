"""DRAPE_DATA is absent, right or refused; it is never silently wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from drape.errors import NotFound
from drape.files.data import DATA_VARIABLE, data_folder


@pytest.mark.parametrize("value", [None, "", "  "])
def test_unset_variable_means_no_data(value: str | None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(DATA_VARIABLE, raising=False)
    if value is not None:
        monkeypatch.setenv(DATA_VARIABLE, value)
    assert data_folder() is None
    assert data_folder("motions") is None


def test_folder_and_subfolder_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "motions").mkdir()
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    assert data_folder() == tmp_path
    assert data_folder("motions") == tmp_path / "motions"
    assert data_folder("scans") is None


def test_mistyped_folder_is_refused_with_its_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path / "nothing"))
    with pytest.raises(NotFound, match=r"DRAPE_DATA: expected an existing folder.*docs/guide/data\.md"):
        data_folder()
