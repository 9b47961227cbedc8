"""Consensus and strain: the fast form against the readable one, closed forms, and the force as a gradient."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.contact.skin import body_skin
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from drape.graph.feeds import garment_feed
from tests.fixtures.garments import shipped
from tests.training.training_setup import CPU, JERSEY, TINY, body, source
from training.batches import Partition, on_device, partition_tensors
from training.chart_consensus import (
    TRACE_SHARE,
    GatheredConsensus,
    agreed_jets,
    closing_jets,
    softened,
    strain_and_force,
    tangent_terms,
)
from training.checkpoint import FORMER_SWITCHES, model_config_from
from training.config import ModelConfig, as_published, paper
from training.disagreement import disagreement
from training.onefit import OneFit, Posed, pose_frames, posed_coefficients

TANK = shipped("tank")


@cache
def partition() -> Partition:
    return partition_tensors(TANK, body_skin(body()), device=CPU)


@cache
def gathered() -> GatheredConsensus:
    return GatheredConsensus.from_flat(on_device(garment_feed(TANK), CPU))


def posed(count: int = 2, size: float = 0.05) -> Posed:
    rng = np.random.default_rng(4)
    poses = rng.normal(0.0, 0.3, size=(count, 24, 3))
    bodies = source().pose(poses, np.zeros((count, body().shape_count))).tensors
    rotation, centre = pose_frames(bodies, partition().patches)
    jet = size * torch.randn(count, TANK.patch_count, jets.JET_COUNT, generator=torch.Generator().manual_seed(2))
    return Posed(rotation, centre, jet)


def frames(state: Posed) -> torch.Tensor:
    return torch.cat([state.centre[..., None, :], state.rotation.mT], dim=-2)


def test_sparse_form_equals_the_gathered_one_forward_and_backward():
    scale, results = partition().patches.scale, []
    for charts in (partition().consensus, gathered()):
        state = posed()
        jet = state.jet.clone().requires_grad_()
        anchors = charts.anchors(posed_coefficients(replace(state, jet=jet), scale))
        agreed = agreed_jets(anchors, charts, state.rotation, state.centre, scale)
        (gradient,) = torch.autograd.grad((agreed**2).sum(), jet)
        base = agreed_jets(charts.anchors(frames(state)), charts, state.rotation, state.centre, scale)
        results.append((anchors.detach(), agreed.detach(), gradient, base))
    for fast, slow in zip(*results, strict=True):
        assert_allclose(fast, slow, rtol=0, atol=2e-4 * float(slow.abs().max()))


def test_charts_that_agree_stay_as_they_are():
    """A garment moved rigidly: all charts say the same, and the fit finds the rest jets again."""
    turn = torch.from_numpy(rotvec_to_matrix(np.array([0.4, -1.1, 0.3]))).float()
    patches = partition().patches
    rotation = (turn @ patches.rotation)[None]
    centre = (patches.centre @ turn.T + torch.tensor([0.3, -0.2, 0.1]))[None]
    charts = partition().consensus
    state = Posed(rotation, centre, torch.zeros(1, TANK.patch_count, jets.JET_COUNT))
    agreed = agreed_jets(charts.anchors(frames(state)), charts, rotation, centre, patches.scale)
    assert float(agreed.abs().max()) < 1e-4


def test_agreement_brings_charts_together():
    state, scale, charts = posed(size=0.02), partition().patches.scale, partition().consensus
    anchors = charts.anchors(posed_coefficients(state, scale))
    agreed = agreed_jets(anchors, charts, state.rotation, state.centre, scale)
    gaps = [
        disagreement(TANK, jet.numpy(), state.rotation.numpy(), state.centre.numpy()).gap_m
        for jet in (state.jet, agreed)
    ]
    assert np.median(gaps[1]) < 0.3 * np.median(gaps[0])


def test_closing_fit_brings_charts_nearer_than_the_jets_of_the_passes_can():
    """Order 4 in the plane follows what order 2 leaves; both forms of the tables give the same."""
    state, scale = posed(size=0.02), partition().patches.scale
    gaps, closed = [], []
    for charts in (partition().consensus, gathered()):
        anchors = charts.anchors(posed_coefficients(state, scale))
        low = agreed_jets(anchors, charts, state.rotation, state.centre, scale)
        high = closing_jets(anchors, charts, state.rotation, state.centre, scale)
        assert high.shape[-1] == jets.FULL_COUNT
        assert_allclose(jets.unpack(high)[2], jets.unpack(low)[2], rtol=0, atol=1e-6)  # heights have that order anyway
        closed.append(high)
        for jet in (low, high):
            found = disagreement(TANK, jet.numpy(), state.rotation.numpy(), state.centre.numpy())
            gaps.append(np.quantile(found.gap_m, 0.9))
    assert_allclose(closed[0], closed[1], rtol=0, atol=2e-4 * float(closed[1].abs().max()))
    assert gaps[1] < 0.8 * gaps[0] and gaps[3] < 0.8 * gaps[2]


def test_charts_that_agree_stay_as_they_are_in_the_closing_fit():
    """Polynomials of the fit's order that all charts share: an affine map of the whole garment."""
    patches, charts = partition().patches, gathered()
    stretch = torch.diag(torch.tensor([1.05, 0.97, 1.02]))
    anchors = charts.anchors(torch.cat([patches.centre[:, None], patches.rotation.mT], dim=1)[None]) @ stretch
    jet = closing_jets(anchors, charts, patches.rotation[None], patches.centre[None], patches.scale)
    state = Posed(patches.rotation[None], patches.centre[None], jet)
    again = charts.anchors(posed_coefficients(state, patches.scale))
    assert float((again - anchors).abs().max()) < 5e-4  # the ridge and the rest's own detail


def test_a_network_of_vector_jets_closes_with_full_ones():
    bodies = source().pose(np.zeros((1, 24, 3)) + 0.1, np.zeros((1, body().shape_count))).tensors
    for config, count in ((TINY, jets.FULL_COUNT), (as_published(TINY), jets.JET_COUNT)):
        model = OneFit(config).eval()
        with torch.no_grad():
            features = partition().encoder_inputs(JERSEY)[:, : config.encoder_feature_count]
            jet = model(bodies, partition().patches, model.garment(features), charts=partition().consensus).jet
        assert jet.shape[-1] == model.jet_count == count


def test_strain_of_a_stretch_is_its_closed_form():
    """u -> 1.2 u, v -> 0.9 v + 0.1 u of flat patches: E = (F^T F - 1) / 2."""
    count, charts = 3, gathered()
    flat = torch.zeros(count, 7, 3, 2)
    flat[..., 0, 0] = flat[..., 1, 1] = 1.0
    charts = replace(charts, tangent=flat, orthonormal=torch.eye(2).expand(count, 7, 2, 2))
    jet = torch.zeros(1, count, jets.JET_COUNT)
    jet[..., 1], jet[..., jets.IN_PLANE_COUNT + 1], jet[..., jets.IN_PLANE_COUNT + 2] = 0.2, 0.1, -0.1
    strain, force = strain_and_force(jet, charts, tangent_terms())
    f = np.array([[1.2, 0.0], [0.1, 0.9]])
    e = 0.5 * (f.T @ f - np.eye(2))
    wanted = np.repeat([e[0, 0], e[1, 1], 2.0 * e[0, 1]], 7)
    assert_allclose(strain[0, 1], wanted, rtol=0, atol=1e-6)
    stress = e + TRACE_SHARE * np.trace(e) * np.eye(2)
    assert_allclose(force[0, 1, 1], 7.0 * (f @ stress)[0, 0], rtol=1e-5)  # d/dp_u of the sum over seven points alike


def test_rigid_patches_feel_nothing():
    strain, force = strain_and_force(torch.zeros(1, TANK.patch_count, jets.JET_COUNT), gathered(), tangent_terms())
    assert float(strain.abs().max()) < 1e-5 and float(force.abs().max()) < 1e-4


def test_force_is_the_gradient_of_the_strain_energy():
    charts = gathered()
    exact = replace(charts, tangent=charts.tangent.double(), orthonormal=charts.orthonormal.double())
    terms = tangent_terms().double()
    jet = 0.2 * torch.randn(2, TANK.patch_count, jets.JET_COUNT, dtype=torch.float64)
    jet.requires_grad_()
    strain, force = strain_and_force(jet, exact, terms)
    e11, e22, shear = strain.unflatten(-1, (3, 7)).unbind(-2)
    energy = 0.5 * (e11**2 + e22**2 + 0.5 * shear**2) + 0.5 * TRACE_SHARE * (e11 + e22) ** 2
    (gradient,) = torch.autograd.grad(energy.sum(), jet)
    assert_allclose(force.detach(), gradient, rtol=0, atol=1e-9 * float(gradient.abs().max()))


def test_softened_values_are_four_times_the_small_and_bounded():
    assert_allclose(softened(torch.tensor([1e-6, -1e-6])), [4e-6, -4e-6], rtol=1e-4)
    assert float(softened(torch.tensor([1e6])).abs().max()) <= 1.0


def test_passes_choose_how_many_corrections_are_taken():
    torch.manual_seed(0)
    model = OneFit(replace(TINY, corrections=2)).eval()
    for correction in model.corrections:
        torch.nn.init.normal_(list(correction.parameters())[-2], std=0.3)
    bodies = source().pose(np.zeros((1, 24, 3)) + 0.1, np.zeros((1, body().shape_count))).tensors
    charts, patches = partition().consensus, partition().patches
    with torch.no_grad():
        embedding = model.garment(partition().encoder_inputs(JERSEY))
        got = [model(bodies, patches, embedding, charts=charts, passes=n).jet for n in (0, 1, 2, None)]
    assert float((got[0] - got[1]).abs().max()) > 1e-4 and float((got[1] - got[2]).abs().max()) > 1e-4
    assert torch.equal(got[2], got[3])


def test_corrections_fit_no_network_but_one_of_vector_jets():
    with pytest.raises(ValueError, match="corrections: expected 0"):
        OneFit(replace(paper().model, corrections=1))


def test_files_may_name_the_parts_of_a_network_that_its_variant_has():
    named = dict.fromkeys(FORMER_SWITCHES, True)
    assert model_config_from({"variant": "vector", **named}) == model_config_from({"variant": "vector"})
    with pytest.raises(ValueError, match="closing_fit: expected True"):
        model_config_from({"variant": "vector", **named, "closing_fit": False})


def test_autocast_stays_near_full_precision():
    torch.manual_seed(0)
    model = OneFit(ModelConfig(corrections=1)).eval()
    bodies = source().pose(np.zeros((1, 24, 3)) + 0.1, np.zeros((1, body().shape_count))).tensors
    jets_of = []
    for model.autocast in (False, True):
        with torch.no_grad():
            embedding = model.garment(partition().encoder_inputs(JERSEY))
            jets_of.append(model(bodies, partition().patches, embedding, charts=partition().consensus).jet)
    assert jets_of[1].dtype == torch.float32
    gap = float((jets_of[0] - jets_of[1]).abs().max())
    assert 0.0 < gap < 1e-3  # bfloat16 in the networks, whose outputs are small, and nowhere else
