"""Loss terms against independent computations, and gradients against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth import energies
from drape.cloth.material import material
from drape.cloth.waistband import SLACK_M, STIFFNESS_N_M2
from drape.geometry import jets, meshes
from drape.geometry.closest import signed_distance
from tests.training.training_setup import bank, body, garment, source
from training import losses
from training.batches import BodyBatch, BodySurface
from training.onefit import Posed, pose_frames, posed_coefficients


def bodies(count: int = 2):
    return source().pose(bank().draw(count, np.random.default_rng(1)), np.zeros((count, body().shape_count)))


def planes(
    vertices: torch.Tensor, batch: BodyBatch, generator: torch.Generator, share: float = 1.0
) -> losses.SampledPlanes:
    return losses.contact_planes(vertices, batch, share=share, generator=generator)


def test_contact_of_all_vertices_is_the_cloth_energy():
    batch = bodies()
    rest = garment().rest.vertices - body().joints_template[0]
    vertices = torch.from_numpy(np.broadcast_to(0.8 * rest, (2, *rest.shape)).astype(np.float32).copy())
    generator = torch.Generator().manual_seed(0)
    got = losses.energy_loss(vertices, garment(), planes(vertices, batch, generator), material())["contact"]
    expected = []
    for frame in range(2):
        difference = vertices[frame].numpy()[:, None].astype(np.float64) - batch.collider[frame][None]
        nearest = np.argmin((difference**2).sum(-1), axis=1)
        rows = np.arange(len(nearest))
        distance = np.sum(difference[rows, nearest] * batch.collider_normals[frame][nearest], axis=-1)
        expected.append(float(energies.contact(torch.from_numpy(distance), garment().cloth, material())))
    assert min(expected) > 0.01
    assert_allclose(got, expected, rtol=1e-3, atol=1e-6)


def test_contact_on_a_share_of_the_vertices_is_unbiased():
    batch = bodies(1)
    rest = garment().rest.vertices - body().joints_template[0]
    vertices = torch.from_numpy((0.8 * rest[None]).astype(np.float32))
    generator = torch.Generator().manual_seed(0)
    full, *draws = (
        float(losses.energy_loss(vertices, garment(), planes(vertices, batch, generator, share), material())["contact"])
        for share in (1.0, *[0.5] * 40)
    )
    assert_allclose(np.mean(draws), full, rtol=0.1, atol=0)


def test_energy_gradient_reaches_the_jets_as_finite_differences_say():
    batch, partition = bodies(1), garment().partitions[0]
    rotation, centre = pose_frames(batch.tensors, partition.patches)
    jet = 0.02 * torch.randn(1, centre.shape[1], jets.JET_COUNT, generator=torch.Generator().manual_seed(4))
    direction = torch.randn(jet.shape, generator=torch.Generator().manual_seed(5))

    def energy(step: float) -> torch.Tensor:
        state = Posed(rotation, centre, jet + step * direction)
        vertices = losses.vertices_from(posed_coefficients(state, partition.patches.scale), partition)
        return torch.stack(list(energies.total(vertices.double(), cloth, material()).values())).sum()

    cloth = energies.ClothMesh.from_rest(garment().rest.vertices, garment().rest.faces).like(
        torch.zeros(1, dtype=torch.float64)
    )
    jet.requires_grad_()
    energy(0.0).backward()
    assert jet.grad is not None
    analytic = float((jet.grad * direction).sum())
    with torch.no_grad():
        numeric = float(energy(1e-3) - energy(-1e-3)) / 2e-3
    assert_allclose(analytic, numeric, rtol=2e-3, atol=0)


def test_charts_that_agree_have_no_disagreement_and_a_moved_patch_has():
    partition, scale = garment().partitions[0], garment().partitions[0].patches.scale
    still = source().pose(np.zeros((1, 24, 3)), np.zeros((1, body().shape_count)))
    rotation, centre = pose_frames(still.tensors, partition.patches)
    jet = torch.zeros(1, centre.shape[1], jets.JET_COUNT)
    sample = torch.arange(len(garment().rest.vertices))

    def apart(jet: torch.Tensor) -> float:
        return float(
            losses.chart_disagreement(posed_coefficients(Posed(rotation, centre, jet), scale), partition, sample)
        )

    assert apart(jet) < 1e-10
    jet[0, 0, 2 * jets.IN_PLANE_COUNT] = 0.1  # lifts one patch by a tenth of its scale
    got = apart(jet)
    lift = 0.1 * float(partition.patches.scale[0])
    weight = torch.where(partition.chart_patch == 0, partition.chart_weight, torch.zeros(())).sum(dim=1)
    assert_allclose(got, float((weight * (1 - weight)).mean()) * lift**2, rtol=1e-3, atol=0)


def test_the_second_difference_is_what_a_straight_way_lacks():
    rng = np.random.default_rng(0)
    at, step = torch.from_numpy(rng.normal(size=(2, 5, 3))), torch.from_numpy(rng.normal(size=(2, 5, 3)))
    off = torch.tensor([0.0, 3e-3, 4e-3], dtype=torch.float64)
    straight = torch.stack([at - step, at, at + step], dim=1).flatten(0, 1)
    bent = torch.stack([at - step, at + off, at + step], dim=1).flatten(0, 1)
    assert losses.second_difference(straight) < 1e-28
    assert float(losses.second_difference(bent)) == pytest.approx((2 * 5e-3) ** 2)


def test_lost_area_is_what_triangles_lack_and_nothing_for_more():
    cloth = garment().cloth
    rest = garment().rest.vertices
    rest = torch.as_tensor(rest, dtype=cloth.face_area.dtype)
    share = triangle_areas(rest, cloth) / cloth.face_area
    lack = torch.clamp(1.0 - 0.81 * share, min=0.0)
    weight = cloth.face_area / cloth.face_area.sum()
    got = losses.lost_area(torch.stack([0.9 * rest, 2.0 * rest]), cloth)
    assert float(got[0]) == pytest.approx(float((weight * lack**2).sum()), rel=1e-4)
    assert float(got[0]) == pytest.approx(0.19**2, rel=0.2)
    assert float(got[1]) == pytest.approx(0.0, abs=1e-6)


def triangle_areas(vertices: torch.Tensor, cloth: energies.ClothMesh) -> torch.Tensor:
    return torch.from_numpy(meshes.face_areas(vertices.numpy().astype(np.float64), cloth.faces)).to(vertices)


def test_a_garment_that_is_held_up_pays_for_where_its_band_went():
    partition, scale = garment().partitions[0], garment().partitions[0].patches.scale
    held = replace(garment(), band=(torch.arange(5), torch.full((5,), 0.02)))
    rotation, centre = pose_frames(bodies(1).tensors, partition.patches)
    still = Posed(rotation, centre, torch.zeros(1, len(scale), jets.JET_COUNT))
    local = rotation.mT @ torch.tensor([0.0, -0.05, 0.0]) / scale[:, None]  # (1, K, 3), down by 5 cm in the world
    fallen = still.jet.clone()
    fallen[..., 0], fallen[..., jets.IN_PLANE_COUNT], fallen[..., 2 * jets.IN_PLANE_COUNT] = local.unbind(-1)
    down = replace(still, jet=fallen)
    at_home, moved = (posed_coefficients(state, scale) for state in (still, down))
    assert float(losses.waistband_energy(at_home, partition, held)) == 0.0
    wanted = 0.5 * STIFFNESS_N_M2 * 0.1 * (0.05 - SLACK_M) ** 2
    assert_allclose(losses.waistband_energy(moved, partition, held), [wanted], rtol=1e-3)
    assert float(losses.waistband_energy(moved, partition, garment())) == 0.0  # no band, no hold


def test_collider_normals_point_out_of_the_body():
    batch = bodies()
    assert_allclose(np.linalg.norm(batch.collider_normals, axis=-1), 1.0, rtol=1e-4, atol=0)
    rest = source().pose(np.zeros((1, 24, 3)), np.zeros((1, body().shape_count)))
    out = rest.collider[0] + 1e-3 * rest.collider_normals[0] + body().joints_template[0]
    inside = signed_distance(out[::7], body().v_template, body().faces) < 0
    assert inside.mean() < 0.02  # folds of the skin are the exception


def test_the_collider_is_the_posed_body_without_head_hands_and_toes():
    collider, model = BodySurface(body()), body()
    poses = 0.3 * np.random.default_rng(2).normal(size=(2, 24, 3))
    betas = np.zeros((2, model.shape_count))
    betas[1] = np.random.default_rng(3).normal(size=model.shape_count)
    rotations, translations = model.bones(poses, None, betas)
    posed = collider.posed(rotations, translations - model.rest_joints(betas)[:, :1], betas)
    whole = [model.posed_vertices(pose[None], betas=beta)[0] for pose, beta in zip(poses, betas, strict=True)]
    expected = [v[collider.index] - model.rest_joints(beta)[0] for v, beta in zip(whole, betas, strict=True)]
    assert_allclose(posed, np.stack(expected), rtol=0, atol=2e-6)
    of_mesh = meshes.vertex_normals(posed.astype(np.float64), collider.faces)
    assert_allclose(collider.normals(posed), of_mesh, rtol=0, atol=1e-4)


def test_softened_energy_is_itself_when_small_and_its_logarithm_when_large():
    energy = torch.tensor([1e-4, 1e4], dtype=torch.float64)
    got = losses.soften(energy, 0.5)
    assert_allclose(got[0], 1e-4, rtol=1e-3, atol=0)
    assert_allclose(got[1], 0.5 * np.log(2e4), rtol=1e-3, atol=0)
