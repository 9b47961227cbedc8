"""Bending from the second fundamental form of the jets: the plate's closed forms, hinges, finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.papers import losses as paper
from drape.cloth import energies
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.geometry import jets
from tests.benchmarks.papers.losses_setup import F64, SCALE, flat_jet, lattice, posed_with, samples_at


@pytest.mark.parametrize(
    ("kind", "share"), [("plane", 0.0), ("cylinder", 0.5), ("sphere", 2.0 / 3.0), ("saddle", 4.0 / 3.0)]
)
def test_jet_bending_is_the_plate_s_and_that_of_hinges_on_two_meshes(kind, share):
    """k share (curvature)^2 per area, with the hinges' ratio of spherical to cylindrical bending.

    Hinges on both meshes agree with the jets within 4 %; the jets on both meshes within 1 %, being integrals of
    the same surface.
    """
    curvature, length = 2.0, 0.08  # [1/m], [m]: shallow, so that arcs and parabolas are one
    added = torch.zeros(jets.JET_COUNT, dtype=F64)
    height = added[2 * jets.IN_PLANE_COUNT :]
    height[3] = 0.0 if kind == "plane" else 0.5 * curvature * SCALE
    height[5] = {"sphere": 0.5, "saddle": -0.5}.get(kind, 0.0) * curvature * SCALE
    by_jets, by_hinges = [], []
    for rows in (12, 24):
        points, faces = lattice(length, rows)
        flat = np.column_stack([points, np.zeros(len(points))])
        mesh = ClothMesh.from_rest(flat, faces)
        samples = samples_at(torch.from_numpy(points) / SCALE, flat_jet())
        surface = paper.chart_surface(posed_with(added, rotvec=(0.2, 0.1, -0.4)), samples)
        area = torch.from_numpy(np.asarray(mesh.vertex_area))
        by_jets.append(float(paper.jet_bending(surface.jet, samples, area, material())) / float(area.sum()))
        hinges = energies.bending(surface.positions[:, :, 0], mesh.like(area), material())
        # A hinge stands for the kite of its edge and the middles of its triangles: a third of their area.
        held = np.asarray(mesh.hinge_weight > 0).sum() * (2.0 * np.asarray(mesh.face_area).mean() / 3.0)
        by_hinges.append(float(hinges) / held)
    expected = material().bending_j * share * curvature**2
    assert_allclose(by_jets, expected, rtol=0.03, atol=1e-15)
    assert by_jets[1] == pytest.approx(by_jets[0], rel=0.01, abs=1e-15)
    assert_allclose(by_hinges, expected, rtol=0.04, atol=1e-6)  # a flat hinge keeps 1e-8 of its guard


def test_jet_bending_forgets_the_rest_curvature_and_follows_finite_differences():
    rng = np.random.default_rng(7)
    uv = torch.from_numpy(rng.uniform(-0.5, 0.5, (20, 2)))
    rest_jet = flat_jet() + torch.from_numpy(0.05 * rng.normal(size=(1, jets.JET_COUNT)))
    samples, area = samples_at(uv, rest_jet), torch.full((20,), 1e-3, dtype=F64)
    added, direction = (torch.from_numpy(0.05 * rng.normal(size=jets.JET_COUNT)) for _ in range(2))

    def energy(jet: torch.Tensor) -> torch.Tensor:
        return paper.jet_bending(paper.chart_surface(posed_with(jet), samples).jet, samples, area, material())[0]

    assert float(energy(torch.zeros_like(added))) < 1e-25
    moving = added.clone().requires_grad_()
    energy(moving).backward()
    assert moving.grad is not None
    numeric = float(energy(added + 1e-6 * direction) - energy(added - 1e-6 * direction)) / 2e-6
    assert_allclose(float(moving.grad @ direction), numeric, rtol=1e-6, atol=0)
