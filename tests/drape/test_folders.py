"""In a clone what users make lies in its folder runs; elsewhere where the system keeps such files."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drape import folders
from tests.architecture.repository import ROOT


def test_a_clone_keeps_what_users_make():
    assert folders.CLONE == ROOT and folders.RUNS == ROOT / "runs"
    assert {path.name for path in folders.ASSETS.iterdir()} == {"bodies", "garments", "models", "motions"}


def test_a_package_by_itself_is_no_clone(tmp_path: Path):
    assert folders.clone_around(tmp_path / "site-packages/drape") is None


@pytest.mark.skipif(os.name == "nt", reason="the names are those of other systems")
def test_without_a_clone_the_system_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert folders.data_home() == tmp_path / "drape"
    for ignored in ("", "not/absolute"):  # as the specification of these variables wants it
        monkeypatch.setenv("XDG_DATA_HOME", ignored)
        assert folders.data_home() == Path.home() / ".local/share/drape"


@pytest.mark.skipif(os.name == "nt", reason="the names are those of other systems")
def test_a_user_whom_the_machine_does_not_know_has_a_place_where_nothing_can_be_written(
    monkeypatch: pytest.MonkeyPatch,
):
    """As in a container that runs as any number."""
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    assert folders.data_home() == Path("/nonexistent/.local/share/drape") and not Path("/nonexistent").exists()
