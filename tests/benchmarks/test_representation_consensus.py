"""Consensus: known fits are found again, charts that agree stay, charts that do not come closer."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.network import Draped
from benchmarks.representation_consensus import Refit
from benchmarks.representation_drape import after, drape, frame_spaces, network_drapes, posed, posed_frames, total_j
from benchmarks.representation_space import REPRESENTATIONS, PatchSpace, block_scaling
from drape.geometry import jets
from tests.benchmarks.representation_setup import bench, found, garment

FORM = REPRESENTATIONS["rigid_2"]


def drawn(size: float, seed: int = 0) -> torch.Tensor:
    numbers = np.random.default_rng(seed).normal(0.0, size, (found().patch_count, FORM.number_count))
    return block_scaling(FORM, found()).variables(torch.from_numpy(numbers).float())


@pytest.fixture
def space() -> PatchSpace:
    return frame_spaces(bench(), FORM, found())[1]


@pytest.mark.parametrize("plane_order", [2, 4])
def test_charts_that_agree_stay(space: PatchSpace, plane_order: int):
    """Frames that a rigid motion carries say the same of every vertex, whatever the fit."""
    still = PatchSpace(FORM, found(), found().rotation, found().centre, block_scaling(FORM, found()))
    rows = still.rows(torch.zeros(still.size))
    assert_allclose(Refit(found(), plane_order=plane_order)(still, rows), rows, rtol=0, atol=2e-5)
    posed_rows = space.rows(torch.zeros(space.size))
    refitted = Refit(found(), plane_order=plane_order)(space, posed_rows)
    assert float((refitted - posed_rows).abs().max()) > 1e-2


@pytest.mark.parametrize("plane_order", [2, 4])
def test_one_round_is_each_patch_s_least_squares_fit(space: PatchSpace, plane_order: int):
    """Against lstsq in the patch frame, one patch after the other, in float64 with the ridge as further rows."""
    z = drawn(0.05)
    before = space.rows(z)
    rows = Refit(found(), plane_order=plane_order)(space, before).reshape(found().patch_count, -1, 3)
    said = space.chart_positions(before).double().numpy()
    moved = np.einsum("vk,vka->va", found().weight, said)[:, None] - said
    count = jets.coefficient_count(plane_order)
    for k in range(0, found().patch_count, 5):
        own = (found().patch == k) & (found().weight > 0.0)
        root = found().weight[own] ** 0.25
        basis, frame = found().basis[own], space.frame[k].double().numpy()
        local = moved[own] @ frame
        ridge = 1e-2 * basis[0, 0]
        expected = np.zeros((15, 3))
        for axis, size in ((0, count), (1, count), (2, 15)):
            a = np.concatenate([root[:, None] * basis[:, :size], ridge * np.eye(size)])
            target = np.concatenate([root * local[:, axis], np.zeros(size)])
            expected[:size, axis] = np.linalg.lstsq(a, target, rcond=None)[0]
        got = (rows[k] - before.reshape(found().patch_count, -1, 3)[k]).double().numpy()
        assert_allclose(got[:3], 0.0, rtol=0, atol=0)
        assert_allclose(got[3:] @ frame, expected, rtol=0, atol=2e-4)


def test_every_round_brings_charts_closer():
    start = posed(frame_spaces(bench(), FORM, found()), [drawn(0.03), drawn(0.03, 1)])
    found_gaps = [start.charts.gap_rms_mm]
    for rounds in (1, 2, 6):
        drapes = after(start, Refit(found(), rounds=rounds, plane_order=jets.HEIGHT_ORDER))
        assert len(drapes.vertices) == 2
        found_gaps.append(drapes.charts.gap_rms_mm)
    assert found_gaps == sorted(found_gaps, reverse=True)
    assert found_gaps[1] < 0.5 * found_gaps[0]
    by_order = [after(start, Refit(found(), plane_order=n)).charts.gap_rms_mm for n in (2, 4)]
    assert by_order[1] < by_order[0]


def test_minimising_through_consensus_is_better_than_consensus_afterwards():
    freely = drape(bench(), frame_spaces(bench(), FORM, found()), step_limit=25)
    refit = Refit(found(), plane_order=jets.HEIGHT_ORDER)
    through = drape(bench(), frame_spaces(bench(), FORM, found(), refit=refit), step_limit=25)
    assert total_j(bench(), through.vertices) < total_j(bench(), after(freely, refit).vertices)
    assert through.charts.gap_p99_mm < freely.charts.gap_p99_mm


def test_numbers_per_patch():
    assert Refit(found()).number_count == 27
    assert Refit(found(), plane_order=4).number_count == 45


def test_a_network_s_jets_are_posed_as_it_posed_them():
    """The same vertices as the product's charts blended, with the root's place added."""
    from drape.garment.disagreement import chart_positions

    rotation, centre = (np.stack(part) for part in zip(*posed_frames(bench(), found()), strict=True))
    jet = np.random.default_rng(3).normal(0.0, 0.05, (2, found().patch_count, jets.JET_COUNT)).astype(np.float32)
    root = np.array([[0.5, 1.0, -2.0], [0.0, 0.3, 0.1]])
    said = chart_positions(garment(), jet, rotation, centre)
    expected = np.einsum("vk,fvka->fva", garment().chart_weight, said) + root[:, None]
    drapes = network_drapes(bench(), FORM, found(), Draped(expected, jet, rotation, centre, root))
    assert_allclose(drapes.vertices, expected, rtol=0, atol=5e-6)
