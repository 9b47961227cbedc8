"""The waistband: whose border it is, its closed form, its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth.waistband import SLACK_M, STIFFNESS_N_M2, band_energy, waistband
from tests.fixtures.packed import garment


@pytest.mark.parametrize("kind", ["trousers", "shorts"])
def test_what_hangs_from_the_waist_has_a_band_round_it(body, kind: str):
    whole = garment(kind)
    band = waistband(whole.vertices.astype(np.float64), whole.fine_faces.astype(np.int64), body)
    assert band is not None
    height = whole.vertices[:, 1]
    assert height[band.vertex].mean() > height.max() - 0.03, "the highest border, and not a leg's"
    ring = whole.vertices[band.vertex].astype(np.float64)
    assert_allclose(band.length_m.sum(), np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum(), rtol=1e-12)
    assert 0.6 < band.length_m.sum() < 1.3


@pytest.mark.parametrize("kind", ["tshirt", "dress", "tank"])
def test_what_hangs_from_the_shoulders_has_none_and_so_has_a_closed_surface(body, kind: str):
    whole = garment(kind)
    assert waistband(whole.vertices.astype(np.float64), whole.fine_faces.astype(np.int64), body) is None
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert waistband(np.eye(4, 3) - 1.0, faces, body) is None


def test_a_band_that_slid_costs_half_its_stiffness_times_the_square_of_the_way_past_the_slack():
    length = np.array([0.02, 0.03, 0.05])
    for way, past in ((0.5 * SLACK_M, 0.0), (SLACK_M + 0.02, 0.02)):
        moved = np.broadcast_to(np.array([0.0, -way, 0.0]), (2, 3, 3))
        assert_allclose(band_energy(moved, length), 0.5 * STIFFNESS_N_M2 * 0.1 * past**2, rtol=1e-9, atol=1e-15)


def test_its_gradient_is_that_of_finite_differences_and_finite_at_home():
    rng = np.random.default_rng(0)
    length = torch.from_numpy(rng.uniform(0.01, 0.05, 6))
    way = torch.from_numpy(rng.normal(0.0, 0.03, (1, 6, 3))).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: band_energy(x, length), way, eps=1e-7, atol=1e-7)
    home = torch.zeros(1, 6, 3, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(band_energy(home, length).sum(), home)
    assert float(gradient.abs().max()) == 0.0
