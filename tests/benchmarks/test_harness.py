"""The record that every benchmark ends with."""

from __future__ import annotations

import importlib.util
import json
import sys

import pytest

from benchmarks import harness
from benchmarks.harness import Benchmark, Option, Run
from drape.errors import InputError, Unavailable

COLUMNS = {"garment": "s", "edge_pct": ("edge", ".2f"), "gain": ".2f", "fabric": "s"}
ROWS = [{"garment": "tshirt", "edge_pct": 1.23456789, "gain": float("nan")}]


@Benchmark(
    "quality",
    "A benchmark.",
    COLUMNS,
    Option("--frames", 12, "poses", 2),
    Option("--fabrics", ("jersey", "denim"), "cloths", ("jersey",)),
    Option("--share", None, "in %", kind=float),
    Option("--slow", False, "a switch", True),
)
def bench(run: Run) -> None:
    """Adds its rows."""
    run.add(ROWS)
    run.summary = [{"garment": "all", "gain": 0.5}]
    run.notes.append("said below")
    run.extra["model"] = "onefit"
    run.failed = run.options.frames == 0


def test_the_last_line_is_the_record_and_names_machine_commit_and_command(capsys, tmp_path):
    target = tmp_path / "deep" / "record.json"
    record = bench(["--out", str(target), "--threads", "2"])
    *_, header, row, mean, note, last = capsys.readouterr().out.splitlines()
    assert json.loads(last) == record == json.loads(target.read_text())
    assert record["rows"] == [{"garment": "tshirt", "edge_pct": 1.23457, "gain": None}]
    assert record["command"] == f"python -m benchmarks.quality --out .../{target.name} --threads 2"
    assert {"bench", "machine", "commit", "threads", "model"} <= set(record) and record["threads"] == 2
    assert (header, row, mean) == ("garment  edge  gain", "tshirt   1.23", "all            0.50")
    assert note == "said below"


def test_save_writes_under_results_and_a_run_that_failed_is_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(harness, "RESULTS_DIR", tmp_path)
    with pytest.raises(SystemExit, match="1"):
        bench(["--save", "--frames", "0"])
    assert json.loads((tmp_path / "quality.json").read_text())["bench"] == "quality"


def test_options_of_the_quick_form_yield_to_explicit_ones():
    found = bench.parse([])
    assert (found.frames, found.fabrics, found.share, found.slow) == (12, ("jersey", "denim"), None, False)
    quick = bench.parse(["--quick"])
    assert (quick.frames, quick.fabrics, quick.slow) == (2, ("jersey",), True)
    given = bench.parse(["--quick", "--frames", "5", "--fabrics", "rib", "satin", "--share", "0.5"])
    assert (given.frames, given.fabrics, given.share) == (5, ["rib", "satin"], 0.5)


@pytest.mark.parametrize(("error", "status"), [(Unavailable, 3), (InputError, 2)])
def test_what_is_not_there_ends_with_another_status_than_a_refusal(error, status, monkeypatch, capsys):
    @Benchmark("none", "Nothing.", {})
    def nothing(run: Run) -> None:
        """Refuses."""
        raise error("newton", expected="an interpreter", got="none", cure="Give one.")

    monkeypatch.setattr(sys, "argv", ["none"])
    with pytest.raises(SystemExit) as ended:
        nothing.command()
    assert ended.value.code == status and "newton: expected an interpreter" in capsys.readouterr().err


def test_private_folders_appear_by_the_name_of_their_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("DRAPE_DATA", str(tmp_path))
    line = harness.command("quality", ["--garments", str(tmp_path / "garments"), "--frames", "3", "a b"])
    assert line == "python -m benchmarks.quality --garments $DRAPE_DATA/garments --frames 3 'a b'"


def test_no_git_is_no_commit(monkeypatch, tmp_path):
    monkeypatch.setattr(harness, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert harness.commit_of_tree() == "none"


def test_the_command_is_the_module_that_runs(monkeypatch):
    spec = importlib.util.find_spec("benchmarks.frame")
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", spec)
    assert harness.command("anything", []) == "python -m benchmarks.frame"
