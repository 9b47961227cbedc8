"""Two processes under torchrun train as one with twice the batch: same weights everywhere, and one checkpoint."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from training import checkpoint, parallel

SCRIPT = """
import itertools, os, sys, torch
from pathlib import Path
from types import SimpleNamespace
from training import checkpoint, parallel, run as running
from drape.catalog import MOTIONS_DIR
from training.poses import read_clips
from training.run import make_trainer, train
from tests.training.training_setup import CPU, MOVING_RUN, TINY_RUN
from dataclasses import replace
parallel.start(CPU)
torch.set_num_threads(1)
running.time = SimpleNamespace(monotonic=itertools.count().__next__)  # a second every time it is read
clips = read_clips([MOTIONS_DIR], held_out=())
for kind, run in (("static", TINY_RUN), ("dynamic", MOVING_RUN)):
    folder = Path(sys.argv[1]) / kind
    trainer = make_trainer(replace(run, minutes=0.2), clips, device=CPU)
    train(trainer, folder)
    torch.save([p.detach() for p in trainer.model.parameters()], folder / f"rank{parallel.rank()}.pt")
    print("steps", trainer.step_count, flush=True)
parallel.stop()
os._exit(0)  # threads of libraries that are still there when an interpreter ends have aborted this process before
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of two runs, one after the other: their processes start once, which takes as long as they do."""
    folder = tmp_path_factory.mktemp("two")
    for kind in ("static", "dynamic"):
        (folder / kind).mkdir()
    script = folder / "two.py"
    script.write_text(SCRIPT)
    two = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command = [sys.executable, *two, str(script), str(folder)]
    root = Path(__file__).resolve().parents[2]
    environment = {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=root, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "dynamic"])
@pytest.mark.long
def test_two_processes_keep_the_same_weights(trained: Path, kind: str):
    weights = [torch.load(trained / kind / f"rank{rank}.pt", weights_only=True) for rank in (0, 1)]
    for first, second in zip(*weights, strict=True):
        assert torch.equal(first, second)
    state, _ = checkpoint.load_checkpoint(trained / kind / "checkpoint.pt")
    assert state["step"] > 3


def test_alone_nothing_is_averaged():
    layer = torch.nn.Linear(2, 2)
    layer(torch.ones(1, 2)).sum().backward()
    assert layer.weight.grad is not None
    before = layer.weight.grad.clone()
    assert parallel.average_gradients(layer, 12.5) == 12.5
    assert torch.equal(layer.weight.grad, before)
    assert parallel.rank() == 0
    assert parallel.world_size() == 1
