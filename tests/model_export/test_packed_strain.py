"""Strain and force by squared lengths equal those by tangents."""

from __future__ import annotations

import torch
from torch.testing import assert_close

from drape.garment.consensus import STRAIN_POINTS
from drape.geometry import jets
from model_export.packed.strain import Strain
from training.chart_consensus import GatheredConsensus, softened, strain_and_force, tangent_terms

PATCHES = 9


def charts(generator: torch.Generator) -> GatheredConsensus:
    tangent = torch.randn(PATCHES, STRAIN_POINTS, 3, 2, generator=generator, dtype=torch.float64)
    lower = torch.linalg.cholesky(tangent.mT @ tangent)
    none = torch.zeros(0)
    return GatheredConsensus(none, none, none, none, none, tangent, torch.linalg.inv(lower).mT)


def test_it_is_the_strain_and_force_of_training():
    generator = torch.Generator().manual_seed(0)
    rest, graph = charts(generator), Strain().double()
    jet = 0.1 * torch.randn(PATCHES, jets.JET_COUNT, generator=generator, dtype=torch.float64)
    unit = rest.orthonormal
    stored = torch.stack([unit[..., 0, 0], unit[..., 0, 1], unit[..., 1, 1]], dim=1)
    stretch = graph.stretch(rest.tangent.permute(0, 3, 2, 1).reshape(PATCHES, -1), stored)
    strain, force = strain_and_force(jet[None], rest, tangent_terms().double())
    got = graph(jet, stretch)
    assert_close(got[0], softened(strain[0]), rtol=0, atol=1e-6)
    assert_close(got[1], softened(force[0]), rtol=0, atol=1e-6)
    assert float(got[1].abs().max()) > 0.1
