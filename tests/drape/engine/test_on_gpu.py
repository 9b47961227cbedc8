"""The command that measures on a card: what it records is drawn again, and it says what it lacks."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import json
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from drape.engine.card import build_kernels
from drape.live import card_lane
from tests.fixtures.paper_card import paper_card

SCRIPT = Path(__file__).parents[3] / "scripts" / "on_gpu"


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("on_gpu", str(SCRIPT))
    spec = importlib.util.spec_from_loader("on_gpu", loader)
    assert spec is not None
    made = importlib.util.module_from_spec(spec)
    loader.exec_module(made)
    monkeypatch.setattr(made, "TAPE", tmp_path / "tape.npz")
    monkeypatch.setattr(made, "RESULT", tmp_path / "frame_gpu.json")
    monkeypatch.setattr(made, "CASES", (("fast", "tank"), ("instant", "shorts tank")))
    for name, value in (("FRAMES", 2), ("STREAMS", (1, 3)), ("THREADS", (256,)), ("ROUNDS", 1)):
        monkeypatch.setattr(made, name, value)
    for name in ("GATHERED_S", "MOST", "LOST_S"):  # which recording sets
        monkeypatch.setattr(card_lane, name, getattr(card_lane, name))
    (tmp_path / "none").mkdir()
    monkeypatch.setenv("DRAPE_SHIPPED_GARMENTS_DIR", str(tmp_path / "none"))  # it loads those that it draws by itself
    return made


def test_recorded_frames_are_drawn_again(script: ModuleType, capsys: pytest.CaptureFixture[str]):
    """By threads as loops; and by the emulation that the command compiles where there is no card."""
    script.record()
    with np.load(script.TAPE) as file:
        tape = dict(file)
    launches = script.Launches(paper_card(), tape, 1)
    names = launches.names("compared")
    assert script.compared(launches, names, 256) == [
        {"what": "fast/tank", "off_mm": 0.0, "farthest_mm": 0.0},
        {"what": "instant/shorts tank", "off_mm": 0.0, "farthest_mm": 0.0},
    ]
    assert [name.removeprefix("timed/") for name in launches.names("timed")] == [
        "fast tank/1", "instant shorts tank/1", "mixed/3",
    ]  # fmt: skip
    (row,) = launches.timed("timed/mixed/3")
    assert (row["what"], row["streams"], row["threads"]) == ("mixed", 3, 256) and row["network"] + row["folds"] > 0.5
    assert (launches.told(launches.place("timed/mixed/3")["out"], 3)[:, -1] == 1).all()
    assert script.without_a_card(tape, ["64 registers"]) == 0
    told = capsys.readouterr().out
    assert "no card was found; the kernel compiles for sm_90: 64 registers" in told and "not measured" in told
    kept = json.loads(script.RESULT.read_text())
    assert kept["card"] is None and kept["times"].startswith("not measured") and len(kept["emulated"]) == 1
    tape[f"{names[0]}/vertices"] = tape[f"{names[0]}/vertices"] + np.float32(0.001)
    assert min(launches.off_mm(names[0], 256)) > 0.9
    for off_mm, farthest_mm in ((0.0, np.nan), (0.02, 0.02), (0.0, 2.0)):
        assert script.judged([{"off_mm": off_mm, "farthest_mm": farthest_mm}]) == 1


def test_what_a_card_measured_stays(script: ModuleType):
    for card, left in ((None, None), ("H200", "H200"), (None, "H200"), ("H100", "H100")):
        script.keep({"card": card})
        kept = json.loads(script.RESULT.read_text())
        assert kept == {"bench": "frame_gpu", "command": "scripts/on_gpu", "card": left}


def test_without_what_was_recorded_it_says_so(script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: Any):
    monkeypatch.setattr(sys, "argv", ["on_gpu"])
    assert script.main() == 2 and "scripts/on_gpu --record writes it" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(shutil.which("nvcc") is None, reason="needs CUDA's nvcc")
def test_the_frame_compiles_for_cards_and_fits_a_group_of_1024_threads(tmp_path: Path):
    """A card has 65,536 registers for the threads of a group."""
    told = build_kernels(tmp_path / "card.fatbin")
    registers = [int(found) for found in re.findall(r"Used (\d+) registers", told)]
    assert len(registers) == 3 and max(registers) <= 64
