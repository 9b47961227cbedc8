"""Stored graphs: made once, made again when a source or a package is another, and never read damaged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from model_export.push.stored import SOURCES, key, stored
from tests.architecture.repository import ROOT


class Maker:
    """Returns another content at every call."""

    def __init__(self):
        self.calls = 0

    def __call__(self) -> bytes:
        self.calls += 1
        return b"graph %d" % self.calls


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "formula.py").write_text("factor = 3.0\n")
    (folder / "other.py").write_text("")
    return folder


def test_what_is_stored_is_read_and_older_sources_are_deleted(tmp_path: Path):
    folder, make = tmp_path / "kept", Maker()
    assert [stored("push", "a" * 64, make, folder) for _ in range(2)] == [b"graph 1"] * 2
    assert stored("push", "b" * 64, make, folder) == b"graph 2"
    assert stored("push_over", "b" * 64, make, folder) == b"graph 3"
    assert stored("push", "b" * 64, make, folder) == b"graph 2"
    assert sorted(path.name.split(".")[0] for path in folder.iterdir()) == ["push", "push_over"]


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: b"", lambda content: content + b"x"])
def test_what_is_damaged_is_made_again(tmp_path: Path, damage):
    make = Maker()
    stored("push", "a" * 64, make, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    assert [stored("push", "a" * 64, make, tmp_path) for _ in range(2)] == [b"graph 2"] * 2


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path: Path):
    (tmp_path / "file").write_text("no folder")
    make = Maker()
    assert [stored("push", "a" * 64, make, tmp_path / "file") for _ in range(2)] == [b"graph 1", b"graph 2"]


def test_the_key_is_of_every_source_its_place_and_versions(package: Path):
    found = [key([package], ["numpy"])]
    (package / "inner" / "formula.py").write_text("factor = 5.0\n")
    found.append(key([package], ["numpy"]))
    (package / "inner" / "formula.py").rename(package / "formula.py")
    found += [key([package], ["numpy"]), key([package], ["numpy", "onnx"])]
    assert len(set(found)) == 4 and found[2] == key([package], ["numpy"])


def test_graphs_are_traced_from_no_other_package_of_this_repository():
    script = "import sys, model_export.push.graph; print(*(name for name in sys.modules if '.' not in name))"
    run = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    own = {path.name for path in ROOT.iterdir() if path.is_dir()}
    assert own & set(run.stdout.split()) == {folder.name for folder in SOURCES}
    assert all(folder.parent == ROOT and folder.is_dir() for folder in SOURCES)
