"""The benchmark of body distances: what it calls an error, and its quick form from end to end."""

from __future__ import annotations

import numpy as np
import torch
from numpy.testing import assert_allclose

from benchmarks.papers import body_distance
from benchmarks.papers.body_distance import PAPER, Probe, errors, rows_of
from drape.body.assets import load_body
from recovery.sim.siren import SirenOptions


def test_errors_are_those_of_the_distance_that_is_off(rng):
    """A plane raised by 2 mm and tilted by 3 degrees where x < 0."""
    points = rng.uniform(-0.5, 0.5, size=(2000, 3))
    up = np.tile([0.0, 1.0, 0.0], (2000, 1))
    truth = Probe(points, points[:, 1], up, points[:, 0] > 0.0)

    def off(asked: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        left = (asked[:, 0] < 0.0).to(asked.dtype)
        turn = torch.deg2rad(3.0 * left)
        return asked[:, 1] - 0.002 * left, torch.stack([torch.sin(turn), torch.cos(turn), 0.0 * turn], dim=1)

    row = errors(off, truth, truth)
    share = float((points[:, 0] < 0.0).mean())
    assert_allclose([row["skin_mm"], row["near_mm"]], 2.0 * share, rtol=1e-9)
    assert_allclose([row["skin_p99_mm"], row["near_p99_mm"]], 2.0, rtol=1e-9)
    assert_allclose(row["angle_deg"], 3.0 * share, rtol=1e-6)
    assert_allclose([row["limbs_mm"], row["limbs_angle_deg"]], 0.0, atol=1e-6)


def test_a_finer_grid_is_nearer_and_larger(tmp_path, monkeypatch):
    tiny = SirenOptions(width=16, layers=2, points=4000, steps=30)
    monkeypatch.setattr(body_distance, "REPEATS", 2)
    rows, network = rows_of(load_body(), (0.08, 0.04), tiny, tmp_path, 2000)
    exact, coarse, fine, siren = rows
    assert "near_mm" not in exact and exact["query_ms"] > 0.0
    assert fine["near_mm"] < coarse["near_mm"] and fine["limbs_mm"] < fine["near_mm"]
    assert 4.0 < fine["megabytes"] / coarse["megabytes"] < 9.0
    assert siren["prepared_s"] == network.trained_s > 0.0 and len(list(tmp_path.iterdir())) == 1
    assert fine["near_mm"] < siren["near_mm"] < 300.0 and PAPER["mean_mm"] < siren["near_mm"]
