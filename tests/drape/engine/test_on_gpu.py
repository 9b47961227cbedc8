"""The command that measures on a card: what it records is drawn again, and without a card it says so."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from drape.engine.card import build_card
from tests.drape.engine.test_card import THREADS, Emulated

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
    return made


def test_recorded_frames_are_drawn_again(script: ModuleType):
    script.record()
    with np.load(script.TAPE) as file:
        tape = dict(file)
    memory = Emulated()
    cases = [script.Case(memory, tape, 0)]
    (row,) = script.compared(cases, 2, THREADS)
    assert row == {"tier": "fast", "garment": "tank", "frames": 2, "off_mm": 0.0}
    tape["0/1/folded"] = tape["0/1/folded"] + np.float32(0.001)
    assert script.compared([script.Case(memory, tape, 0)], 2, THREADS)[0]["off_mm"] > 0.9


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="here is a card")
def test_without_a_card_it_says_so():
    done = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True, check=False)
    assert done.returncode == 4
    assert "expected an NVIDIA card" in done.stderr


@pytest.mark.long
@pytest.mark.skipif(shutil.which("nvcc") is None, reason="needs CUDA's nvcc")
def test_the_frame_compiles_for_cards_and_fits_a_group_of_1024_threads(tmp_path: Path):
    """A card has 65,536 registers for the threads of a group."""
    told = build_card(tmp_path / "card.so")
    registers = [int(found) for found in re.findall(r"Used (\d+) registers", told)]
    assert len(registers) == 3 and max(registers) <= 64
