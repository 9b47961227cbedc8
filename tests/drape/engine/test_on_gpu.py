"""The command that measures on a card: what it records is drawn again, and it says what it lacks."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from drape.engine.card import build_kernels
from drape.engine.card_frames import Pool
from tests.drape.engine.test_card import THREADS
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
    monkeypatch.setattr(made, "CASES", (("fast", "tank"),))
    monkeypatch.setattr(made, "FRAMES", 2)
    monkeypatch.setenv("DRAPE_SHIPPED_GARMENTS_DIR", str(tmp_path / "none"))  # it loads those that it draws by itself
    return made


def test_recorded_frames_are_drawn_again(script: ModuleType, capsys: pytest.CaptureFixture[str]):
    """By threads as loops; and by the emulation that the command compiles where there is no card."""
    script.record()
    with np.load(script.TAPE) as file:
        tape = dict(file)
    pool = Pool(paper_card(), 256 << 20)
    (row,) = script.compared([script.Case(pool, tape, 0)], 2, THREADS)
    assert (row["tier"], row["garment"], row["frames"]) == ("fast", "tank", 1) and row["off_mm"] == 0.0
    assert pool.size - pool.free_bytes < 64 << 20  # what frames took came back
    assert script.without_a_card(tape, ["64 registers"]) == 0
    told = capsys.readouterr().out
    assert "no card was found; the kernels compile for sm_90: 64 registers" in told and "not measured" in told
    tape["0/1/folded"] = tape["0/1/folded"] + np.float32(0.001)
    assert script.compared([script.Case(pool, tape, 0)], 2, THREADS)[0]["off_mm"] > 0.9
    assert script.judged([{"off_mm": np.nan}]) == 1


def test_without_what_was_recorded_it_says_so(script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: Any):
    monkeypatch.setattr(sys, "argv", ["on_gpu"])
    assert script.main() == 2 and "scripts/on_gpu --record writes it" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(shutil.which("nvcc") is None, reason="needs CUDA's nvcc")
def test_the_frame_compiles_for_cards_and_fits_a_group_of_1024_threads(tmp_path: Path):
    """A card has 65,536 registers for the threads of a group."""
    told = build_kernels(tmp_path / "card.fatbin")
    registers = [int(found) for found in re.findall(r"Used (\d+) registers", told)]
    assert len(registers) == 6 and max(registers) <= 64
