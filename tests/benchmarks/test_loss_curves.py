"""Curves of runs: what is read back, medians, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from torch.utils.tensorboard import SummaryWriter

from benchmarks.loss_curves import curves, main, smooth


def test_curves_are_read_back_and_drawn(tmp_path: Path):
    for part in (0, 1):  # a run that was resumed from step 20 on
        with SummaryWriter(str(tmp_path / "run" / "log"), filename_suffix=str(part)) as writer:
            for step in range(20 * part, 40 + 20 * part):
                writer.add_scalar("membrane", 1.0 / (1.0 + step), step)
    found = curves(tmp_path / "run")
    assert_allclose(found["membrane"], [(step, 1.0 / (1.0 + step)) for step in range(60)], rtol=1e-6)
    assert found["contact"].shape == (0, 2)
    assert main([str(tmp_path / "run"), "--out", str(tmp_path / "curves.png")]) == 0
    assert (tmp_path / "curves.png").stat().st_size > 5_000


def test_medians_leave_outliers_out():
    curve = np.stack([np.arange(9.0), np.ones(9)], axis=1)
    curve[4, 1] = 100.0
    assert_allclose(smooth(curve, 3), np.stack([np.arange(1.0, 8.0), np.ones(7)], axis=1))
    assert_allclose(smooth(curve[:2], 5), [[0.5, 1.0]])
    assert smooth(curve[:0]).shape == (0, 2)


def test_a_folder_without_a_log_is_refused(tmp_path: Path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "expected a folder of training.run" in capsys.readouterr().err
