"""The paper's losses in float64: closed forms on plane, cylinder and sphere, finite differences, rigid motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.papers import losses as paper
from drape.cloth import energies
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.garment.fitting import patch_fields
from drape.geometry import jets
from drape.geometry.meshes import edge_lengths, unique_edges
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from tests.benchmarks.papers.losses_setup import F64, SCALE, flat_jet, posed_with, samples_at
from tests.drape.cloth.cloth_shapes import equilateral, grid
from tests.training.training_setup import bank, body, garment, source, tube
from training.losses import disagreement
from training.model import Posed, pose_frames, posed_coefficients


def test_collision_depth_and_its_square():
    distance = torch.tensor([[0.01, 0.002, -0.003]], dtype=F64, requires_grad=True)
    depth = paper.collision_depth(distance, 0.004)
    assert_allclose(depth.detach(), [[0.0, 0.002, 0.007]], rtol=0, atol=1e-15)
    loss = paper.collision(depth)
    assert_allclose(loss.detach(), [0.002**2 + 0.007**2], rtol=1e-12, atol=0)
    loss.sum().backward()
    assert distance.grad is not None
    assert_allclose(distance.grad, [[0.0, -0.004, -0.014]], rtol=0, atol=1e-15)


def test_cloth_that_collides_may_stretch_up_to_twice():
    depth = torch.tensor([0.0, 0.005, 0.5], dtype=F64)
    assert_allclose(paper.allowed_stretch(depth, 0.0), [1.0, 1.0, 1.0], rtol=0, atol=0)
    assert_allclose(paper.allowed_stretch(depth, 50.0), [1.0, 1.25, 1.5], rtol=1e-12, atol=0)
    assert_allclose(paper.allowed_stretch(depth, 1000.0), [1.0, 1.5, 2.0], rtol=1e-12, atol=0)


def test_metric_of_a_parabolic_cylinder_is_its_closed_form():
    """h = a u^2 over the plane has g = s^2 diag(1 + 4 a^2 u^2, 1)."""
    uv = torch.tensor([[0.3, -0.2], [-0.7, 0.5]], dtype=F64)
    added = torch.zeros(jets.JET_COUNT, dtype=F64)
    added[2 * jets.IN_PLANE_COUNT + 3] = 0.6
    samples = samples_at(uv, flat_jet())
    surface = paper.chart_surface(posed_with(added, rotvec=(0.4, -1.0, 0.7), centre=(1.0, 2.0, 3.0)), samples)
    expected = np.zeros((2, 2, 2))
    expected[:, 0, 0] = SCALE**2 * (1.0 + 4.0 * 0.36 * uv[:, 0].numpy() ** 2)
    expected[:, 1, 1] = SCALE**2
    assert_allclose(surface.metric[0, :, 0], expected, rtol=0, atol=1e-15)
    excess = (expected[:, 0, 0] - SCALE**2).mean()
    one = torch.ones(1, 2, dtype=F64)
    got = paper.metric_inextensibility(surface.metric, samples.rest_metric, one, samples.weight)
    assert_allclose(got, [excess], rtol=1e-12, atol=0)


def test_rolling_a_plane_up_costs_no_metric_and_stretching_does():
    """An arc (sin, 1 - cos) of the angle u / 2 has the plane's metric up to what order 2 and 4 leave out."""
    uv = torch.linspace(-0.2, 0.2, 9, dtype=F64)[:, None] * torch.tensor([1.0, 0.5], dtype=F64)
    samples = samples_at(uv, flat_jet())
    rolled = torch.zeros(jets.JET_COUNT, dtype=F64)
    height = rolled[2 * jets.IN_PLANE_COUNT :]
    height[3], height[10] = 0.5 * 0.5, -(0.5**3) / 24.0
    one = torch.ones(1, len(uv), dtype=F64)

    def cost(added: torch.Tensor, stretch: torch.Tensor = one) -> float:
        metric = paper.chart_surface(posed_with(added), samples).metric
        return float(paper.metric_inextensibility(metric, samples.rest_metric, stretch, samples.weight)[0])

    stretched = torch.zeros(jets.JET_COUNT, dtype=F64)
    stretched[1] = 0.1
    assert cost(torch.zeros(jets.JET_COUNT, dtype=F64)) == 0.0
    assert cost(stretched) == pytest.approx(0.21 * SCALE**2)
    assert cost(rolled) < 0.02 * cost(stretched)
    # Where k_ext allows 1.21, only the direction that did not stretch is off.
    assert cost(stretched, 1.21 * one) == pytest.approx(0.21 * SCALE**2)


def test_tangents_are_the_derivatives_of_the_positions():
    rng = np.random.default_rng(3)
    uv, step = torch.tensor([[0.2, -0.4], [0.6, 0.1]], dtype=F64), 1e-6
    rest_jet = flat_jet() + torch.from_numpy(0.1 * rng.normal(size=(1, jets.JET_COUNT)))
    posed = posed_with(torch.from_numpy(0.1 * rng.normal(size=jets.JET_COUNT)), rotvec=(0.3, 0.9, -0.2))
    tangents = paper.chart_surface(posed, samples_at(uv, rest_jet)).tangents[0, :, 0]
    for axis in range(2):
        shift = step * torch.eye(2, dtype=F64)[axis]
        high, low = (
            paper.chart_surface(posed, samples_at(uv + sign * shift, rest_jet)).positions[0, :, 0] for sign in (1, -1)
        )
        assert_allclose(tangents[..., axis], (high - low) / (2 * step), rtol=0, atol=1e-9)


def test_skinning_jacobian_is_the_derivative_of_skinning():
    """With weights that are linear in space, J_psi is the derivative of x -> sum_j w_j(x) (R_j x + t_j)."""
    rng = np.random.default_rng(5)
    gradients = rng.normal(size=(1, 24, 3))
    gradients -= gradients.mean(axis=1, keepdims=True)
    point, base = np.array([0.1, 0.3, -0.2]), np.full(24, 1.0 / 24.0)
    rotations = rotvec_to_matrix(rng.normal(size=(2, 24, 3)))
    translations = rng.normal(size=(2, 24, 3))

    def skin_at(x: np.ndarray) -> paper.Skin:
        arrays = (base[None] + gradients @ (x - point), gradients, rotations, translations)
        return paper.Skin(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))

    def posed(x: np.ndarray) -> torch.Tensor:
        return skin_at(x).pose(torch.from_numpy(np.broadcast_to(x, (2, 1, 1, 3)).copy()))

    points = torch.from_numpy(np.broadcast_to(point, (2, 1, 1, 3)).copy())
    got = skin_at(point).jacobian(points)[:, 0, 0]
    for axis in range(3):
        shift = 1e-6 * np.eye(3)[axis]
        numeric = (posed(point + shift) - posed(point - shift))[:, 0, 0] / 2e-6
        assert_allclose(got[..., axis], numeric, rtol=0, atol=1e-8)


def test_weight_gradients_say_how_weights_change_along_the_garment():
    gradients, rest = paper.weight_gradients(tube()), tube()
    edges = unique_edges(rest.faces)
    along = rest.vertices[edges[:, 1]] - rest.vertices[edges[:, 0]]
    mean = 0.5 * (gradients[edges[:, 0]] + gradients[edges[:, 1]])
    predicted = np.einsum("ejc,ec->ej", mean, along)
    changed = rest.binding.weights[edges[:, 1]] - rest.binding.weights[edges[:, 0]]
    assert np.abs(changed).max() > 0.05
    assert np.abs(predicted - changed).max() < 0.2 * np.abs(changed).max()
    assert np.corrcoef(predicted.ravel(), changed.ravel())[0, 1] > 0.99


def test_samples_of_a_partition_are_its_charts():
    """What training keeps of a partition gives back the jets it was fitted with, and its charts' positions."""
    partition = garment().partitions[0]
    rest_jet = paper.rest_jets(partition)
    fields = patch_fields(tube(), seed=3)
    assert_allclose(rest_jet.numpy(), fields["patch_jet"], rtol=0, atol=2e-4)
    vertex = torch.arange(0, 480, 7)
    samples = paper.chart_samples(partition, rest_jet, vertex)
    assert_allclose(samples.uv.numpy(), fields["chart_uv"][vertex], rtol=0, atol=1e-6)
    batch = source().pose(bank().draw(2, np.random.default_rng(1)), np.zeros((2, body().shape_count)))
    rotation, centre = pose_frames(batch.tensors, partition.patches)
    jet = 0.05 * torch.randn(2, centre.shape[1], jets.JET_COUNT, generator=torch.Generator().manual_seed(0))
    posed = Posed(rotation, centre, jet)
    said = paper.chart_surface(posed, samples).positions
    weight = samples.weight[None, ..., None]
    apart = said - (weight * said).sum(dim=2, keepdim=True)
    coefficients = posed_coefficients(posed, partition.patches.scale)
    expected = float(disagreement(coefficients, partition, vertex))
    assert_allclose(float((weight * apart.square()).sum(dim=(2, 3)).mean()), expected, rtol=1e-4, atol=0)
    still = paper.chart_surface(replace(posed, jet=torch.zeros_like(jet)), samples)
    one = torch.ones(2, len(vertex))
    unmoved = paper.metric_inextensibility(still.metric, samples.rest_metric, one, samples.weight)
    moved = paper.metric_inextensibility(
        paper.chart_surface(posed, samples).metric, samples.rest_metric, one, samples.weight
    )
    assert float(unmoved.max()) < 1e-6 < 1e-2 * float(moved.min())


def test_edges_that_stretch_alike_cost_the_same_on_both_meshes():
    lost = []
    for rows in (8, 16):
        flat, faces = equilateral(rows, round(rows / np.sqrt(0.75)), edge_m=1.0 / rows)
        edges = unique_edges(faces)
        rest = edge_lengths(flat, edges)
        moved = torch.from_numpy(1.1 * flat[None]).requires_grad_()
        loss = paper.edge_inextensibility(moved, torch.from_numpy(edges.T.copy()), torch.from_numpy(rest))
        assert_allclose(loss.detach(), [(0.01 * rest**2).sum()], rtol=1e-10, atol=0)
        lost.append(float(loss.detach()))
    assert lost[1] == pytest.approx(lost[0], rel=0.12)  # the finer lattice has fewer edges on its rim


def test_boundary_is_zero_where_charts_agree_and_known_where_one_is_moved():
    uv = torch.tensor([[0.1, 0.2], [-0.3, 0.4], [0.5, 0.0]], dtype=F64)
    samples = samples_at(uv, flat_jet())
    shared = samples.weight.clone()
    shared[:2, :2] = 0.5  # the third point has one chart only
    samples = replace(samples, uv=uv[:, None].expand(-1, 4, -1), place=samples.place[:, :1].expand(-1, 4, -1))
    surface = paper.chart_surface(posed_with(torch.zeros(jets.JET_COUNT, dtype=F64)), samples)
    assert float(paper.boundary(surface, shared)) == pytest.approx(0.0, abs=1e-20)
    positions, tangents = surface.positions.clone(), surface.tangents.clone()
    positions[0, :, 1] += torch.tensor([0.0, 0.003, 0.004], dtype=F64)
    turn = torch.from_numpy(rotvec_to_matrix(np.array([0.5, 0.0, 0.0])))
    tangents[0, :, 1] = turn @ tangents[0, :, 1]
    moved = replace(surface, positions=positions, tangents=tangents)
    expected = 5e3 * 0.005**2 + (1.0 - np.cos(0.5)) ** 2
    assert_allclose(float(paper.boundary(moved, shared)), expected, rtol=1e-10, atol=0)


@pytest.mark.parametrize("term", ["collision", "metric", "edges", "boundary", "gravity"])
def test_gradients_in_the_jets_follow_finite_differences(term):
    """Two overlapping charts at 20 points, which are also the corners of a sheet of triangles."""
    rng = np.random.default_rng(11)
    sheet, faces = grid(4, 3, cell_m=0.25)
    points = sheet[:, :2] - [0.5, 0.375]
    flat = SCALE * (sheet - [0.5, 0.375, 0.0])
    edges = unique_edges(faces)
    cloth = ClothMesh.from_rest(flat, faces).like(torch.zeros(1, dtype=F64))
    single = samples_at(torch.from_numpy(points), flat_jet())
    patch, weight = single.patch.clone(), single.weight.clone()
    patch[:, 1], weight[:, 0], weight[:, 1] = 1, 0.7, 0.3
    uv = single.uv.clone()
    uv[:, 1] = uv[:, 0]
    place = single.place.clone()
    place[:, 1] = place[:, 0]
    samples = replace(single, patch=patch, weight=weight, uv=uv, place=place)
    rotation = torch.from_numpy(rotvec_to_matrix(0.2 * rng.normal(size=(1, 2, 3))))
    centre = torch.zeros(1, 2, 3, dtype=F64)
    jet, direction = (torch.from_numpy(0.1 * rng.normal(size=(1, 2, jets.JET_COUNT))) for _ in range(2))

    stretch = 1.0 + torch.from_numpy(rng.uniform(0.0, 1.0, (1, 20)))  # taken as given: no gradient goes through it

    def loss(added: torch.Tensor) -> torch.Tensor:
        surface = paper.chart_surface(Posed(rotation, centre, added), samples)
        vertices = (samples.weight[..., None] * surface.positions).sum(dim=2)
        depth = paper.collision_depth(vertices[..., 2] + 0.01, 0.004)
        found = {
            "collision": lambda: paper.collision(depth),
            "metric": lambda: paper.metric_inextensibility(
                surface.metric, samples.rest_metric, stretch, samples.weight
            ),
            "edges": lambda: paper.edge_inextensibility(
                vertices, torch.from_numpy(edges.T.copy()), torch.from_numpy(edge_lengths(flat, edges))
            ),
            "boundary": lambda: paper.boundary(surface, samples.weight),
            "gravity": lambda: energies.gravity(vertices, cloth, material()),
        }
        return found[term]().sum()

    moving = jet.clone().requires_grad_()
    value = loss(moving)
    value.backward()
    assert moving.grad is not None
    assert abs(float(value.detach())) > 0.0
    step = 1e-7
    numeric = float(loss(jet + step * direction) - loss(jet - step * direction)) / (2.0 * step)
    assert_allclose(float((moving.grad * direction).sum()), numeric, rtol=2e-5, atol=1e-10)


def test_terms_are_rigid_motion_invariant_on_a_real_partition():
    """Metric, boundary and edges of a tube whose frames all move as one body."""
    partition = garment().partitions[0]
    rest_jet = paper.rest_jets(partition).double()
    single = paper.chart_samples(partition, rest_jet, torch.arange(480))
    samples = replace(
        single,
        weight=single.weight.double(),
        uv=single.uv.double(),
        place=single.place.double(),
        scale=single.scale.double(),
    )
    jet = 0.05 * torch.randn(1, len(rest_jet), jets.JET_COUNT, generator=torch.Generator().manual_seed(0), dtype=F64)
    turn, shift = torch.from_numpy(rotvec_to_matrix(np.array([1.0, -0.4, 0.3]))), torch.tensor([1.0, 2.0, 3.0])
    rotation, centre = partition.patches.rotation.double()[None], partition.patches.centre.double()[None]
    edges = unique_edges(garment().rest.faces)
    lengths = torch.from_numpy(edge_lengths(garment().rest.vertices, edges))
    costs = []
    for posed in (Posed(rotation, centre, jet), Posed(turn @ rotation, centre @ turn.T + shift, jet)):
        surface = paper.chart_surface(posed, samples)
        blended = (samples.weight[..., None] * surface.positions).sum(dim=2)
        one = torch.ones(1, 480, dtype=F64)
        costs.append(
            [
                float(paper.metric_inextensibility(surface.metric, samples.rest_metric, one, samples.weight)),
                float(paper.boundary(surface, samples.weight)),
                float(paper.edge_inextensibility(blended, torch.from_numpy(edges.T.copy()), lengths)),
            ]
        )
    assert min(costs[0]) > 0.0
    assert_allclose(costs[0], costs[1], rtol=1e-5, atol=0)  # frames from float32 over strains of some percent


def test_a_skinned_chart_is_what_skinning_makes_of_it():
    """Positions are linear blend skinning of the rest charts; tangents follow the posed charts in the surface."""
    rest = tube()
    partition, vertex = garment().partitions[0], torch.arange(0, 480, 5)
    samples = paper.chart_samples(partition, paper.rest_jets(partition), vertex)
    poses = np.zeros((1, 24, 3))
    poses[0, (3, 6), 0] = 0.3
    batch = source().pose(poses, np.zeros((1, body().shape_count)))
    weights = torch.from_numpy(rest.binding.weights.astype(np.float32))
    gradients = torch.from_numpy(paper.weight_gradients(rest).astype(np.float32))
    skin = paper.Skin.at(vertex, weights, gradients, batch.tensors)
    patches = partition.patches
    posed = Posed(patches.rotation[None], patches.centre[None], torch.zeros(1, len(patches.scale), jets.JET_COUNT))
    surface = paper.chart_surface(posed, samples, skin=skin)
    places = torch.from_numpy(rest.vertices[vertex].astype(np.float32))[None]
    expected = skin_points(places, weights[vertex], batch.tensors.rotation, batch.tensors.translation)
    assert_allclose(surface.positions, expected[:, :, None].expand(-1, -1, 4, -1), rtol=0, atol=2e-5)
    plain = paper.chart_surface(posed, samples).metric
    assert float((surface.metric - plain).abs().max()) > 1e-4  # a bent spine stretches the tube
    upright = source().pose(np.zeros((1, 24, 3)), np.zeros((1, body().shape_count)))
    still = paper.chart_surface(posed, samples, skin=paper.Skin.at(vertex, weights, gradients, upright.tensors))
    assert_allclose(still.metric, plain, rtol=0, atol=1e-5)
