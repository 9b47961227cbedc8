"""The record that every benchmark ends with."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys

from benchmarks.shared import common


def options(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    common.add_options(parser)
    return parser.parse_args(arguments)


def test_the_last_line_is_the_record_and_names_machine_commit_and_command(capsys, tmp_path):
    target = tmp_path / "deep" / "record.json"
    rows = [{"garment": "tshirt", "edge_pct": 1.23456789, "gain": float("nan")}]
    record = common.finish("quality", rows, options("--out", str(target), "--threads", "2"), model="onefit")
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert printed == record == json.loads(target.read_text())
    assert printed["rows"] == [{"garment": "tshirt", "edge_pct": 1.23457, "gain": None}]
    assert printed["command"].startswith("python -m benchmarks.quality")
    assert {"bench", "machine", "commit", "threads", "model"} <= set(printed)


def test_save_writes_under_results(monkeypatch, tmp_path):
    monkeypatch.setattr(common, "RESULTS_DIR", tmp_path)
    common.finish("speed", [], options("--save"))
    assert json.loads((tmp_path / "speed.json").read_text())["bench"] == "speed"


def test_tables_align_and_leave_unknown_numbers_empty(capsys):
    rows = [{"name": "a", "value": 1.5}, {"name": "longer", "value": float("nan")}]
    common.print_table(rows, {"name": "s", "value": ".2f"})
    assert capsys.readouterr().out.splitlines() == ["name    value", "a        1.50", "longer"]


def test_private_folders_appear_by_the_name_of_their_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("DRAPE_DATA", str(tmp_path))
    line = common.command("quality", ["--garments", str(tmp_path / "garments"), "--frames", "3", "a b"])
    assert line == "python -m benchmarks.quality --garments $DRAPE_DATA/garments --frames 3 'a b'"


def test_no_git_is_no_commit(monkeypatch, tmp_path):
    monkeypatch.setattr(common, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert common.commit() == "none"


def test_the_command_is_the_module_that_runs(monkeypatch):
    spec = importlib.util.find_spec("benchmarks.latency")
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", spec)
    assert common.command("anything", []) == "python -m benchmarks.latency"
