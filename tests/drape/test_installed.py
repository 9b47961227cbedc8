"""What was installed half is told in a sentence, before anything of it is needed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from drape import installed
from drape.errors import ArtifactError

PACKED = "drape/a.npz,,4\ndrape/b.py,,4\ndrape/__pycache__/b.pyc,,\n"
RECORD = f"{PACKED}../../bin/drape,,9\n_drape.pth,,9\npatchdrape-1.dist-info/RECORD,,\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of packages with a file of ours."""
    (tmp_path / "drape").mkdir()
    (tmp_path / "drape" / "a.npz").write_bytes(b"1234")
    (tmp_path / "drape" / "b.py").write_text("changed where it lies")
    (tmp_path / "patchdrape-1.dist-info").mkdir()
    (tmp_path / "patchdrape-1.dist-info" / "RECORD").write_text(RECORD)
    return tmp_path


def checked(folder: Path) -> None:
    installed.check_whole(PathDistribution(folder / "patchdrape-1.dist-info"))


def test_files_as_they_were_packed_pass_whatever_the_installer_wrote(folder: Path):
    checked(folder)


def test_python_that_is_missing_is_refused_too(folder: Path):
    (folder / "drape" / "b.py").unlink()
    with pytest.raises(ArtifactError, match=r"got drape/b\.py missing or cut"):
        checked(folder)


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"12")], ids=["missing", "cut"])
def test_a_file_that_is_missing_or_cut_is_refused_with_the_cure(folder: Path, damage: Callable[[Path], object]):
    damage(folder / "drape" / "a.npz")
    with pytest.raises(ArtifactError, match=r"got drape/a\.npz missing or cut\. Install the same wheels again"):
        checked(folder)


def test_a_processor_that_numpy_was_not_built_for_is_refused():
    for level in (0, 2, 3, 4):
        installed.check_processor(level)
    with pytest.raises(ArtifactError, match="expected x86-64 of level v2, v3 or v4, got v1"):
        installed.check_processor(1)


def test_a_package_that_is_missing_is_refused_by_its_name(tmp_path: Path):
    (tmp_path / "numpy.py").write_text("raise ModuleNotFoundError('none', name='numpy')")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-m", "drape", "tiers"], env=environment, capture_output=True, text=True)
    said = "drape: expected the packages that the wheel of patchdrape asks for, got no numpy. Install the same wheels"
    assert done.returncode == 2 and done.stderr.startswith(said)
