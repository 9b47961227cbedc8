"""Every numbered example runs as its first line says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.settings import ROOT, Settings
from tests.fixtures.garments import ship
from tests.fixtures.serving import served

EXAMPLES = sorted((ROOT / "examples").glob("0*.*"))
ALONE = {"07_recover_pattern", "08_train"}  # without a service
LONG = {"07_recover_pattern", "08_train", "09_tour"}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the shipped model with the two garments that the examples wear."""
    shipped = ship(tmp_path_factory.mktemp("shipped"), "tshirt", "trousers")
    settings = Settings(
        shipped_garments_dir=shipped, garments_dir=tmp_path_factory.mktemp("uploads"), stream_step_down=False
    )
    with served(settings) as address:
        yield address


def code(path: Path) -> str:
    """The Python of an example, or of the cells of a notebook."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    cells = json.loads(text)["cells"]
    return "\n".join("".join(cell["source"]) + "\n" for cell in cells if cell["cell_type"] == "code")


MARKED = [pytest.param(path, marks=pytest.mark.long) if path.stem in LONG else path for path in EXAMPLES]


@pytest.mark.parametrize("path", MARKED, ids=[path.stem for path in EXAMPLES])
def test_an_example_runs(path: Path, request: pytest.FixtureRequest, tmp_path: Path):
    arguments = [] if path.stem in ALONE else [request.getfixturevalue("url")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    if path.suffix == ".ipynb":
        environment["DRAPE_URL"] = arguments[0]
    command = [sys.executable, "-c", code(path), *arguments]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.strip(), done.stderr
    for written in tmp_path.glob("*.*"):
        assert written.stat().st_size > 1000


def test_examples_are_nine_and_short():
    assert [path.name[:2] for path in EXAMPLES] == [f"0{number}" for number in range(1, 10)]
    assert max(len(code(path).splitlines()) for path in EXAMPLES if path.suffix == ".py") <= 40


def test_the_notebook_is_kept_without_outputs():
    cells = json.loads(next(path for path in EXAMPLES if path.suffix == ".ipynb").read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
